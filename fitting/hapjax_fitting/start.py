"""How moving objects move when a recording begins: free numbers beside those of the scene, at first as measured."""

from collections.abc import Mapping, Sequence
from dataclasses import fields, replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.spatial.transform import Rotation

from hapjax import InputError, Object, Recording, Scene, State, init, rotation
from hapjax.body import centre_within

# How far off each number still is where it was measured: m, rad, m/s, rad/s.
_SIZES = {"position": 1e-3, "rotation": 2e-2, "velocity": 5e-2, "spin": 0.2}
_SPAN = 0.02  # s after the beginning, in which a motion is taken to be uniform ...
_LEAST = 3  # ... and samples, if they are further apart
_LATE = 0.1  # s after the beginning: poses that begin later say nothing of it


class Start(eqx.Module):
    """The state of a moving object before the first step of a recording, world frame; what is `None` is the scene's.

    `position` (m) of the origin of its frame, `rotation` (rad), the rotation vector of its orientation, `velocity` (m/s)
    of its centre of mass, `spin` (rad/s).
    """

    position: Float[Array, "*r 3"] | None = None
    rotation: Float[Array, "*r 3"] | None = None
    velocity: Float[Array, "*r 3"] | None = None
    spin: Float[Array, "*r 3"] | None = None


Starts = dict[str, Start]


def is_start(path: str) -> bool:
    """Whether a path is that of a number of a start."""
    return path.split(".")[0] == "start"


def size_of_start(path: str) -> float:
    """How far off such a number may well be, in its unit."""
    return _SIZES[path.split(".")[2]]


def starts_of(scene: Scene, recordings: Sequence[Recording], paths: Sequence[str]) -> Starts:
    """The starts of those objects that free paths name: arrays (R, 3), a row for each of the recordings.

    They are those of uniform motion through a recording's first poses. What was not measured is as in the scene, and
    at rest.

    **Raises:** `InputError` where a path names no object that moves, or no number of a start.
    """
    named: dict[str, set[str]] = {}
    for path in filter(is_start, paths):
        name, field = _checked(path, scene)
        named.setdefault(name, set()).add(field)
    dtype, found = scene.integrator.dt.dtype, {}
    for name, chosen in named.items():
        rows = [_measured(scene, recording, name) for recording in recordings]
        values = {field: jnp.asarray(np.stack([row[field] for row in rows]), dtype) for field in chosen}
        found[name] = Start(**values)
    return found


def begun(
    scene: Scene,
    starts: Mapping[str, Start],
    hip: Float[Array, "F 3"],
    gimbal: Float[Array, " F"] | None,
) -> State:
    """The state before the first step, with the fingers at `hip` (m) and the objects as `starts` say."""
    for name, start in starts.items():
        thing = scene.object[name]
        position = thing.position if start.position is None else start.position
        turn = thing.orientation if start.rotation is None else rotation.from_rotation_vector(start.rotation)
        scene = eqx.tree_at(
            lambda s, n=name: (s.object[n].position, s.object[n].orientation), scene, (position, turn)
        )
    state = init(scene, hip, gimbal)
    for name, start in starts.items():
        rates = {f: x for f in ("velocity", "spin") if (x := getattr(start, f)) is not None}
        state = eqx.tree_at(lambda s, n=name: s.motion[n], state, replace(state.motion[name], **rates))
    return state


def _checked(path: str, scene: Scene) -> tuple[str, str]:
    _, name, field, *_ = [*path.split("[")[0].split("."), "", ""]
    moving, names = scene.moving(), [f.name for f in fields(Start)]
    if name not in moving:
        allowed = ", ".join(f"start.{n}" for n in moving) or "a scene with an object that moves"
        raise InputError(f"{path}: {name or 'an object without a name'} does not move; allowed: {allowed}")
    if field not in names:
        allowed = ", ".join(f"start.{name}.{n}" for n in names)
        raise InputError(f"{path}: a start has no {field or 'part without a name'}; allowed: {allowed}")
    body = scene.object[name].body
    assert body is not None
    if field == "spin" and not body.rotation:
        raise InputError(f"{path}: the body does not rotate; allowed: start.{name}.velocity")
    return name, field


def _measured(scene: Scene, recording: Recording, name: str) -> dict[str, np.ndarray]:
    """Position, rotation, velocity and spin at the recording's beginning, by straight lines through its first poses."""
    thing, still = scene.object[name], np.zeros(3)
    turn = Rotation.from_quat(np.asarray(thing.orientation, np.float64), scalar_first=True)
    rest = {
        "position": np.asarray(thing.position),
        "rotation": turn.as_rotvec(),
        "velocity": still,
        "spin": still,
    }
    times, poses = recording.pose_t, recording.pose
    if times is None or poses is None or recording.hip_t is None or len(times) < 2:
        return rest
    after = times - recording.hip_t[0]
    first = int(np.searchsorted(after, -1e-9))
    last = max(first + _LEAST, int(np.searchsorted(after, after[min(first, len(after) - 1)] + _SPAN)))
    near = slice(first, last)
    if len(after[near]) < 2 or after[first] > _LATE:
        return rest
    samples = poses[near, scene.moving().index(name)]
    turns = Rotation.from_quat(samples[:, 3:], scalar_first=True)
    turned = (turns * turns[0].inv()).as_rotvec()
    values = np.concatenate([samples[:, :3], turned], axis=1)
    rate, begin = np.polyfit(after[near], values, 1)
    matrix = (Rotation.from_rotvec(begin[3:]) * turns[0]).as_matrix()
    arm = _centre_of(thing, matrix)
    return {
        "position": begin[:3],
        "rotation": Rotation.from_matrix(matrix).as_rotvec(),
        "velocity": rate[:3] + np.cross(rate[3:], arm),
        "spin": rate[3:],
    }


def _centre_of(thing: Object, matrix: np.ndarray) -> np.ndarray:
    """From the origin of an object's frame to its centre of mass, m, world frame."""
    assert thing.body is not None
    centre = centre_within(thing.body, thing.shape)
    return np.zeros(3) if centre is None else matrix @ np.asarray(centre, np.float64)
