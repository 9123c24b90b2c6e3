"""Recordings as MCAP: one channel each, JSON messages with a JSON schema; ROS 2 bags go to `ros_topics`.

The topics are `/hip`, `/force`, `/gimbal`, `/pose`. A message is one sample: its time `t` (s) and `fingers` or `objects`,
one for each with its numbers by name:

    {"t": 0.001, "fingers": [{"x": 0.0, "y": 0.0, "z": 0.03}, {"x": 0.1, "y": 0.0, "z": 0.03}]}
"""

import json
from array import array
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..extras import need
from ..files import replacing
from . import mcap_records, ros_topics
from .channels import CHANNELS
from .content import MESSAGES_RATIO, Content, check_unpacked

TOPICS = {f"/{name}": name for name in CHANNELS}
_CHUNK = 64 * 2**10  # bytes
_LONGEST = 64 * 2**10  # bytes of a message: as objects it takes up to 30 times its room


def read(path: Path, topics: Mapping[str, Sequence[str]] | None = None) -> Content:
    """What an MCAP file holds. A row of a channel is called by its message, counted from 0.

    Of a file whose writer was stopped, all that is whole is read, and a finding says so.

    **Arguments:** `topics`, of a ROS 2 bag: for each channel its topics, one a finger or object; see `ros_topics`.

    **Raises:** `hapjax.InputError` for what is no MCAP file or a damaged one, messages of another form or of over 64 KiB, a
    topic that is not there, a file that would unpack to far more than its size, and where mcap is not installed;
    `OSError` if the file cannot be opened.
    """
    if topics is not None:
        return ros_topics.read(path, topics)
    gathered: dict[str, _Samples] = {}
    others: dict[str, str] = {}
    scan = mcap_records.Scan(path)
    for channel, schema, message in scan:
        name = TOPICS.get(channel.topic)
        if name is None or channel.message_encoding != "json":
            others[channel.topic] = channel.message_encoding if schema is None else schema.name
            continue
        samples = gathered.setdefault(name, _Samples(name))
        samples.add(path, message.data)
        check_unpacked(path, scan.size, sum(s.room for s in gathered.values()), MESSAGES_RATIO)
    if not gathered:
        found = ", ".join(f"{t} ({kind})" for t, kind in sorted(others.items())[:20]) or "no messages"
        problem = f"expected JSON messages on {', '.join(TOPICS)}, found {found[:2000]}"
        hint = "; name the topics of a ROS 2 bag: --topic hip=/finger force=/sensor" if others else ""
        raise InputError(f"{path}: {problem}{hint}")
    arrays = {}
    for name, samples in gathered.items():
        arrays[f"{name}_t"] = np.asarray(samples.times)
        arrays[name] = samples.values()
    return Content(arrays, lambda channel, row: f"message {row}", scan.findings())


def write(arrays: dict[str, np.ndarray], path: Path) -> None:
    """Write arrays as an MCAP file, whole or not at all; every number reads back bit for bit."""
    writers = need("mcap.writer", "recording")
    present = [name for name in CHANNELS if name in arrays]
    clocks = {name: arrays[f"{name}_t"].tolist() for name in present}
    begin = min(0.0, *(clock[0] for clock in clocks.values()))
    order = sorted((time, name, row) for name, clock in clocks.items() for row, time in enumerate(clock))
    with replacing(path, "wb") as file:
        writer = writers.Writer(file, chunk_size=_CHUNK)
        writer.start(profile="", library="hapjax")
        ids = {name: _register(writer, name) for name in present}
        for sequence, (time, name, row) in enumerate(order):
            stamp = _nanoseconds(time - begin)
            writer.add_message(ids[name], stamp, message(name, time, arrays[name][row]), stamp, sequence)
        writer.finish()


def message(name: str, time: float, sample: np.ndarray) -> bytes:
    """One sample of a channel, (n, parts) or (n,), as a message."""
    channel = CHANNELS[name]
    parts = channel.parts or ("angle",)
    numbers = sample.reshape(-1, len(parts)).tolist()
    items = [dict(zip(parts, item, strict=True)) for item in numbers]
    return json.dumps({"t": time, channel.items: items}, separators=(",", ":")).encode()


def schema(name: str) -> bytes:
    """The JSON schema of a channel's messages."""
    channel = CHANNELS[name]
    number = {"type": "number"}
    item = {"type": "object", "properties": dict.fromkeys(channel.parts or ("angle",), number)}
    item["required"] = list(item["properties"])
    fields = {"t": number, channel.items: {"type": "array", "items": item}}
    return json.dumps({"type": "object", "properties": fields, "required": list(fields)}).encode()


def _register(writer, name: str) -> int:
    place = writer.register_schema(f"hapjax.{name}", "jsonschema", schema(name))
    return writer.register_channel(f"/{name}", "json", place)


def _nanoseconds(seconds: float) -> int:
    """The log time, which is an unsigned integer; the exact time is in the message."""
    return round(min(seconds * 1e9, 2.0**64 - 2**11))


class _Samples:
    """The messages of one channel so far, in little room."""

    def __init__(self, name: str):
        self.name, self.channel = name, CHANNELS[name]
        self.parts = self.channel.parts or ("angle",)
        self.times, self.numbers, self.items = array("d"), array("d"), -1

    @property
    def room(self) -> int:
        return 8 * (len(self.times) + len(self.numbers))

    def add(self, path: Path, data: bytes) -> None:
        if len(data) > _LONGEST:
            where = f"{path}, {self.name}, message {len(self.times)}"
            raise InputError(f"{where}: expected at most {_LONGEST} bytes, found {len(data)}")
        try:
            said = json.loads(data)
            time, items = _real(said["t"]), said[self.channel.items]
            numbers = [_real(item[part]) for item in items for part in self.parts]
            if not numbers or self.items not in (-1, len(items)):
                raise ValueError
        except (ValueError, TypeError, KeyError, AttributeError, OverflowError, RecursionError):
            where = f"{path}, {self.name}, message {len(self.times)}"
            example = message(self.name, 0.0, np.zeros(len(self.parts))).decode()
            count = f", {self.items} {self.channel.items} as before" if self.items > 0 else ""
            raise InputError(f"{where}: expected one like {example}{count}, found {data[:200]!r}") from None
        self.items = len(items)
        self.times.append(time)
        self.numbers.extend(numbers)

    def values(self) -> np.ndarray:
        shape = (len(self.times), self.items, len(self.channel.parts))
        return np.asarray(self.numbers).reshape(shape if self.channel.parts else shape[:2])


def _real(number) -> float:
    if isinstance(number, bool) or not isinstance(number, int | float):
        raise ValueError
    return float(number)
