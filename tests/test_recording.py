"""Recordings come back bit for bit; a malformed one is refused in one sentence that says where and why."""

import io
import zipfile

import hypothesis.extra.numpy as hnp
import hypothesis.strategies as st
import numpy as np
import pytest
from hypothesis import given

from hapjax import InputError, Recording

CHANNELS = ("hip", "force", "gimbal", "pose", "model_force")


def unit_quaternions(rng, *shape):
    q = rng.normal(size=(*shape, 4))
    return q / np.linalg.norm(q, axis=-1, keepdims=True)


def assert_same(one, other):
    for name in (name + end for name in CHANNELS for end in ("", "_t")):
        a, b = getattr(one, name), getattr(other, name)
        assert (a is None) == (b is None), name
        if a is not None:
            np.testing.assert_array_equal(a, b, err_msg=name)
            assert a.dtype == b.dtype == np.float64


@st.composite
def arrays_of_recordings(draw):
    fingers, objects = draw(st.integers(1, 3)), draw(st.integers(1, 2))
    shapes = {"hip": (fingers, 3), "force": (fingers, 3), "gimbal": (fingers,), "pose": (objects, 7)}
    shapes["model_force"] = shapes["force"]
    measured = draw(st.sets(st.sampled_from(CHANNELS), min_size=1))
    finite = st.floats(allow_nan=False, allow_infinity=False)
    arrays = {}
    for name in measured:
        times = draw(st.lists(finite, min_size=1, max_size=5, unique=True))
        arrays[f"{name}_t"] = np.array(sorted(times))
        arrays[name] = draw(hnp.arrays(np.float64, (len(times), *shapes[name]), elements=finite))
    if "pose" in arrays:
        rng = np.random.default_rng(draw(st.integers(0, 2**32)))
        arrays["pose"][..., 3:] = unit_quaternions(rng, len(arrays["pose_t"]), objects)
    return arrays


@given(arrays=arrays_of_recordings(), suffix=st.sampled_from([".npz", ".csv", ".mcap", ".parquet"]))
def test_every_number_comes_back(arrays, suffix, tmp_path_factory):
    recording = Recording(**arrays)
    path = tmp_path_factory.mktemp("round") / f"trip{suffix}"
    recording.save(path)
    assert_same(Recording.load(path), recording)
    assert [file.name for file in path.parent.iterdir()] == [path.name]


def test_more_than_ten_fingers_keep_their_order(tmp_path):
    recording = Recording(hip=np.arange(72.0).reshape(2, 12, 3), hip_t=np.arange(2.0))
    recording.save(tmp_path / "hands.csv")
    assert_same(Recording.load(tmp_path / "hands.csv"), recording)


def test_quaternions_are_normalised_once():
    pose = np.array([[0.0, 0.0, 0.1, 0.9995, 0.0, 0.0, 0.01], [0.0, 0.0, 0.1, 0.5, 0.5, 0.5, -0.5003]])
    first = Recording(pose=pose, pose_t=np.array([0.0, 1.0]))
    assert first.pose is not None and first.pose.shape == (2, 1, 7)
    np.testing.assert_allclose(np.linalg.norm(first.pose[..., 3:], axis=-1), 1, rtol=0, atol=1e-15)
    cosine = np.sum(first.pose[:, 0, 3:] * pose[:, 3:], axis=-1) / np.linalg.norm(pose[:, 3:], axis=-1)
    np.testing.assert_allclose(cosine, 1, rtol=0, atol=1e-15)
    assert_same(Recording(pose=first.pose, pose_t=first.pose_t), first)


def test_csv_is_read_as_it_is_described(tmp_path):
    """Columns in any order, spaces after commas, blank lines, empty cells: the clocks come apart again."""
    path = tmp_path / "two_fingers.CSV"
    path.write_text(
        "\ufeffgimbal0, gimbal1, t, force1_x, force1_y, force1_z, force0_x, force0_y, force0_z, "
        "pose_x, pose_y, pose_z, pose_qw, pose_qx, pose_qy, pose_qz\n"
        ", , -0.5, 4, 5, 6, 1, 2, 3, 0, 0, 0.03, 1, 0, 0, 0\n"
        "\n"
        "0.1, 0.2, 0.0, , , , , , , , , , , , ,\n"
        "0.3, 0.4, 1e-3, 10, 11, 12, 7, 8, 9, , , , , , ,\n"
    )
    recording = Recording.load(path)
    expected = Recording(
        force=np.arange(1.0, 13.0).reshape(2, 2, 3),
        force_t=np.array([-0.5, 0.001]),
        gimbal=np.array([[0.1, 0.2], [0.3, 0.4]]),
        gimbal_t=np.array([0.0, 0.001]),
        pose=np.array([[0, 0, 0.03, 1, 0, 0, 0]]),
        pose_t=np.array([-0.5]),
    )
    assert_same(recording, expected)
    assert recording.fingers == 2


def test_csv_is_written_as_it_is_described(tmp_path):
    path = tmp_path / "one.csv"
    recording = Recording(
        hip=np.array([[[0.1, 0.2, 0.3]], [[0.4, 0.5, 0.6]]]),
        hip_t=np.array([0.0, 0.001]),
        pose=np.array([[0.0, 0.0, 0.03, 1.0, 0.0, 0.0, 0.0]]),
        pose_t=np.array([0.0005]),
    )
    recording.save(path)
    assert path.read_text() == (
        "t,hip0_x,hip0_y,hip0_z,pose_x,pose_y,pose_z,pose_qw,pose_qx,pose_qy,pose_qz\n"
        "0.0,0.1,0.2,0.3,,,,,,,\n"
        "0.0005,,,,0.0,0.0,0.03,1.0,0.0,0.0,0.0\n"
        "0.001,0.4,0.5,0.6,,,,,,,\n"
    )


def test_one_object_may_be_numbered(tmp_path):
    path = tmp_path / "numbered.csv"
    columns = ",".join(f"pose0_{part}" for part in ("x", "y", "z", "qw", "qx", "qy", "qz"))
    path.write_text(f"t,{columns}\n0,0,0,0,1,0,0,0\n")
    pose = Recording.load(path).pose
    assert pose is not None and pose.shape == (1, 1, 7)


def test_a_column_never_filled_is_a_channel_not_measured(tmp_path):
    path = tmp_path / "empty_force.csv"
    path.write_text("t,hip0_x,hip0_y,hip0_z,force0_x,force0_y,force0_z\n0,1,2,3,,,\n")
    recording = Recording.load(path)
    assert recording.force is None and recording.force_t is None and recording.fingers == 1


def test_arrays_are_the_recordings_own():
    times, hip = np.array([0, 1], np.int32), np.zeros((2, 1, 3))
    recording = Recording(hip=hip, hip_t=times)
    hip[:] = 5
    assert recording.hip is not None and recording.hip_t is not None
    assert recording.hip.dtype == recording.hip_t.dtype == np.float64
    assert not recording.hip.any()
    with pytest.raises(ValueError, match="read-only"):
        recording.hip[0] = 1


def test_objects_alone_have_no_fingers():
    assert Recording(pose=np.array([[0.0, 0, 0, 1, 0, 0, 0]]), pose_t=np.zeros(1)).fingers == 0


def test_a_failed_save_leaves_the_old_file(tmp_path, monkeypatch):
    path = tmp_path / "kept.npz"
    recording = Recording(hip=np.zeros((1, 1, 3)), hip_t=np.zeros(1))
    recording.save(path)
    before = path.read_bytes()

    def full(file, **arrays):
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", full)
    with pytest.raises(OSError, match="cannot be written: No space left on device") as caught:
        recording.save(path)
    assert caught.value.filename == str(path)  # the system's failure, not bad input
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", ["absent/file.npz", "wrong.mat", "none", "folder.npz"])
def test_what_cannot_be_saved_is_refused(tmp_path, name):
    (tmp_path / "folder.npz").mkdir()
    recording = Recording(hip=np.zeros((1, 1, 3)), hip_t=np.zeros(1))
    with pytest.raises(InputError) as caught:
        recording.save(tmp_path / name)
    assert name in str(caught.value)
    assert [file.name for file in tmp_path.iterdir()] == ["folder.npz"]


HEAD = "t,hip0_x,hip0_y,hip0_z\n"
POSE = "t,pose_x,pose_y,pose_z,pose_qw,pose_qx,pose_qy,pose_qz\n"

MALFORMED_CSV = {
    "empty file": ("", ["empty file"]),
    "only blank lines": ("\n \n", ["empty file"]),
    "header alone": (HEAD, ["nothing is recorded", "hip, force, gimbal, pose"]),
    "times alone": ("t\n0\n1\n", ["nothing is recorded"]),
    "no time column": ("hip0_x,hip0_y,hip0_z\n1,2,3\n", ["line 1", "'t'"]),
    "header after a blank line": ("\nhip0_x,hip0_y,hip0_z\n1,2,3\n", ["line 2", "'t'"]),
    "unknown column": ("t,hip0_x,hip0_y,hip0_z,temperature\n0,1,2,3,4\n", ["line 1", "'temperature'"]),
    "column without a name": ("t,hip0_x,hip0_y,hip0_z,\n0,1,2,3,\n", ["line 1", "unknown column ''"]),
    "unknown part": ("t,hip0_x,hip0_y,hip0_z,hip0_w\n0,1,2,3,4\n", ["line 1", "'hip0_w'"]),
    "finger without a number": ("t,hip_x,hip_y,hip_z\n0,1,2,3\n", ["line 1", "'hip_x'", "hip0_x"]),
    "finger with two noughts": ("t,hip00_x,hip00_y,hip00_z\n0,1,2,3\n", ["line 1", "'hip00_x'"]),
    "finger number out of all bounds": ("t,gimbal999999\n0,1\n", ["line 1", "'gimbal999999'"]),
    "finger left out": ("t,gimbal0,gimbal2\n0,1,2\n", ["line 1", "'gimbal1' is missing"]),
    "coordinate left out": ("t,hip0_x,hip0_z\n0,1,3\n", ["line 1", "'hip0_y' is missing"]),
    "quaternion left out": ("t,pose_x,pose_y,pose_z\n0,0,0,0\n", ["line 1", "'pose_qw' is missing"]),
    "numbered and plain pose": (POSE.replace("pose_y", "pose0_y"), ["line 1", "'pose_x'"]),
    "repeated column": ("t,hip0_x,hip0_y,hip0_x\n0,1,2,3\n", ["line 1", "'hip0_x'", "2 times"]),
    "semicolons": ("t;hip0_x;hip0_y;hip0_z\n0;1;2;3\n", ["line 1", "'t'"]),
    "row too short": (HEAD + "0,1,2,3\n1,1,2\n", ["line 3", "expected 4 cells, found 3"]),
    "row too long": (HEAD + "0,1,2,3,4\n", ["line 2", "expected 4 cells, found 5"]),
    "word for a number": (HEAD + "0,1,2,3\n1,1,two,3\n", ["line 3", "column hip0_y", "'two'"]),
    "decimal comma": (HEAD + '0,"1,5",2,3\n', ["line 2", "column hip0_x", "'1,5'"]),
    "underscores in a number": (HEAD + "0,1_000,2,3\n", ["line 2", "column hip0_x", "'1_000'"]),
    "no time in a row": (HEAD + ",1,2,3\n", ["line 2", "column t", "''"]),
    "part of a sample": (HEAD + "0,1,,3\n", ["line 2", "hip", "hip0_y empty"]),
    "NaN": (HEAD + "0,1,2,3\n1,1,nan,3\n", ["hip, line 3", "finite", "nan"]),
    "infinity": (HEAD + "0,1,2,-inf\n", ["hip, line 2", "finite", "-inf"]),
    "number too large": (HEAD + "0,1,2,1e999\n", ["hip, line 2", "finite", "inf"]),
    "time is NaN": (HEAD + "0,1,2,3\n\nnan,1,2,3\n", ["hip, line 4", "finite", "time nan"]),
    "time goes back": (HEAD + "0,1,2,3\n\n2,1,2,3\n1,1,2,3\n", ["hip, line 5", "after 2.0 s", "found 1.0 s"]),
    "time stands still": (HEAD + "0,1,2,3\n0,1,2,3\n", ["hip, line 3", "after 0.0 s", "found 0.0 s"]),
    "quaternion off one": (
        POSE + "0,0,0,0,1,0,0,0\n1,0,0,0,1,1,0,0\n",
        ["pose, line 3", "norm 1", "1.41421"],
    ),
    "quaternion zero": (POSE + "0,0,0,0,0,0,0,0\n", ["pose, line 2", "norm 1", "found 0 of object 0"]),
    "quaternion overflows": (POSE + "0,0,0,0,1e300,0,0,0\n", ["pose, line 2", "norm 1", "found inf"]),
    "counts differ": (
        HEAD[:-1] + ",gimbal0,gimbal1\n0,1,2,3,4,5\n",
        ["gimbal", "as hip has, 1", "found 2"],
    ),
    "no text": (b"t,hip0_x\xff\xfe\n", ["UTF-8"]),
    "no text further down": (HEAD.encode() + b"0,1,2,\x80\n", ["UTF-8"]),
    "field without end": (HEAD + '0,"' + "1" * 200_000, ["line 2", "comma-separated"]),
}

T2, HIP2 = np.array([0.0, 1.0]), np.zeros((2, 1, 3))
UNIT = np.array([[0.0, 0, 0, 1, 0, 0, 0]] * 2)

MALFORMED_NPZ = {
    "no arrays": ({}, ["nothing is recorded"]),
    "no times": ({"hip": HIP2}, ["hip", "times are missing", "hip_t"]),
    "times alone": ({"hip_t": T2}, ["hip", "only its times", "(T, F, 3)"]),
    "unknown array": ({"hip": HIP2, "hip_t": T2, "velocity": HIP2}, ["'velocity'", "hip, hip_t, force"]),
    "one finger without its axis": ({"hip": np.zeros((2, 3)), "hip_t": T2}, ["hip", "(T, F, 3)", "(2, 3)"]),
    "two coordinates": ({"force": np.zeros((2, 1, 2)), "force_t": T2}, ["force", "(T, F, 3)", "(2, 1, 2)"]),
    "gimbal with an axis too many": ({"gimbal": HIP2, "gimbal_t": T2}, ["gimbal", "(T, F)", "(2, 1, 3)"]),
    "pose without quaternion": ({"pose": np.zeros((2, 3)), "pose_t": T2}, ["pose", "(T, O, 7)", "(2, 3)"]),
    "one number": ({"hip": np.float64(1), "hip_t": T2}, ["hip", "(T, F, 3)", "()"]),
    "times in columns": ({"hip": HIP2, "hip_t": T2[:, None]}, ["hip_t", "(T,)", "(2, 1)"]),
    "more samples than times": ({"hip": HIP2, "hip_t": T2[:1]}, ["hip", "2 samples", "1 times"]),
    "no samples": ({"hip": HIP2[:0], "hip_t": T2[:0]}, ["hip", "found none", "(0, 1, 3)"]),
    "no fingers": ({"hip": HIP2[:, :0], "hip_t": T2}, ["hip", "some fingers", "(2, 0, 3)"]),
    "NaN": ({"hip": HIP2 * [[[1.0]], [[np.nan]]], "hip_t": T2}, ["hip, row 1", "value nan"]),
    "infinite time": ({"hip": HIP2, "hip_t": np.array([0, np.inf])}, ["hip, row 1", "time inf"]),
    "time goes back": ({"hip": HIP2, "hip_t": T2[::-1]}, ["hip, row 1", "after 1.0 s", "found 0.0 s"]),
    "quaternion off one": ({"pose": UNIT * [[1], [1.01]], "pose_t": T2}, ["pose, row 1", "norm 1", "1.01"]),
    "complex": ({"hip": HIP2 * 1j, "hip_t": T2}, ["hip", "real numbers", "complex128"]),
    "truth values": ({"hip": HIP2 > 0, "hip_t": T2}, ["hip", "real numbers", "bool"]),
    "strings": ({"hip": HIP2.astype("U3"), "hip_t": T2}, ["hip", "real numbers", "<U"]),
    "dates": ({"hip": HIP2, "hip_t": T2.astype("datetime64[s]")}, ["hip_t", "real numbers", "datetime64"]),
    "pickled objects": ({"hip": HIP2.astype(object), "hip_t": T2}, ["hip", "real numbers", "pickled"]),
    "counts differ": (
        {"hip": HIP2, "hip_t": T2, "force": np.zeros((2, 3, 3)), "force_t": T2},
        ["force", "as many fingers as hip has, 1", "found 3"],
    ),
}


def npz(**arrays):
    file = io.BytesIO()
    np.savez(file, **arrays)
    return file.getvalue()


def npy(array):
    file = io.BytesIO()
    np.save(file, array)
    return file.getvalue()


def header(shape):
    file = io.BytesIO()
    np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": shape})
    return file.getvalue()


def zipped(members, compression=zipfile.ZIP_STORED):
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", compression) as archive:
        for name, content in members:
            archive.writestr(name, content)
    return file.getvalue()


WHOLE = npz(hip=np.ones((50, 1, 3)), hip_t=np.arange(50.0))
DAMAGED = WHOLE.replace(np.arange(50.0).tobytes(), np.arange(1, 51.0).tobytes())
HEADER_OF_PETABYTES = header((10**15,))

MALFORMED_FILES = {
    "empty.npz": (b"", ["empty"]),
    "text.npz": (b"t,hip0_x\n", ["NPZ", "another format"]),
    "single_array.npz": (npy(T2), ["NPZ", "another format"]),
    "cut_short.npz": (WHOLE[: len(WHOLE) // 2], ["cut short"]),
    "wrong_checksum.npz": (DAMAGED, ["hip_t", "damaged"]),
    "no_array.npz": (zipped([("hip.npy", b"just text")]), ["hip", "damaged"]),
    "array_cut_short.npz": (
        zipped([("hip.npy", npy(HIP2)[:-8]), ("hip_t.npy", npy(T2))]),
        ["hip", "damaged"],
    ),
    "array_of_petabytes.npz": (zipped([("hip.npy", HEADER_OF_PETABYTES)]), ["hip", "damaged"]),
    "other_members.npz": (zipped([("hip.npy", npy(HIP2)), ("notes.txt", b"")]), ["'notes.txt'"]),
    "bomb.npz": (
        zipped([("hip.npy", bytes(80 * 2**20)), ("hip_t.npy", npy(T2))], zipfile.ZIP_DEFLATED),
        ["83886", "at most", "save it uncompressed"],
    ),
    "data.mat": (b"MATLAB", ["*.npz, *.csv, *.mcap, *.parquet"]),
    "no_suffix": (b"t,hip0_x\n", ["*.npz, *.csv, *.mcap, *.parquet"]),
}


def assert_refused(path, fragments):
    with pytest.raises(InputError) as caught:
        Recording.load(path)
    message = str(caught.value)
    assert message.startswith(str(path)) and "\n" not in message
    for fragment in fragments:
        assert fragment in message.removeprefix(str(path)), message


@pytest.mark.parametrize(("text", "fragments"), MALFORMED_CSV.values(), ids=MALFORMED_CSV)
def test_malformed_csv_is_refused(tmp_path, text, fragments):
    path = tmp_path / "bad.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    assert_refused(path, fragments)


@pytest.mark.parametrize(("arrays", "fragments"), MALFORMED_NPZ.values(), ids=MALFORMED_NPZ)
def test_malformed_npz_is_refused(tmp_path, arrays, fragments):
    path = tmp_path / "bad.npz"
    path.write_bytes(npz(**arrays))
    assert_refused(path, fragments)


@pytest.mark.parametrize(("name", "content", "fragments"), [(k, *v) for k, v in MALFORMED_FILES.items()])
def test_malformed_files_are_refused(tmp_path, name, content, fragments):
    path = tmp_path / name
    path.write_bytes(content)
    assert_refused(path, fragments)


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_an_array_stored_twice_is_refused(tmp_path):
    path = tmp_path / "twice.npz"
    path.write_bytes(zipped([("hip.npy", npy(HIP2)), ("hip.npy", npy(HIP2)), ("hip_t.npy", npy(T2))]))
    assert_refused(path, ["'hip'", "2 times"])


@pytest.mark.parametrize("name", ["absent.npz", "absent.csv", "folder.npz", "folder.csv"])
def test_what_is_no_file_is_refused(tmp_path, name):
    for folder in ("folder.npz", "folder.csv"):
        (tmp_path / folder).mkdir()
    assert_refused(tmp_path / name, ["cannot be read"])
