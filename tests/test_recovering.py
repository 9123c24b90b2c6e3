"""Recovery: of a file that was cut or damaged anywhere, all that is whole is kept, and what is lost is said."""

import io
import json

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from hapjax import InputError, load_recording
from hapjax.cli import main
from hapjax.recording.recovering import recover


def written(compression=CompressionType.ZSTD, chunks=6, each=8):
    """A file of so many chunks with so many messages each, with an attachment and metadata, and where each chunk ends."""
    file, ends = io.BytesIO(), []
    writer = Writer(file, compression=compression)
    writer.start("", "hapjax")
    writer.add_metadata("hapjax.run", {"run": "lift"})
    writer.add_attachment(1, 2, "scene.toml", "application/toml", b"[object.cube]\n")
    schema = writer.register_schema("hapjax.hip", "jsonschema", b'{"type":"object"}')
    channel = writer.register_channel("/hip", "json", schema)
    noise = np.random.default_rng(3)
    for chunk in range(chunks):
        for row in range(each):
            t = (chunk * each + row) / 1000
            said = {"t": t, "fingers": [dict(zip("xyz", noise.normal(size=3).tolist(), strict=True))]}
            writer.add_message(channel, round(t * 1e9), json.dumps(said).encode(), round(t * 1e9), row)
        writer.flush()
    writer.finish()
    data = file.getvalue()
    summary = make_reader(io.BytesIO(data)).get_summary()
    assert summary is not None
    for index in summary.chunk_indexes:
        ends.append((index.chunk_start_offset, index.chunk_start_offset + index.chunk_length))
    return data, ends


WHOLE, CHUNKS = written()


def recovered(tmp_path, data, name="cut.mcap"):
    path, out = tmp_path / name, tmp_path / "out.mcap"
    path.write_bytes(data)
    out.unlink(missing_ok=True)
    found = recover(path, out)
    assert path.read_bytes() == data
    return found, out


def content(path):
    """Messages, attachments and metadata by the library's own reader, which needs index and footer."""
    with open(path, "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        messages = [(c.topic, m.log_time, m.sequence, m.data) for _, c, m in reader.iter_messages()]
        attached = [(a.name, a.data, a.create_time, a.log_time) for a in reader.iter_attachments()]
        return messages, attached, [m.metadata for m in reader.iter_metadata()]


@pytest.fixture(scope="module")
def all_messages(tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "whole.mcap"
    path.write_bytes(WHOLE)
    return content(path)


def test_cut_anywhere_all_whole_chunks_are_kept(tmp_path, all_messages):
    """At every 29th byte, and right before, at and after the end of each chunk."""
    near = {end + k for _, end in CHUNKS for k in (-1, 0, 1)}
    first = CHUNKS[0][0]  # the attachment and the metadata are before it
    for cut in sorted({*range(8, len(WHOLE), 29), *near}):
        expected = 8 * sum(end <= cut for _, end in CHUNKS)
        if cut < first - 30:
            continue  # nothing, or not all, of what stands before the chunks
        found, out = recovered(tmp_path, WHOLE[:cut])
        messages, attached, metadata = content(out)
        assert messages == all_messages[0][:expected], cut
        assert found.messages.total() == expected and not found.whole and found.lost, cut
        if cut >= first:
            assert (attached, metadata) == all_messages[1:], cut


def test_a_recovered_recording_loads_as_if_whole(tmp_path):
    found, out = recovered(tmp_path, WHOLE[: CHUNKS[3][1] + 11])
    recording = load_recording(out)
    assert recording.hip is not None and recording.findings == ()
    cut = load_recording(tmp_path / "cut.mcap")
    np.testing.assert_array_equal(recording.hip, cut.hip)
    assert len(recording.hip) == 32 and found.messages == {"/hip": 32}


@pytest.mark.parametrize("compression", list(CompressionType))
def test_a_damaged_chunk_is_left_out_and_said(tmp_path, all_messages, compression):
    data, ends = written(compression)
    for chunk, (begin, end) in enumerate(ends):
        at = (begin + end) // 2
        found, out = recovered(tmp_path, data[:at] + bytes([data[at] ^ 0x40]) + data[at + 1 :])
        kept = all_messages[0][: 8 * chunk] + all_messages[0][8 * chunk + 8 :]
        assert content(out)[0] == kept
        (sentence,) = found.lost
        assert sentence.startswith(f"{end - begin} bytes at {begin}: ") and not found.whole


def test_behind_a_damaged_length_the_next_chunk_is_found(tmp_path, all_messages):
    begin, end = CHUNKS[2]
    for length in (b"\xff" * 8, b"\x00" * 8, (3).to_bytes(8, "little")):
        found, out = recovered(tmp_path, WHOLE[: begin + 1] + length + WHOLE[begin + 9 :])
        assert content(out)[0] == all_messages[0][:16] + all_messages[0][24:]
        assert found.lost and not found.whole


def test_damage_of_any_byte_costs_a_chunk_at_most(tmp_path, all_messages):
    random = np.random.default_rng(0)
    for at in random.integers(CHUNKS[0][0], len(WHOLE), 60):
        _, out = recovered(tmp_path, WHOLE[:at] + bytes([WHOLE[at] ^ 0xFF]) + WHOLE[at + 1 :])
        messages = content(out)[0]
        assert len(messages) >= 40 and set(messages) <= set(all_messages[0]), at


def test_it_says_how_far_it_is(tmp_path):
    (tmp_path / "cut.mcap").write_bytes(WHOLE[: CHUNKS[-1][1]])
    parts = []
    recover(tmp_path / "cut.mcap", tmp_path / "out.mcap", lambda _, part: parts.append(part))
    assert len(parts) > 1 and min(parts) > 0.01 and 0.9 < sum(parts) <= 1


def test_what_cannot_be_recovered_is_refused(tmp_path):
    for data, words in (
        (b"", "expected an MCAP file, found 0 bytes"),
        (b"t,hip0_x\n0,1\n", "found another format"),
        (WHOLE[:20], "found nothing"),
    ):
        with pytest.raises(InputError, match=words):
            recovered(tmp_path, data)
        assert not (tmp_path / "out.mcap").exists()
    (tmp_path / "out.mcap").write_text("mine")
    (tmp_path / "cut.mcap").write_bytes(WHOLE)
    with pytest.raises(InputError, match="out.mcap: exists"):
        recover(tmp_path / "cut.mcap", tmp_path / "out.mcap")


def test_the_command_says_what_is_lost(tmp_path, capsys):
    path = tmp_path / "lift.mcap"
    path.write_bytes(WHOLE[: CHUNKS[3][1] + 11])
    assert main(["recover", str(path)]) == 0
    said = capsys.readouterr()
    assert said.out == f"{tmp_path}/lift-recovered.mcap: 32 messages (/hip 32)\n"
    assert said.err == f"hapjax: {path}: lost: the last 11 bytes: no whole part\n"
    assert main(["recover", str(path)]) == 2
    assert "lift-recovered.mcap: exists" in capsys.readouterr().err
    path.write_bytes(WHOLE)
    assert main(["recover", str(path), "--out", str(tmp_path / "copy.mcap")]) == 0
    said = capsys.readouterr()
    assert "copy.mcap: 48 messages (/hip 48); the file was whole" in said.out and said.err == ""
    assert main(["recover", str(tmp_path / "nowhere.mcap")]) == 2
    assert "nowhere.mcap: cannot be read: No such file" in capsys.readouterr().err
