"""Which devices a session is to have: from options, or from a file in TOML."""

import sys
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from hapjax import InputError, Scene, scene_text
from hapjax.errors import within
from hapjax.recording import Recording

from ..browser import BrowserDevice
from ..device import Device
from ..falcon import Falcon
from ..inverse3 import Inverse3
from ..placement import Placement
from ..safety import Limits
from ..virtual import VirtualDevice
from .motion import virtual_finger
from .slower import Slower

MOST = 5  # devices of a session
_PLACE = ("position", "orientation")
_LIMITS = ("max_force", "slew", "ramp")
_ANY = ("rate", *_LIMITS)
KEYS = {  # that a table of each type may have
    "virtual": _ANY,
    "browser": _ANY,
    "falcon": (*_ANY, "serial", "firmware", "homing_time", *_PLACE),
    "inverse3": (*_ANY, "device_id", "force_limit", "message_format", "url", *_PLACE),
}
_TEXTS = ("serial", "firmware", "device_id", "message_format", "url")
_LISTS = {"position": 3, "orientation": 4}


def wanted(kinds: tuple[str, ...], file: Path | None, recording: Recording | None) -> list[dict[str, Any]]:
    """A table for each device: of the kinds, of a file, or virtual ones for the fingers of a recording, else for three.

    **Raises:** `InputError` where kinds and file are both given, for more than five devices, and for a file with what no
    device has.
    """
    if kinds and file is not None:
        raise InputError("device and devices are both given; allowed: one of the two")
    if file is not None:
        with within(f"{file}: "):
            tables = _of_file(file)
    elif kinds:
        tables = [{"type": kind} for kind in kinds]
    else:
        tables = [{"type": "virtual"} for _ in range(3 if recording is None else recording.fingers)]
    if not 1 <= len(tables) <= MOST:
        raise InputError(f"there are {len(tables)} devices; allowed: 1 to {MOST}")
    return tables


def made(
    tables: list[dict[str, Any]], run: str, scene: Scene, rate: float, recording: Recording | None
) -> list[Device]:
    """The devices of these tables, of which none is opened; `run`, the session's name, and `rate` of its loop, Hz.

    **Raises:** `InputError`, which names the device by its place, for values out of range.
    """
    devices = []
    for place, table in enumerate(tables):
        with within(f"device[{place}]: "):
            own = table.get("rate", rate)
            browser = partial(_browser, run, place, 1 / own)
            build = {"virtual": _virtual, "browser": browser, "falcon": _falcon, "inverse3": _inverse3}[
                table["type"]
            ]
            if not 10 <= own <= rate:
                raise InputError(f"rate is {own} Hz; allowed: 10 to the session's {rate:g}")
            device = build(
                table, lambda at=place, own=own: virtual_finger(scene, at, len(tables), own, recording)
            )
            devices.append(device if own == rate else Slower(device, own, rate))
    return devices


def limits_of(tables: list[dict[str, Any]], general: Mapping[str, Any]) -> list[Limits]:
    """What each device may be told to do: `max_force`, `slew` and `ramp` of its table, of all where it has none.

    **Raises:** `InputError`, which names the device by its place, for values out of range.
    """
    found = []
    for place, table in enumerate(tables):
        with within(f"device[{place}]: "):
            found.append(Limits(*(table.get(key, general[key]) for key in _LIMITS)))
    return found


def _virtual(table: Mapping[str, Any], finger: Callable[[], VirtualDevice]) -> Device:
    return finger()


def _browser(
    run: str, place: int, period: float, table: Mapping[str, Any], finger: Callable[[], VirtualDevice]
) -> Device:
    return BrowserDevice(run, place, finger().path[0], period)


def _falcon(table: Mapping[str, Any], finger: Callable[[], VirtualDevice]) -> Device:
    return Falcon(placement=_placement(table), notify=_say, **_rest(table))


def _say(sentence: str) -> None:
    print(f"hapjax: {sentence}", file=sys.stderr, flush=True)


def _inverse3(table: Mapping[str, Any], finger: Callable[[], VirtualDevice]) -> Device:
    if table.get("message_format", "3.1") not in ("3.1", "3.5"):
        raise InputError(f"message_format is {table['message_format']!r}; allowed: '3.1', '3.5'")
    return Inverse3(placement=_placement(table), **_rest(table))


def _placement(table: Mapping[str, Any]) -> Placement:
    return Placement(**{key: table[key] for key in _PLACE if key in table})


def _rest(table: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in table.items() if key not in ("type", *_ANY, *_PLACE)}


def _of_file(file: Path) -> list[dict[str, Any]]:
    table = scene_text.read(file, "device file")
    for key in table:
        if key != "device":
            raise InputError(f"{key} is not known; allowed: device")
    found = table.get("device", [])
    if not isinstance(found, list) or not all(isinstance(each, dict) for each in found):
        raise InputError(f"device is {found!r}; allowed: a [[device]] for each finger")
    for place, each in enumerate(found):
        with within(f"device[{place}]."):
            _check(each)
    folder = file.parent
    return [_beside(each, folder) for each in found]


def _check(table: Mapping[str, Any]) -> None:
    """Refuse keys that a device of the type does not have, and values of another kind than theirs."""
    kind = table.get("type")
    if not isinstance(kind, str) or kind not in KEYS:
        raise InputError(f"type is {kind!r}; allowed: {', '.join(KEYS)}")
    for key, value in table.items():
        if key != "type" and key not in KEYS[kind]:
            raise InputError(f"{key} is not known of a {kind}; allowed: type, {', '.join(KEYS[kind])}")
        if key in _LISTS:
            numbers = isinstance(value, list) and len(value) == _LISTS[key] and all(map(_is_number, value))
            if not numbers:
                raise InputError(f"{key} is {value!r}; allowed: {_LISTS[key]} numbers")
        elif (key in _TEXTS or key == "type") != isinstance(value, str) or (
            key not in _TEXTS and key != "type" and not _is_number(value)
        ):
            raise InputError(f"{key} is {value!r}; allowed: {'text' if key in _TEXTS else 'a number'}")


def _is_number(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and bool(np.isfinite(value))


def _beside(table: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The table, with a file that it names looked for beside the device file, and its numbers as such."""
    numbers = {key: float(value) for key, value in table.items() if _is_number(value)}
    return table | numbers | ({"firmware": str(folder / table["firmware"])} if "firmware" in table else {})
