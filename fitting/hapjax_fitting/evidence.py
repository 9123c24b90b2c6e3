"""Where the fingers of a recording are on the surfaces of a scene: by geometry alone, whatever friction and stiffness are.

No simulation: objects are where they are fixed, or where their recorded poses say, so that nothing here depends on the
numbers that a fit is to find.
"""

from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any

import jax
import numpy as np
from scipy.spatial.transform import Rotation

from hapjax import Mesh, Recording, Scene

from .noise import noise_of

_MOST = 4000  # samples that are looked at
_MOST_ON_MESHES = 500
_PIECE = 4**7  # points at once
_SELDOM = 0.1  # s: between poses farther apart it is not known where the object was


@dataclass(frozen=True)
class Places:
    """N moments, F fingers: signed `depth` (N, F) m in the surface that is touched most, its outward `normal` (N, F, 3).

    In the frame of the touched object: `normal`, and `point` (N, F, 3) m, the finger. `turn` (N, F, 3, 3) leads from there
    to the world; `fixed` (N, F): the object has no body. `rate` (N, F) m/s, of the depth, where it was asked for, else 0.
    """

    depth: np.ndarray
    normal: np.ndarray
    point: np.ndarray
    turn: np.ndarray
    fixed: np.ndarray
    which: np.ndarray
    rate: np.ndarray


@dataclass(frozen=True)
class Evidence:
    """A recording's moments of measured force, or of positions where no force was: N moments, F fingers.

    `force` (N, F, 3) N, world; `noise`, its standard deviation in N; `names`, of the objects that can be touched those that
    are known by their places, `whole`: all of them; `blur`, what the noise of force and of poses comes to in a force that is
    told by a depth, N.
    """

    scene: Scene
    recording: Recording
    times: np.ndarray
    force: np.ndarray | None
    noise: float
    blur: float
    whole: bool
    names: list[str]
    places: Places

    @property
    def touching(self) -> np.ndarray:
        return self.places.depth > 0

    @cached_property
    def normal(self) -> np.ndarray:
        """The outward normals in the world frame, (N, F, 3)."""
        return np.einsum("nfij,nfj->nfi", self.places.turn, self.places.normal)

    @cached_property
    def along(self) -> np.ndarray:
        """The force along the normals, (N, F) N."""
        assert self.force is not None
        return np.sum(self.force * self.normal, axis=-1)

    @cached_property
    def strength(self) -> np.ndarray:
        """The size of the force, (N, F) N."""
        assert self.force is not None
        return np.linalg.norm(self.force, axis=-1)

    @cached_property
    def pressed(self) -> np.ndarray:
        """Where a force is beyond doubt, (N, F)."""
        size = self.strength
        return size > max(5 * self.noise, 0.05 * float(np.quantile(size, 0.95)))

    def local(self) -> np.ndarray:
        """The force in the frame of the touched object, (N, F, 3) N."""
        assert self.force is not None
        return np.einsum("nfji,nfj->nfi", self.places.turn, self.force)

    def shifted(self, hip: np.ndarray, pose: np.ndarray, tick: float | None = None) -> Places:
        """Where the fingers were, with the clocks of `hip` and `pose` moved: lags (L, N) s, stacked to L N moments; with
        rates, from as many s as `tick` before to as many after, where it is given."""
        of_hip, of_pose = ((self.times - lags).ravel() for lags in (hip, pose))
        return _places(self.scene, self.recording, self.names, of_hip, of_pose, tick)


def evidence_of(scene: Scene, recording: Recording, most: int = _MOST) -> Evidence | None:
    """What a recording shows of touch at up to `most` moments; None where it has no positions or nothing can be touched."""
    names, whole = _known(scene, recording)
    if recording.hip is None or recording.hip_t is None or not names:
        return None
    if any(isinstance(scene.object[name].shape, Mesh) for name in names):
        most = min(most, _MOST_ON_MESHES)
    times, force = recording.hip_t, None
    if recording.force is not None and recording.force_t is not None:
        inside = (recording.force_t >= times[0]) & (recording.force_t <= times[-1])
        times, force = recording.force_t[inside], recording.force[inside]
    every = -(-len(times) // most) or 1
    times, force = times[::every], None if force is None else force[::every]
    if not len(times):
        return None
    places = _places(scene, recording, names, times, times)
    noise, blur = (0.0, 0.0) if force is None else _noise(scene, recording, force, places)
    return Evidence(scene, recording, times, force, noise, blur, whole, names, places)


def _noise(scene: Scene, recording: Recording, force: np.ndarray, places: Places) -> tuple[float, float]:
    """The standard deviation of a force, and of what a depth and a force say of each other, N."""
    spread = noise_of([recording], None, scene.integrator.dt.dtype)
    noise = max(float(spread.force), 1e-3 * float(np.sqrt(np.mean(force**2))))
    if places.fixed.all():
        return noise, noise
    inside = np.where(places.depth > 0, places.depth, 0)
    stiffness = np.sum(np.linalg.norm(force, axis=-1) * inside) / max(np.sum(inside**2), 1e-300)
    return noise, float(np.hypot(noise, min(stiffness, 1e6) * float(spread.position)))


def scaled(recording: Recording, **factors: float) -> Recording:
    """The recording with channels in another unit: `hip`, `force`, and of `pose` the position."""
    changed: dict[str, Any] = {}
    for name, factor in factors.items():
        values = getattr(recording, name)
        if values is not None and factor != 1:
            changed[name] = values * (np.array([factor] * 3 + [1.0] * 4) if name == "pose" else factor)
    return replace(recording, **changed)


def _known(scene: Scene, recording: Recording) -> tuple[list[str], bool]:
    """The touchable objects whose places are known, and whether those are all."""
    moving, touchable = scene.moving(), scene.touchable()
    tracked = (
        recording.pose is not None
        and recording.pose_t is not None
        and recording.pose.shape[1] == len(moving)
        and len(recording.pose_t) > 1
        and float(np.median(np.diff(recording.pose_t))) <= _SELDOM
    )
    names = [name for name in touchable if tracked or name not in moving]
    return names, len(names) == len(touchable)


def _places(
    scene: Scene,
    recording: Recording,
    names: list[str],
    hip_times: np.ndarray,
    pose_times: np.ndarray,
    tick: float | None = None,
) -> Places:
    best = None
    for which, name in enumerate(names):
        point, turn = _seen_from(scene, recording, name, hip_times, pose_times)
        shape = point.shape[:2]
        flat, normal = closest(scene.object[name].shape, point.reshape(-1, 3), scene.integrator.dt.dtype)
        normal, rate = normal.reshape(point.shape), np.zeros(shape)
        if tick is not None:
            after, before = (
                _seen_from(scene, recording, name, hip_times + t, pose_times + t)[0] for t in (tick, -tick)
            )
            rate = np.sum(normal * (before - after), axis=-1) / (2 * tick)
        found = Places(
            flat.reshape(shape),
            normal,
            point,
            np.broadcast_to(turn[:, None], (*shape, 3, 3)),
            np.full(shape, scene.object[name].body is None),
            np.full(shape, which),
            rate,
        )
        best = found if best is None else _deeper(best, found)
    assert best is not None
    return best


def _seen_from(
    scene: Scene, recording: Recording, name: str, hip_times: np.ndarray, pose_times: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """The fingers (N, F, 3) m in an object's frame, and the rotation matrices (N, 3, 3) from there to the world."""
    position, turn = _poses(scene, recording, name, pose_times)
    hip = at(hip_times, recording.hip_t, recording.hip)
    return np.matmul(hip - position[:, None], turn), turn


def _deeper(one: Places, other: Places) -> Places:
    deeper = other.depth > one.depth

    def pick(a, b):
        return np.where(deeper.reshape(deeper.shape + (1,) * (a.ndim - 2)), b, a)

    return Places(
        **{name: pick(getattr(one, name), getattr(other, name)) for name in Places.__dataclass_fields__}
    )


def _poses(scene: Scene, recording: Recording, name: str, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Positions (N, 3) m and rotation matrices (N, 3, 3) of an object."""
    object_ = scene.object[name]
    if object_.body is None:
        turn = Rotation.from_quat(np.asarray(object_.orientation, float), scalar_first=True).as_matrix()
        position = np.asarray(object_.position, float)
        return np.broadcast_to(position, (len(times), 3)), np.broadcast_to(turn, (len(times), 3, 3))
    assert recording.pose is not None and recording.pose_t is not None
    pose = recording.pose[:, scene.moving().index(name)].copy()
    turned = np.sum(pose[1:, 3:] * pose[:-1, 3:], axis=-1) < 0
    pose[1:, 3:] *= np.where(np.cumsum(turned) % 2 == 1, -1.0, 1.0)[:, None]
    between = at(times, recording.pose_t, pose)
    return between[:, :3], Rotation.from_quat(between[:, 3:], scalar_first=True).as_matrix()


def at(times: np.ndarray, clock, samples) -> np.ndarray:
    """Samples at other times, linearly interpolated."""
    place = (
        np.clip(np.searchsorted(clock, times) - 1, 0, len(clock) - 2)
        if len(clock) > 1
        else np.zeros(len(times), int)
    )
    if len(clock) == 1:
        return samples[place]
    weight = np.clip((times - clock[place]) / (clock[place + 1] - clock[place]), 0, 1)
    weight = weight.reshape((-1,) + (1,) * (samples.ndim - 1))
    return (1 - weight) * samples[place] + weight * samples[place + 1]


def closest(shape, points: np.ndarray, dtype) -> tuple[np.ndarray, np.ndarray]:
    """Depth (n,) m and outward normal (n, 3) at points (n, 3) m."""
    # Of few sizes, each of which is compiled: powers of four, then pieces of the largest.
    size = min(4 ** max(-(-(len(points) - 1).bit_length() // 2), 4), _PIECE)
    full = np.zeros((-(-len(points) // size) * size, 3), dtype)
    full[: len(points)] = points
    batch = 16 if isinstance(shape, Mesh) else 4096
    pieces = [_closest_each(shape, piece, batch) for piece in full.reshape(-1, size, 3)]
    depth, normal = (np.concatenate(x).astype(float)[: len(points)] for x in zip(*pieces, strict=True))
    return depth, normal


@partial(jax.jit, static_argnames="batch")
def _closest_each(shape, points, batch: int):
    def one(point):
        near = shape.closest(point)
        return near.depth, near.normal

    return jax.lax.map(one, points, batch_size=batch) if len(points) > batch else jax.vmap(one)(points)
