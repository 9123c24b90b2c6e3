"""MCAP: the recorder's files, whole and cut short, and ROS 2 bags by the names of their topics."""

import io
import json
from typing import Any

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_ros2.writer import Writer as RosWriter

from hapjax import InputError, Recording, load_recording

T = 1.7e9 + 1e-3 * np.arange(600)  # s since 1970, as robots have them
HIP = np.stack([0.03 * np.sin(T - T[0] + k) for k in range(6)], axis=-1).reshape(-1, 2, 3)
FORCE = 2 * HIP[:, ::-1]


def saved(path, **arrays: Any):
    Recording(**(arrays or dict(hip=HIP, hip_t=T - T[0], force=FORCE[::10], force_t=(T - T[0])[::10]))).save(
        path
    )
    return path


def test_what_is_written_is_json_with_a_schema(tmp_path):
    """Read by the library's own reader: topics, schemas, log times, names of the numbers."""
    with open(saved(tmp_path / "a.mcap"), "rb") as file:
        found = list(make_reader(file).iter_messages())
    assert {channel.topic for _, channel, _ in found} == {"/hip", "/force"}
    assert len(found) == 660
    times = [message.log_time for _, _, message in found]
    assert times == sorted(times) and abs(times[-1] - 599 * 10**6) < 1000
    for schema, channel, message in found[:20]:
        assert schema is not None
        described, said = json.loads(schema.data), json.loads(message.data)
        assert (schema.encoding, channel.message_encoding) == ("jsonschema", "json")
        assert set(described["properties"]) == set(said) == {"t", "fingers"}
        assert set(described["properties"]["fingers"]["items"]["properties"]) == set(said["fingers"][0])
    said = json.loads(found[0][2].data)
    assert [list(finger.values()) for finger in said["fingers"]] in (HIP[0].tolist(), FORCE[0].tolist())


def test_a_file_whose_writer_was_killed_is_read_as_far_as_it_is_whole(tmp_path):
    whole = saved(tmp_path / "a.mcap", hip=HIP.repeat(3, axis=0), hip_t=np.arange(1800.0)).read_bytes()
    path, counts = tmp_path / "cut.mcap", []
    assert Recording.load(tmp_path / "a.mcap").findings == ()
    for share in (0.3, 0.6, 0.97):
        path.write_bytes(whole[: int(share * len(whole))])
        recording = Recording.load(path)
        assert recording.hip is not None
        (finding,) = recording.findings
        assert finding.kind == "cut short" and f"{len(recording.hip)} messages" in finding.sentence
        np.testing.assert_array_equal(recording.hip, HIP.repeat(3, axis=0)[: len(recording.hip)])
        counts.append(len(recording.hip))
    assert counts == sorted(counts) and 0.1 * 1800 < counts[0] and counts[-1] > 0.6 * 1800


def json_file(*messages, topic="/hip", encoding="json", compression=CompressionType.NONE):
    file = io.BytesIO()
    writer = Writer(file, compression=compression)
    writer.start()
    schema = writer.register_schema("hapjax.hip", "jsonschema", b"{}")
    channel = writer.register_channel(topic, encoding, schema)
    for i, message in enumerate(messages):
        writer.add_message(
            channel, i, message if isinstance(message, bytes) else json.dumps(message).encode(), i
        )
    writer.finish()
    return file.getvalue()


ONE = {"t": 0.0, "fingers": [{"x": 0.0, "y": 0.0, "z": 1}]}
REFUSED = {
    "empty": (b"", ["empty"]),
    "text": (b"t,hip0_x\n0,1\n" * 20, ["MCAP", "another format"]),
    "no messages": (json_file(), ["/hip", "no messages"]),
    "other topic": (json_file(ONE, topic="/wrench"), ["/hip", "/wrench (hapjax.hip)", "--topic"]),
    "no JSON": (json_file(ONE, b"{"), ["hip, message 1", '"fingers":[{"x":0.0']),
    "no time": (json_file({"fingers": ONE["fingers"]}), ["hip, message 0"]),
    "a part missing": (json_file({"t": 0, "fingers": [{"x": 0, "y": 0}]}), ["hip, message 0"]),
    "a word": (json_file({"t": 0, "fingers": [{"x": 0, "y": 0, "z": "up"}]}), ["hip, message 0", "up"]),
    "a truth value": (json_file({"t": 0, "fingers": [{"x": 0, "y": 0, "z": True}]}), ["hip, message 0"]),
    "no fingers": (json_file({"t": 0, "fingers": []}), ["hip, message 0"]),
    "other count": (
        json_file(ONE, {"t": 1, "fingers": ONE["fingers"] * 2}),
        ["message 1", "1 fingers as before"],
    ),
    "time goes back": (json_file(ONE | {"t": 1}, ONE), ["hip, message 1", "after 1.0 s"]),
    "NaN": (json_file(ONE, b'{"t": 1, "fingers": [{"x": 0, "y": NaN, "z": 0}]}'), ["hip, message 1", "nan"]),
}


@pytest.mark.parametrize(("content", "fragments"), REFUSED.values(), ids=REFUSED)
def test_malformed_files_are_refused(tmp_path, content, fragments):
    path = tmp_path / "bad.mcap"
    path.write_bytes(content)
    with pytest.raises(InputError) as caught:
        Recording.load(path)
    message = str(caught.value)
    assert message.startswith(str(path)) and "\n" not in message
    for fragment in fragments:
        assert fragment in message, message


@pytest.mark.parametrize("compression", list(CompressionType))
def test_a_damaged_chunk_is_refused(tmp_path, compression):
    content = json_file(*[ONE | {"t": i} for i in range(500)], compression=compression)
    (tmp_path / "whole.mcap").write_bytes(content)
    assert len(Recording.load(tmp_path / "whole.mcap").hip_t) == 500  # pyright: ignore[reportArgumentType]
    middle = content.index(b"chunk") if b"chunk" in content else 400
    (tmp_path / "bad.mcap").write_bytes(content[:middle] + b"?" + content[middle + 1 :])
    with pytest.raises(InputError, match="expected a whole MCAP file, found"):
        Recording.load(tmp_path / "bad.mcap")


# ROS 2 ----------------------------------------------------------------------------------------------------

HEADER = "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id"
VECTOR = "MSG: geometry_msgs/{}\nfloat64 x\nfloat64 y\nfloat64 z"
POINT, VECTOR3 = VECTOR.format("Point"), VECTOR.format("Vector3")
QUATERNION = VECTOR.format("Quaternion") + "\nfloat64 w"
POSE = "MSG: geometry_msgs/Pose\ngeometry_msgs/Point position\ngeometry_msgs/Quaternion orientation"
WRENCH = "MSG: geometry_msgs/Wrench\ngeometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque"
DEFINED = {
    "Point": [POINT],
    "Pose": [POSE, POINT, QUATERNION],
    "Wrench": [WRENCH, VECTOR3],
}


def definition(kind):
    """A message's definition as bags have it: its own text, then those that it needs."""
    plain = kind.removesuffix("Stamped")
    needed = DEFINED[plain]
    if plain == kind:
        return "\n".join([needed[0].split("\n", 1)[1], *(f"{'=' * 80}\n{part}" for part in needed[1:])])
    own = f"std_msgs/Header header\ngeometry_msgs/{plain} {plain.lower()}"
    return "\n".join([own, *(f"{'=' * 80}\n{part}" for part in [HEADER, *needed])])


def vector(x, y, z):
    return {"x": x, "y": y, "z": z}


def body(kind, v):
    if kind == "Point":
        return vector(*v)
    if kind == "Wrench":
        return {"force": vector(*v), "torque": vector(0, 0, 0)}
    w, x, y, z = v[3:] if len(v) == 7 else (1, 0, 0, 0)
    return {"position": vector(*v[:3]), "orientation": vector(x, y, z) | {"w": w}}


def bag(path, topics, stamped=None):
    """A bag as ROS writes it: of each topic its type, stamps (ns) and numbers; topics that are not `stamped` have none."""
    with open(path, "wb") as file:
        writer = RosWriter(file)
        for topic, (kind, stamps, numbers) in topics.items():
            schema = writer.register_msgdef(f"geometry_msgs/msg/{kind}", definition(kind))
            plain = kind.removesuffix("Stamped")
            for stamp, v in zip(np.asarray(stamps).tolist(), np.asarray(numbers).tolist(), strict=True):
                said = body(plain, v)
                if kind != plain:
                    shown = stamp if stamped is None or topic in stamped else 0
                    at = {"sec": shown // 10**9, "nanosec": shown % 10**9}
                    said = {"header": {"stamp": at, "frame_id": "world"}, plain.lower(): said}
                writer.write_message(topic, schema, said, stamp if kind == plain else stamp + 12345, stamp)
        writer.finish()
    return path


STAMPS = 1_700_000_000_000_000_000 + 10**6 * np.arange(100)
PATH, PUSH = HIP[:100], FORCE[:100]
TURNED = np.concatenate([PATH[:, 0], np.tile([0.6, 0.0, 0.8, 0.0], (100, 1))], axis=-1)


@pytest.mark.parametrize("stamped", ["", "Stamped"])
@pytest.mark.parametrize("tip", ["Point", "Pose"])
def test_a_bag_is_read_by_its_topics(tmp_path, stamped, tip):
    topics = {f"/tip{i}": (tip + stamped, STAMPS, PATH[:, i]) for i in (0, 1)}
    topics |= {f"/push{i}": (f"Wrench{stamped}", STAMPS[::2], PUSH[::2, i]) for i in (0, 1)}
    path = bag(tmp_path / "a.mcap", topics | {"/cube": (f"Pose{stamped}", STAMPS + 500_000, TURNED)})
    named = {"hip": ["/tip1", "/tip0"], "force": ["/push1", "/push0"], "pose": "/cube"}
    recording = Recording.load(path, topics=named)
    assert recording.pose is not None and recording.pose_t is not None and recording.hip_t is not None
    np.testing.assert_array_equal(recording.hip, PATH[:, ::-1])
    np.testing.assert_array_equal(recording.force, PUSH[::2, ::-1])
    np.testing.assert_allclose(recording.pose, TURNED[:, None], rtol=0, atol=1e-15)
    # From the first message on, to the nanosecond.
    np.testing.assert_allclose(recording.hip_t, 1e-3 * np.arange(100), rtol=0, atol=1e-12)
    np.testing.assert_allclose(recording.pose_t, 1e-3 * np.arange(100) + 5e-4, rtol=0, atol=1e-12)
    assert recording.findings == ()


def test_fingers_with_clocks_of_their_own_are_brought_together(tmp_path):
    late = STAMPS[:-1] + 300_000
    half = 0.7 * PATH[:-1, 1] + 0.3 * PATH[1:, 1]
    path = bag(tmp_path / "a.mcap", {"/0": ("Point", STAMPS, PATH[:, 0]), "/1": ("Point", late, half)})
    recording = load_recording(path, {"hip": ["/0", "/1"]})
    (finding,) = recording.findings
    assert (finding.channel, finding.kind, finding.count) == ("hip", "times differ", 98)
    assert recording.hip is not None
    np.testing.assert_allclose(recording.hip, PATH[1:-1], rtol=0, atol=1e-7)


def test_stamps_that_were_never_set_give_way_to_the_times_of_logging(tmp_path):
    topics = {"/tip": ("PointStamped", STAMPS, PATH[:, 0]), "/push": ("WrenchStamped", STAMPS, PUSH[:, 0])}
    path = bag(tmp_path / "a.mcap", topics, stamped=("/tip",))
    recording = load_recording(path, {"hip": "/tip", "force": "/push"})
    (finding,) = recording.findings
    assert (finding.channel, finding.kind, finding.count) == ("force", "no stamps", 100)
    assert "/push" in finding.sentence and recording.force_t is not None
    np.testing.assert_allclose(recording.force_t, 1e-3 * np.arange(100) + 12345e-9, rtol=0, atol=1e-12)


BAD_TOPICS = {
    "absent": ({"hip": ["/nowhere"]}, ["/nowhere", "/tip (geometry_msgs/msg/PointStamped)"]),
    "of another type": (
        {"force": ["/tip"]},
        ["/tip of force", "geometry_msgs/Wrench", "geometry_msgs/PointStamped"],
    ),
    "no channel": ({"gimbal": ["/tip"]}, ["'gimbal'", "hip, force, pose"]),
    "twice": ({"hip": ["/tip", "/tip"]}, ["each once"]),
    "none": ({}, ["at least one"]),
    "nameless": ({"hip": [""]}, ["names of topics"]),
}


@pytest.mark.parametrize(("topics", "fragments"), BAD_TOPICS.values(), ids=BAD_TOPICS)
def test_topics_that_are_not_there_are_refused(tmp_path, topics, fragments):
    path = bag(tmp_path / "a.mcap", {"/tip": ("PointStamped", STAMPS, PATH[:, 0])})
    with pytest.raises(InputError) as caught:
        Recording.load(path, topics)
    for fragment in fragments:
        assert fragment in str(caught.value), str(caught.value)


def test_topics_are_for_bags_only(tmp_path):
    with pytest.raises(InputError, match=r"a\.csv: topics are named"):
        Recording.load(saved(tmp_path / "a.csv"), {"hip": ["/tip"]})


def test_a_missing_library_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "mcap", None)
    with pytest.raises(InputError, match=r"mcap is not installed; .*hapjax\[recording\]"):
        Recording.load(saved(tmp_path / "a.csv").rename(tmp_path / "a.mcap"))
