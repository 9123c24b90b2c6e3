"""Ticks and events as the JSON messages of a recording."""

import json
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from hapjax.recording.channels import CHANNELS
from hapjax.recording.mcap_file import schema

from ..bus import About
from ..bus.publisher import COUNTED
from ..event import Event

SERVO = ("tick", "lateness_us", "compute_us", *COUNTED, "down")
_WHOLE = {"type": "integer"}
_NUMBER, _TEXT = {"type": "number"}, {"type": "string"}
_LEVELS = {
    "end": 2,
    "back": 2,
    "numbers": 2,
    "fault": 4,
    "cut": 4,
}  # foxglove.Log: 2 for news, 3 for a warning, 4 for an error


class Message(NamedTuple):
    """One message: of which `topic`, at which `time_ns` (ns since 1970), and its `data`."""

    topic: str
    time_ns: int
    data: bytes


class Messages:
    """Makes messages of a run's ticks.

    The scene's time `t` is tick over rate, as in every recording; the log time is when the tick began, by the wall
    clock at the beginning of the run and the servo's own clock from there on: whatever steps the wall clock makes
    meanwhile.

    **Arguments:** `about` the run.

    **Attributes:** `schemas`, name and JSON schema of each topic; `unfit`, of each topic how many samples were left out
    because they had numbers that are not finite.
    """

    def __init__(self, about: About):
        self._about = about
        self._channels = {"hip": about.fingers, "force": about.fingers, "model_force": about.fingers}
        self._channels |= {"gimbal": about.gimbals} if about.gimbals else {}
        self._channels |= {"pose": len(about.objects)} if about.objects else {}
        self._templates = {name: _template(name, count) for name, count in self._channels.items()}
        self._servo = '{"t":%r,' + ",".join(f'"{name}":%r' for name in SERVO) + "}"
        self._to_wall = about.wall_ns - about.clock_ns
        self._pose_at = np.array(about.pose_at, int)
        self.schemas = {f"/{name}": (f"hapjax.{name}", schema(name)) for name in self._channels}
        self.schemas["/servo"] = ("hapjax.servo", _object(t=_NUMBER, **dict.fromkeys(SERVO, _NUMBER)))
        self.schemas["/event"] = ("foxglove.Log", _log_schema())
        if about.live:
            self.schemas["/numbers"] = ("hapjax.numbers", _numbers_schema())
        self._numbers: list[float] = []  # those that were recorded last
        self.unfit = dict.fromkeys(self._channels, 0)

    def of_ticks(self, ticks: np.ndarray) -> Iterator[Message]:
        """The messages of ticks (n,) as a `TickReader` takes them, channel by channel."""
        rate, n = self._about.rate, len(ticks)
        times, stamps = ticks["tick"] / rate, ticks["time_ns"] + self._to_wall
        for name, template in self._templates.items():
            at, of = times, stamps
            if name == "model_force":
                values = ticks["memory"][:, : 3 * self._about.fingers].astype(float)
            elif name == "pose":  # a step's poses belong to its end
                at, of = (ticks["tick"] + 1) / rate, stamps + round(1e9 / rate)
                values = ticks["memory"][:, self._pose_at].astype(float)
            else:
                values = ticks[name]
            values = values.reshape(n, -1)
            fit = np.isfinite(values).all(axis=1)
            self.unfit[name] += n - int(fit.sum())
            rows = np.concatenate([at[:, None], values], axis=1)[fit].tolist()
            for row, stamp in zip(rows, of[fit].tolist(), strict=True):
                yield Message(f"/{name}", stamp, (template % tuple(row)).encode())
        columns = [times.tolist(), *(ticks[name].tolist() for name in SERVO)]
        for row, stamp in zip(zip(*columns, strict=True), stamps.tolist(), strict=True):
            yield Message("/servo", stamp, (self._servo % row).encode())
        if self._about.live:
            yield from self._of_numbers(ticks["memory"][:, self._about.live_at], times, stamps)

    def _of_numbers(self, held: np.ndarray, times: np.ndarray, stamps: np.ndarray) -> Iterator[Message]:
        """The live numbers, where they are not what they were."""
        others = np.flatnonzero(np.any(held[1:] != held[:-1], axis=1)) + 1
        for row in [0, *others.tolist()]:
            if (values := held[row].tolist()) != self._numbers:
                self._numbers, left = values, iter(values)
                said = [
                    {"path": path, "value": [next(left) for _ in range(first, end)]}
                    for path, (first, end) in self._about.live.items()
                ]
                data = json.dumps({"t": float(times[row]), "numbers": said}, separators=(",", ":"))
                yield Message("/numbers", int(stamps[row]), data.encode())

    def of_event(self, event: Event) -> Message:
        """An event as a `foxglove.Log`, with what else there is to say of it."""
        stamp = event.time_ns + self._to_wall
        seconds, nanoseconds = divmod(stamp, 10**9)
        said = {
            "t": max(event.tick, 0) / self._about.rate,
            "timestamp": {"sec": seconds, "nsec": nanoseconds},
            "level": _LEVELS.get(event.kind, 3),
            "name": "hapjax",
            "message": event.sentence,
            "file": "",
            "line": 0,
            "kind": event.kind,
            "tick": event.tick,
            "finger": event.finger,
        }
        return Message("/event", stamp, json.dumps(said, separators=(",", ":")).encode())


def _template(name: str, count: int) -> str:
    """A message of a channel with a place for each of its numbers, and before them for the time."""
    channel = CHANNELS[name]
    item = ",".join(f'"{part}":%r' for part in channel.parts or ("angle",))
    return f'{{"t":%r,"{channel.items}":[{",".join([f"{{{item}}}"] * count)}]}}'


def _object(**fields) -> bytes:
    return json.dumps({"type": "object", "properties": fields, "required": list(fields)}).encode()


def _numbers_schema() -> bytes:
    numbers = {"type": "array", "items": _NUMBER}
    item = {"type": "object", "properties": {"path": _TEXT, "value": numbers}}
    return _object(t=_NUMBER, numbers={"type": "array", "items": item})


def _log_schema() -> bytes:
    stamp = {"type": "object", "properties": {"sec": _WHOLE, "nsec": _WHOLE}}
    own = {"t": _NUMBER, "kind": _TEXT, "tick": _WHOLE, "finger": _WHOLE}
    log = {
        "timestamp": stamp,
        "level": _WHOLE,
        "message": _TEXT,
        "name": _TEXT,
        "file": _TEXT,
        "line": _WHOLE,
    }
    return _object(**log, **own)
