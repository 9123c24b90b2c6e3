"""ROS 2 bags (MCAP with CDR messages), by the names of their topics; no ROS is needed.

Each finger's `hip` is a topic of Point, PointStamped, Pose or PoseStamped messages (of a pose the position is taken), its
`force` one of Wrench or WrenchStamped, each object's `pose` one of Pose or PoseStamped. Stamped messages have the time of
their stamp, the others, and those of a topic whose stamps were never set, that of their logging. The frames are believed to
be the world's.
"""

from array import array
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from ..errors import InputError, within
from ..extras import need
from . import mcap_records
from .channels import CHANNELS
from .content import MESSAGES_RATIO, Content, check_unpacked
from .finding import Finding

# The message types as ROS 2 defines them, in its own language. Those in a file are not needed, and not trusted.
_HEADER = "builtin_interfaces/Time stamp\nstring frame_id"
_VECTOR = "float64 x\nfloat64 y\nfloat64 z"
_PARTS = {
    "std_msgs/Header": _HEADER,
    "geometry_msgs/Vector3": _VECTOR,
    "geometry_msgs/Point": _VECTOR,
    "geometry_msgs/Quaternion": f"{_VECTOR}\nfloat64 w",
    "geometry_msgs/Pose": "geometry_msgs/Point position\ngeometry_msgs/Quaternion orientation",
    "geometry_msgs/Wrench": "geometry_msgs/Vector3 force\ngeometry_msgs/Vector3 torque",
}
_BODIES = {"Point": "point", "Pose": "pose", "Wrench": "wrench"}
_ALLOWED = {"hip": ("Point", "Pose"), "force": ("Wrench",), "pose": ("Pose",)}


def parsed(words: Sequence[str]) -> dict[str, list[str]] | None:
    """The topics of each channel from words such as `hip=/left/tip,/right/tip`; None where there are no words.

    **Raises:** `hapjax.InputError` for a word of another form or a channel named twice.
    """
    found: dict[str, list[str]] = {}
    for word in words:
        channel, equals, names = word.partition("=")
        if not equals or channel in found:
            raise InputError(
                f"--topic is {word!r}; allowed: a channel once with its topics, such as hip=/left/tip,/right/tip"
            )
        found[channel] = names.split(",")
    return _checked(found) if found else None


def read(path: Path, topics: Mapping[str, Sequence[str]]) -> Content:
    """What the named topics of a bag hold. Times count from the first message that was wanted.

    Topics of one channel whose times differ are brought to those of its first topic by linear interpolation, and a
    finding says so.

    **Raises:** `hapjax.InputError` as `mcap_file.read`.
    """
    topics = _checked(topics)
    wanted = {topic: channel for channel, names in topics.items() for topic in names}
    tracks: dict[str, _Track] = {}
    seen: dict[str, str] = {}
    scan = mcap_records.Scan(path)
    for channel, schema, message in scan:
        seen[channel.topic] = "no schema" if schema is None else schema.name
        if channel.topic in wanted:
            track = tracks.get(channel.topic)
            if track is None:
                track = tracks[channel.topic] = _track(path, wanted[channel.topic], channel, schema)
            track.add(path, message)
            check_unpacked(path, scan.size, sum(t.room for t in tracks.values()), MESSAGES_RATIO)
    for topic in wanted:
        if topic not in tracks:
            found = ", ".join(f"{t} ({kind})" for t, kind in sorted(seen.items())[:20]) or "none"
            raise InputError(f"{path}: expected messages on the topic {topic}, found {found[:2000]}")
    arrays, findings = {}, list(scan.findings())
    for topic, track in tracks.items():
        if track.fall_back():
            sentence = f"the messages of {topic} have no stamps: all are 0"
            done = "their times are those of their logging"
            findings.append(Finding(wanted[topic], "no stamps", sentence, done, count=len(track.stamps)))
    begin = min(min(track.stamps) for track in tracks.values())
    for channel, names in topics.items():
        with within(f"{path}: "):
            joined, finding = _joined(channel, [tracks[name] for name in names], begin)
        arrays[f"{channel}_t"], arrays[channel] = joined
        findings += finding
    return Content(arrays, lambda channel, row: f"message {row}", tuple(findings))


def _checked(topics: Mapping[str, Sequence[str]]) -> dict[str, list[str]]:
    checked = {}
    for channel, names in topics.items():
        if channel not in _ALLOWED:
            raise InputError(f"topics name the channel {channel!r}; allowed: {', '.join(_ALLOWED)}")
        checked[channel] = [names] if isinstance(names, str) else list(names)
        if not checked[channel] or not all(isinstance(n, str) and n for n in checked[channel]):
            raise InputError(f"topics of {channel} are {names!r}; allowed: one or more names of topics")
    every = [name for names in checked.values() for name in names]
    twice = next((name for name in every if every.count(name) > 1), None)
    if twice is not None or not every:
        raise InputError(f"topics are {dict(topics)!r}; allowed: at least one, each once")
    return checked


class _Track:
    """The messages of one topic so far, in little room: stamps and times of logging (ns), and numbers."""

    def __init__(self, topic: str, decode: Callable, kind: str, stamped: bool, pose: bool):
        self.topic, self.decode, self.kind, self.stamped, self.pose = topic, decode, kind, stamped, pose
        self.stamps, self.logged, self.numbers = array("q"), array("q"), array("d")

    @property
    def room(self) -> int:
        return 8 * (2 * len(self.stamps) + len(self.numbers))

    def add(self, path: Path, message) -> None:
        try:
            said = self.decode(message.data)
            stamp = (
                said.header.stamp.sec * 10**9 + said.header.stamp.nanosec
                if self.stamped
                else message.log_time
            )
            body = getattr(said, _BODIES[self.kind]) if self.stamped else said
            self.stamps.append(stamp)
            self.logged.append(message.log_time)
        except Exception as error:  # whatever the decoder makes of damaged bytes
            where = f"{path}, topic {self.topic}, message {len(self.stamps)}"
            raise InputError(f"{where}: expected a whole {self.kind}, found a damaged one") from error
        vector = body.force if self.kind == "Wrench" else body.position if self.kind == "Pose" else body
        self.numbers.extend((vector.x, vector.y, vector.z))
        if self.pose:
            turn = body.orientation
            self.numbers.extend((turn.w, turn.x, turn.y, turn.z))

    def fall_back(self) -> bool:
        """Take the times of logging where no stamp was set; whether that is so."""
        unset = len(self.stamps) > 1 and not any(self.stamps)
        if unset:
            self.stamps = self.logged
        return unset

    def samples(self, begin: int) -> tuple[np.ndarray, np.ndarray]:
        """Times (T,) s after `begin` (ns), taken off before rounding, and numbers (T, 3 or 7)."""
        times = (np.asarray(self.stamps) - begin) * 1e-9
        return times, np.asarray(self.numbers).reshape(len(times), -1)


def _track(path: Path, channel: str, topic, schema) -> _Track:
    name = "" if schema is None else schema.name.replace("/msg/", "/")
    kind = name.removeprefix("geometry_msgs/").removesuffix("Stamped")
    if (
        kind not in _ALLOWED[channel]
        or not name.startswith("geometry_msgs/")
        or topic.message_encoding != "cdr"
    ):
        allowed = ", ".join(f"geometry_msgs/{k}, geometry_msgs/{k}Stamped" for k in _ALLOWED[channel])
        found = f"{name[:80] or 'none'} in {topic.message_encoding[:40]!r}"
        raise InputError(
            f"{path}, topic {topic.topic} of {channel}: expected {allowed} in 'cdr', found {found}"
        )
    stamped = name.endswith("Stamped")
    return _Track(topic.topic, _decoder(name, kind), kind, stamped, channel == "pose")


def _decoder(name: str, kind: str) -> Callable:
    """The decoder of a message type's bytes."""
    decoders, records = need("mcap_ros2.decoder", "recording"), need("mcap.records", "recording")
    stamped = f"std_msgs/Header header\ngeometry_msgs/{kind} {_BODIES[kind]}"
    own = stamped if name.endswith("Stamped") else _PARTS[name]
    needed = [f"{'=' * 80}\nMSG: {part}\n{text}" for part, text in _PARTS.items() if part != name]
    text = "\n".join([own, *needed]).encode()
    decoder = decoders.DecoderFactory().decoder_for(
        "cdr", records.Schema(data=text, encoding="ros2msg", id=1, name=name)
    )
    assert decoder is not None
    return decoder


def _joined(channel: str, tracks: list[_Track], begin: int):
    """Times and array of a channel, of whose items each has a topic, and what was done to join them."""
    each = [track.samples(begin) for track in tracks]
    times, first = each[0]
    if all(np.array_equal(t, times) for t, _ in each):
        return (times, np.stack([numbers for _, numbers in each], axis=1)), []
    low, high = max(np.nanmin(t) for t, _ in each), min(np.nanmax(t) for t, _ in each)
    kept = (times >= low) & (times <= high)
    if not kept.any():
        names = ", ".join(track.topic for track in tracks)
        raise InputError(f"{channel}: expected topics that overlap in time, found {names} apart")
    values = [first[kept], *(_at(times[kept], *other) for other in each[1:])]
    sentence = f"the topics of its {CHANNELS[channel].items} have times of their own"
    done = f"the others were interpolated to those of {tracks[0].topic}"
    return (times[kept], np.stack(values, axis=1)), [
        Finding(channel, "times differ", sentence, done, count=int(kept.sum()))
    ]


def _at(times: np.ndarray, clock: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Samples (T, 3 or 7) at other times; quaternions along the shorter way, of norm 1."""
    order = np.argsort(clock, kind="stable")
    clock, numbers = clock[order], numbers[order]
    if numbers.shape[1] == 7:
        numbers = numbers.copy()
        turned = np.sum(numbers[1:, 3:] * numbers[:-1, 3:], axis=-1) < 0
        numbers[1:, 3:] *= np.where(np.cumsum(turned) % 2 == 1, -1.0, 1.0)[:, None]
    found = np.stack([np.interp(times, clock, column) for column in numbers.T], axis=-1)
    if numbers.shape[1] == 7:
        norm = np.linalg.norm(found[:, 3:], axis=-1, keepdims=True)
        found[:, 3:] = np.divide(found[:, 3:], norm, out=found[:, 3:].copy(), where=norm > 0)
    return found
