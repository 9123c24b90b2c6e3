"""What `hapjax run` has recorded beside what was felt: the scene, and what became of its live numbers."""

import json
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hapjax import InputError, Scene
from hapjax.errors import within
from hapjax.paths import number_at
from hapjax.recording.content import check_unpacked
from hapjax.recording.mcap_records import Scan
from hapjax.scene_file import scene_from_dict
from hapjax.scene_text import tables

_MESSAGE = 64  # bytes that a message takes beside its own
_SAME = 1e-9  # s, by which two times of one tick may differ


def attached_scene(file: Path) -> Scene:
    """The scene that a recording of `hapjax run` has with it, also where its end is missing.

    **Raises:** `InputError` where there is none, for an attachment whose name no file can have, and as `Scan`.
    """
    found = {}
    if file.suffix.lower() == ".mcap":
        found = {each.name: each.data for each in Scan(file).attachments()}
    if "scene.toml" not in found:
        raise InputError(f"{file}: no scene is recorded with it; allowed: with --scene")
    with tempfile.TemporaryDirectory() as folder:
        for name, data in found.items():
            place = Path(folder, name)
            try:
                if place.resolve().is_relative_to(Path(folder).resolve()):
                    place.parent.mkdir(parents=True, exist_ok=True)
                    place.write_bytes(data)
            except (OSError, ValueError) as error:
                reason = getattr(error, "strerror", None) or error
                raise InputError(
                    f"{file}: has the attachment {name[:80]!r} ({reason}); allowed: names of files"
                ) from None
        with within(f"{file}, scene.toml: "):
            return scene_from_dict(tables(found["scene.toml"]), Path(folder))


class Live(NamedTuple):
    """What live numbers were: N times `since` (s), and `values` from then on, by path, each (N, ...)."""

    since: np.ndarray
    values: dict[str, np.ndarray]

    def at(self, times: Float[np.ndarray, "T"]) -> dict[str, np.ndarray]:
        """What they were at these times, each (T, ...)."""
        newest = np.maximum(np.searchsorted(self.since, times + _SAME, side="right") - 1, 0)
        return {path: value[newest] for path, value in self.values.items()}


STILL = Live(np.zeros(0), {})
"""Of a recording whose numbers stayed as they were."""


def recorded_numbers(file: Path, scene: Scene) -> Live:
    """The live numbers that are recorded in a file of `hapjax run`.

    **Raises:** `InputError` for messages of another form, for more of them than the file has room for, and for paths that
    the scene does not have.
    """
    said, room, scan = [], 0, Scan(file)
    for channel, _, message in scan:
        if channel.topic == "/numbers":
            room += len(message.data) + _MESSAGE
            check_unpacked(file, scan.size, room, 1)
            said.append(message.data)
    if not said:
        return STILL
    with within(f"{file}, /numbers: "):
        try:
            read = [json.loads(data) for data in said]
            since = np.array([one["t"] for one in read], float)
            each = [{number["path"]: number["value"] for number in one["numbers"]} for one in read]
            values = {path: np.array([one[path] for one in each], float) for path in each[0]}
        except (TypeError, KeyError, ValueError, OverflowError, RecursionError):
            raise InputError("expected of each a time t, and path and value of each number") from None
        return Live(since, {path: _shaped(scene, path, value) for path, value in values.items()})


def _shaped(scene: Scene, path: str, values: np.ndarray) -> np.ndarray:
    """Values that were recorded as lists, (N, n)."""
    shape = number_at(scene, path).shape
    if not np.isfinite(values).all() or values[0].size != np.prod(shape, dtype=int):
        raise InputError(f"{path} is {values[0].tolist()}; allowed: finite numbers, of the shape {shape}")
    return values.reshape(len(values), *shape)
