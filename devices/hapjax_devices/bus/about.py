"""What there is to know of a run before its first tick."""

import json
import os
import time
import tomllib
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import tomli_w
from jaxtyping import Array

from hapjax import InputError, PackedStep, Scene
from hapjax.scene_file import scene_from_dict, scene_to_dict
from hapjax.shape import Mesh

from ..device import Device

_PACKAGE = __name__.split(".")[0]


@dataclass(frozen=True)
class About:
    """A run of the servo loop, as its readers are told of it.

    **Attributes:** `run`, its name; `rate` in Hz; the numbers of `fingers`, of those with a gimbal (`gimbals`), and of
    numbers in the packed step's `memory`, of `dtype`; the moving `objects` and for each where in the memory its x y z
    qw qx qy qz are, `pose_at`; the `devices`, described; `scene`, its scene file's text, and the `files` that it names,
    each with where it lies; `unsaid`, why there is no scene; the id of the `process`; when it began by the wall clock
    (`wall_ns`, ns since 1970) and by the clock of its ticks (`clock_ns`); of each `live` number's path from where to
    where in the memory it is; of each object that fingers feel where there are, of all fingers and in its frame, `point`
    and `depth` of `GodObject` and all of `Touch`, `touch_at`.
    """

    run: str
    rate: float
    fingers: int
    gimbals: int
    memory: int
    dtype: str
    objects: tuple[str, ...]
    pose_at: tuple[tuple[int, ...], ...]
    devices: tuple[dict[str, Any], ...]
    scene: str
    files: dict[str, str]
    unsaid: str
    process: int
    wall_ns: int
    clock_ns: int
    live: dict[str, tuple[int, int]] = field(default_factory=dict)
    touch_at: dict[str, dict[str, list]] = field(default_factory=dict)

    @classmethod
    def of(
        cls,
        run: str,
        rate: float,
        scene: Scene,
        packed: PackedStep,
        devices: Sequence[Device],
        gimbals: int,
    ) -> "About":
        """What is to be said of a run of this process that begins now."""
        text, files, unsaid = scene_file(scene)
        pose_at = pose_places(packed).tolist() if scene.moving() else []
        return cls(
            run,
            rate,
            packed.fingers,
            gimbals,
            len(packed.start),
            packed.dtype.name,
            tuple(scene.moving()),
            tuple(tuple(int(place) for place in row) for row in pose_at),
            tuple(described(device) for device in devices),
            text,
            files,
            unsaid,
            os.getpid(),
            time.time_ns(),
            time.perf_counter_ns(),
            {path: (place.start, place.stop) for path, place in packed.live.items()},
            _touch_places(packed),
        )

    @property
    def live_at(self) -> np.ndarray:
        """Where in the memory all live numbers are, path after path."""
        return np.concatenate([np.arange(*place) for place in self.live.values()])

    @property
    def numbers(self) -> np.dtype:
        """A sample of all live numbers."""
        return np.dtype([("values", "<f8", (len(self.live_at),))])

    @property
    def tick(self) -> np.dtype:
        """A tick's sample: see `docs/realtime.md`."""
        fields = [
            ("tick", "<i8"),
            ("time_ns", "<i8"),
            ("lateness_us", "<f8"),
            ("compute_us", "<f8"),
            ("missed", "<i8"),
            ("not_finite", "<i8"),
            ("limited", "<i8"),
            ("lost", "<i8"),
            ("slewed", "<i8"),
            ("ramped", "<i8"),
            ("overrun", "<i8"),
            ("down", "<i8"),
            ("hip", "<f8", (self.fingers, 3)),
            ("gimbal", "<f8", (self.gimbals,)),
            ("force", "<f8", (self.fingers, 3)),
            # An even number of them: whatever they are, the sample is a whole number of 8 bytes.
            ("memory", np.dtype(self.dtype).newbyteorder("<"), (self.memory + self.memory % 2,)),
        ]
        return np.dtype(fields)

    def to_json(self) -> bytes:
        """All of it, as JSON."""
        return json.dumps(asdict(self)).encode()

    @classmethod
    def from_json(cls, data: bytes) -> "About":
        """What `to_json` wrote."""
        said = json.loads(data)
        for name in ("objects", "devices"):
            said[name] = tuple(said[name])
        said["pose_at"] = tuple(map(tuple, said["pose_at"]))
        said["live"] = {path: tuple(places) for path, places in said["live"].items()}
        return cls(**said)


def scene_of(about: About) -> Scene:
    """The scene that a run says it has. **Raises:** `InputError` where it cannot say."""
    if not about.scene:
        raise InputError(
            f"the run {about.run} does not say what its scene is ({about.unsaid}); allowed: one that does"
        )
    folder = None
    for name, place in about.files.items():
        folder = Path(place).parents[len(Path(name).parts) - 1]
    return scene_from_dict(tomllib.loads(about.scene), folder)


def described(device: Device) -> dict[str, Any]:
    """What a device says of itself."""
    kind = type(device)
    own = kind.__module__.split(".")[0] == _PACKAGE
    return {
        "type": kind.__name__ if own else f"{kind.__module__}.{kind.__qualname__}",
        "force_limit": float(device.force_limit),  # N
        "resolution": float(device.resolution),  # m
    }


def pose_places(packed: PackedStep) -> np.ndarray:
    """Where in the memory the numbers of each moving object's pose are, (O, 7)."""
    state = packed.state(_places(packed))
    rows = [np.concatenate([m.position, m.orientation]) for m in state.motion.values()]
    return np.stack(rows).astype(int)


def _touch_places(packed: PackedStep) -> dict[str, dict[str, list]]:
    """Where in the memory the touches on each object are."""
    gods, touches = packed.state(_places(packed)).finger, packed.touches(_places(packed))
    found = {}
    for name, god in gods.items():
        parts = {"point": god.point, "depth": god.depth, **vars(touches[name])}
        found[name] = {part: np.asarray(at).astype(int).tolist() for part, at in parts.items()}
    return found


def _places(packed: PackedStep) -> Array:
    # The memory's own places, taken apart as if they were a state. Unpacking itself is too slow for the loop.
    return jnp.arange(len(packed.start), dtype=packed.dtype)


def scene_file(scene: Scene) -> tuple[str, dict[str, str], str]:
    """The text of a scene file, the files beside it by name, and why there is none where there is none."""
    shapes = [thing.shape for thing in scene.object.values()]
    meshes = {Path(s.file) for s in shapes if isinstance(s, Mesh) and s.file is not None}
    folder = None
    if meshes:
        folder = Path(os.path.commonpath([str(file.parent) for file in meshes]))
    try:
        text = tomli_w.dumps(scene_to_dict(scene, folder))
    except InputError as error:
        return "", {}, str(error)
    files = {} if folder is None else {m.relative_to(folder.resolve()).as_posix(): str(m) for m in meshes}
    return text, files, ""
