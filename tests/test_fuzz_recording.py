"""Damaged recordings: whatever was done to a file, it is read or refused in one sentence, soon, and in little memory."""

import functools
import gc
import io
import time
import tracemalloc
from contextlib import suppress
from pathlib import Path
from typing import Any

import hypothesis.strategies as st
import jaxtyping
import numpy as np
import pyarrow
import pyarrow.parquet as parquet
import pytest
from hypothesis import HealthCheck, given, settings
from mcap.writer import IndexType, Writer

from hapjax import InputError, Recording, load_recording
from hapjax.recording import parquet_file
from hapjax.recording.recovering import recover
from test_recording_mcap import bag, json_file

RNG = np.random.default_rng(0)
T = 0.01 * np.arange(12)
ARRAYS: dict[str, Any] = dict(
    hip=RNG.normal(size=(12, 2, 3)),
    hip_t=T,
    force=RNG.normal(size=(6, 2, 3)),
    force_t=T[::2],
    gimbal=RNG.normal(size=(12, 2)),
    gimbal_t=T + 1e-3,
    pose=np.tile([0.1, 0.2, 0.3, 0.6, 0.0, 0.8, 0.0], (3, 1, 1)),
    pose_t=T[::4],
)
TOPICS = {"hip": ["/tip", "/other"], "force": ["/push", "/pull"], "pose": ["/cube"]}
MARGIN = 96 * 2**20  # bytes that a process takes for itself, whatever the file


def written(tmp, suffix):
    Recording(**ARRAYS).save(tmp / f"a{suffix}")
    return (tmp / f"a{suffix}").read_bytes()


def zipped(tmp):
    file = io.BytesIO()
    np.savez_compressed(file, **ARRAYS)
    return file.getvalue()


def ros(tmp):
    stamps = 10**18 + 10**7 * np.arange(12)
    turned = np.concatenate([ARRAYS["hip"][:, 0], np.tile([0.6, 0.0, 0.8, 0.0], (12, 1))], axis=-1)
    topics = {
        "/tip": ("PointStamped", stamps, ARRAYS["hip"][:, 0]),
        "/other": ("Point", stamps, ARRAYS["hip"][:, 1]),
    }
    topics |= {name: ("WrenchStamped", stamps + 1, ARRAYS["hip"][:, 0]) for name in ("/push", "/pull")}
    return bag(tmp / "a.mcap", topics | {"/cube": ("PoseStamped", stamps, turned)}).read_bytes()


def plain(tmp):
    """Without chunks' compression, so that damage reaches the messages."""
    samples = [{"t": i, "fingers": [{"x": 0.1 * i, "y": 0, "z": -1e-3}]} for i in range(12)]
    return json_file(*samples)


# What is damaged: whole files, how they are called, and how they are read.
FORMATS = {
    "npz": ((functools.partial(written, suffix=".npz"), zipped), ".npz", None),
    "csv": ((functools.partial(written, suffix=".csv"),), ".csv", None),
    "mcap": ((functools.partial(written, suffix=".mcap"), plain), ".mcap", None),
    "ros 2": ((ros,), ".mcap", TOPICS),
    "parquet": ((functools.partial(written, suffix=".parquet"),), ".parquet", None),
}

# Counts that no file of this size has, as 4 or 8 bytes or digits.
COUNTS = [
    (2**k + d).to_bytes(n, "little", signed=False) for k, n in ((31, 4), (63, 8), (40, 8)) for d in (-1, 0)
]
COUNTS += [b"\xff" * 4, b"\xff" * 8, b"\0" * 8, b"9" * 19, b"1e309", b"nan", b"-", b",", b"\n", b'"']
HEADERS = [
    b"PK\x03\x04",
    b"PAR1",
    b"\x89MCAP0\r\n",
    b"\x93NUMPY\x01\x00",
    b"t,hip0_x\n",
    b"\x28\xb5\x2f\xfd",
    b"\xef\xbb\xbf",
]
PLACE = st.floats(0, 1)
DAMAGES = st.lists(
    st.one_of(
        st.tuples(st.just("flip"), PLACE, st.integers(0, 7)),
        st.tuples(st.just("cut"), PLACE, st.none()),
        st.tuples(st.just("insert"), PLACE, st.binary(min_size=1, max_size=8)),
        st.tuples(st.just("overwrite"), PLACE, st.sampled_from(COUNTS)),
        st.tuples(st.just("remove"), PLACE, st.integers(1, 40)),
        st.tuples(st.just("repeat"), PLACE, st.integers(1, 400)),
        st.tuples(st.just("swap"), PLACE, PLACE),
        st.tuples(st.just("head"), PLACE, st.sampled_from(HEADERS)),
    ),
    min_size=1,
    max_size=4,
)


def damaged(whole: bytes, damages) -> bytes:
    for kind, place, how in damages:
        i = int(place * len(whole))
        if kind == "flip":
            whole = whole[:i] + bytes([b ^ 1 << how for b in whole[i : i + 1]]) + whole[i + 1 :]
        elif kind == "cut":
            whole = whole[:i]
        elif kind == "insert":
            whole = whole[:i] + how + whole[i:]
        elif kind == "overwrite":
            whole = whole[:i] + how + whole[i + len(how) :]
        elif kind == "remove":
            whole = whole[:i] + whole[i + how :]
        elif kind == "repeat":
            whole = whole[: i + how] + whole[i:]
        elif kind == "swap":
            whole = whole[i:] + whole[:i] if how < 0.5 else whole[::-1]
        else:
            whole = how + whole[len(how) :]
    return whole


def memory(which: str) -> int:
    """Bytes that this process has now (VmRSS), or had at most (VmHWM)."""
    line = next(line for line in Path("/proc/self/status").read_text().splitlines() if line.startswith(which))
    return 1024 * int(line.split()[1])


def forget_peak() -> bool:
    """Count the peak of memory anew; False where the system does not."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
        return True
    return False


def check(path: Path, content: bytes, topics, load, before: int | None, margin: int = MARGIN) -> None:
    """Read or refused in a sentence, in under 10 s of the processor and, from `before` on, 20 times the file's size."""
    path.write_bytes(content)
    began = time.process_time()
    try:
        load(path, topics)
    except InputError as error:
        said = str(error)
        assert said.startswith(str(path)) and "\n" not in said and len(said) < 4000, said
    assert time.process_time() - began < 10
    if before is not None:
        assert memory("VmHWM") - before < 20 * len(content) + margin


def fuzz(name: str, folder: Path, cases: int, load) -> None:
    makers, suffix, topics = FORMATS[name]
    wholes, path = [make(folder) for make in makers], folder / f"damaged{suffix}"
    for whole in wholes:
        path.write_bytes(whole)
        assert load_recording(path, topics).hip is not None

    @settings(
        max_examples=cases,
        derandomize=True,
        database=None,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
    )
    @given(damages=DAMAGES, which=st.integers(0, len(wholes) - 1))
    def run(damages, which):
        before = memory("VmRSS") if forget_peak() else None  # hypothesis itself takes more and more
        check(path, damaged(wholes[which], damages), topics, load, before)

    run()


@pytest.mark.parametrize("name", FORMATS)
def test_damaged_files_are_read_or_refused(name, tmp_path):
    fuzz(name, tmp_path, 100, Recording.load)


def resting(folder: Path, suffix: str, steps: int) -> bytes:
    """Two fingers that rest while their clock goes on, as small as the format makes it."""
    arrays = {"hip": np.zeros((steps, 2, 3)), "hip_t": 1e-3 * np.arange(steps)}
    path = folder / f"a{suffix}"
    if suffix == ".npz":
        np.savez_compressed(path, **arrays)  # pyright: ignore[reportArgumentType]
    elif suffix == ".parquet":
        columns = {f"hip{f}_{part}": arrays["hip"][:, f, i] for f in (0, 1) for i, part in enumerate("xyz")}
        parquet.write_table(pyarrow.table({"t": arrays["hip_t"], **columns}), path)
    else:
        Recording(**arrays).save(path)
    return path.read_bytes()


# Each some MB to read, or not so many, but then more than 20 times the file.
LARGE = {".npz": 1_000_000, ".parquet": 400_000, ".csv": 40_000, ".mcap": 30_000}


@pytest.mark.parametrize("suffix", LARGE)
@pytest.mark.parametrize("part", [pytest.param(1.0, marks=pytest.mark.slow), 0.1])
def test_large_files_that_shrank_take_no_more_than_20_times_their_size(suffix, part, tmp_path):
    content = resting(tmp_path, suffix, int(LARGE[suffix] * part))
    check_room(tmp_path, suffix, content)


def check_room(folder: Path, suffix: str, content: bytes) -> None:
    small = folder / f"small{suffix}"  # what a process takes for itself is taken before
    Recording(**ARRAYS).save(small)
    load_recording(small)
    gc.collect()
    before = memory("VmRSS") if forget_peak() else None
    check(folder / f"b{suffix}", content, None, load_recording, before, margin=4 * 2**20)


def gone_back() -> bytes:
    """Angles of which one comes too late, as small as the format makes them."""
    gimbal, t = np.zeros((400_000, 8), "u1"), np.arange(400_000.0)
    gimbal[:, :2] = RNG.integers(0, 256, (400_000, 2))  # so that it does not shrink to less than may be read
    gimbal[:, 6:] = 0xF0, 0x3F
    t[100] = 3.0
    file = io.BytesIO()
    np.savez_compressed(file, gimbal=gimbal.view("f8"), gimbal_t=t)
    return file.getvalue()


NAMES = b",".join(b"gimbal%d" % i for i in range(100_000))
# What Python's objects would take far more room for than its text does: refused before they are made.
DENSE = {
    "names": (".csv", b"t," + NAMES + b"\n0\n", "line 1: expected a row of at most 262144 characters"),
    "cells": (
        ".csv",
        b"t,gimbal0\n0,1\n" + b"12," * 400_000,
        "line 3: expected a row of at most 262144 characters",
    ),
    "lines of a cell": (".csv", b"t,gimbal0\n0,1\n" + b'"\n",' * 200_000, "expected a row of at most"),
    "lists": (
        ".mcap",
        json_file(b'{"t": 0, "fingers": [' + b"[]," * 400_000 + b"[]]}"),
        "hip, message 0: expected at most 65536 bytes",
    ),
}


def shrunk(entries: int, messages: int) -> bytes:
    """One chunk, with a channel of so many entries of metadata and so many messages of no bytes."""
    file = io.BytesIO()
    writer = Writer(file, chunk_size=2**30, repeat_channels=False, index_types=IndexType.NONE)
    writer.start()
    channel = writer.register_channel("/hip", "json", 0, {f"{i:x}": "" for i in range(entries)})
    for _ in range(messages):
        writer.add_message(channel, 0, b"", 0)
    writer.finish()
    return file.getvalue()


def test_channels_that_would_take_far_more_as_objects_are_refused(tmp_path):
    check_room(tmp_path, ".mcap", shrunk(entries=100_000, messages=1))
    with pytest.raises(InputError, match="schemas and channels that take at most"):
        load_recording(tmp_path / "b.mcap")


def test_recovering_many_messages_takes_no_more_than_20_times_the_size(tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(shrunk(entries=0, messages=30_000))
    tracemalloc.start()
    try:
        assert recover(path, tmp_path / "out.mcap").messages == {"/hip": 30_000}
        assert tracemalloc.get_traced_memory()[1] < 6.5 * 2**20  # of it 5 the writer's; with all as objects 8
    finally:
        tracemalloc.stop()


def test_a_table_of_many_columns_and_no_rows_is_refused(tmp_path):
    file = io.BytesIO()
    names = ["t", *(f"gimbal{i}" for i in range(20_000))]
    schema = pyarrow.schema([(name, pyarrow.float64()) for name in names])
    parquet.ParquetWriter(file, schema, store_schema=False).close()
    check_room(tmp_path, ".parquet", file.getvalue())
    with pytest.raises(InputError, match="bytes at its end"):
        load_recording(tmp_path / "b.parquet")


def test_a_time_that_goes_back_takes_no_more_than_20_times_the_size(tmp_path):
    check_room(tmp_path, ".npz", gone_back())


@pytest.mark.parametrize("name", DENSE)
def test_what_would_take_far_more_as_objects_is_refused(name, tmp_path):
    suffix, content, said = DENSE[name]
    check_room(tmp_path, suffix, content)
    with pytest.raises(InputError, match=said):
        load_recording(tmp_path / f"b{suffix}")


def lying(folder: Path) -> bytes:
    """A table of a million rows, whose end says that they are 10."""
    rows, said = 1_000_000, 10
    path = folder / "a.parquet"
    one = pyarrow.array(np.zeros(rows))
    whole = {
        "compression": "zstd",
        "use_dictionary": False,
        "write_statistics": False,
        "data_page_size": 2**30,
    }
    parquet.write_table(
        pyarrow.table({"t": one, "gimbal0": one}),
        path,
        write_batch_size=rows,
        max_rows_per_page=rows,
        **whole,
    )
    data = path.read_bytes()
    end = data[: len(data) - 8 - int.from_bytes(data[-8:-4], "little")]
    foot = data[len(end) : -8]
    group = parquet.ParquetFile(path).metadata.row_group(0)
    sizes = {rows: said, group.total_byte_size: 16 * said}
    sizes |= {group.column(i).total_uncompressed_size: 8 * said for i in (0, 1)}
    for true, false in sizes.items():
        old, new = bytearray(), bytearray()
        for number, digits in ((true, old), (false, new)):
            number *= 2
            while number or len(digits) < len(old):
                digits.append(number & 127 | 128)
                number >>= 7
            digits[-1] &= 127
        assert bytes(old) in foot
        foot = foot.replace(old, new)
    return end + foot + data[-8:]


def test_a_table_that_is_larger_than_its_end_says_is_refused(tmp_path):
    content = lying(tmp_path)
    (tmp_path / "a.parquet").write_bytes(content)
    assert parquet.ParquetFile(tmp_path / "a.parquet").metadata.row_group(0).total_byte_size == 160
    check_room(tmp_path, ".parquet", content)
    with pytest.raises(InputError, match="to unpack to at most .*, found 16000"):
        load_recording(tmp_path / "b.parquet")


@pytest.mark.parametrize("compression", ["zstd", "snappy", "none"])
@pytest.mark.parametrize("version", ["1.0", "2.0"])
def test_pages_of_every_kind_say_what_they_unpack_to(compression, version, tmp_path):
    """As the end of a sound file says: with and without dictionaries, statistics, nulls, many pages and groups."""
    path = tmp_path / "a.parquet"
    few, all_ = np.repeat([0.0, 1.0], 500), RNG.normal(size=1000)
    columns = {"few": pyarrow.array(few, mask=few == 1), "all": pyarrow.array(all_)}
    parquet.write_table(
        pyarrow.table(columns),
        path,
        compression=compression,
        data_page_version=version,
        row_group_size=400,
        data_page_size=500,
        write_page_checksum=True,
    )
    about = parquet.ParquetFile(path).metadata
    said = sum(about.row_group(g).column(c).total_uncompressed_size for g in range(3) for c in range(2))
    with path.open("rb") as file:
        found = parquet_file._unpacked(file, about)
    assert 0.8 * said < found < said  # theirs counts the headers, too


@pytest.fixture
def without_type_checks():
    """They take most of the time, and change nothing."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMATS)
def test_many_damaged_files_are_read_or_refused(name, tmp_path, without_type_checks):
    fuzz(name, tmp_path, 1000, load_recording)
