"""The course of the moving objects as it was measured: where they were at each step, and how fast."""

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float
from scipy.spatial.transform import Rotation

from hapjax import Recording, Scene, State, rotation
from hapjax.body import Motion, centre_of

# A local polynomial of this degree through so many samples, and through more where they lie on one as well.
_DEGREE = 3
_SPANS = (9, 15, 25, 41, 81)
_AS_WELL = 1.1
_AT_ONCE = 4096  # times, to bound the memory
_LONGEST = 0.05  # s from sample to sample: of what is seen less often, one does not know how it moved between


class Course(eqx.Module):
    """Measured motion at each of T steps: `pose` (T, O, 7) x y z qw qx qy qz of the objects' frames before the step,
    `velocity` (T, O, 3) m/s of their origins and `spin` (T, O, 3) rad/s, world frame; `restart` (T,), before which
    steps the model's objects are put there.
    """

    pose: Float[Array, "*r T O 7"]
    velocity: Float[Array, "*r T O 3"]
    spin: Float[Array, "*r T O 3"]
    restart: Bool[Array, "*r T"]

    def windows(self, steps: int) -> "Course":
        """The same motion, with a restart each so many steps, where `restart` allows it."""
        begins = jnp.arange(self.restart.shape[-1]) % steps == 0
        return replace(self, restart=self.restart & jnp.broadcast_to(begins, self.restart.shape))

    def uncut(self) -> "Course":
        """The same motion, without restarts."""
        return replace(self, restart=jnp.zeros_like(self.restart))


def restarted(scene: Scene, state: State, now: Course) -> State:
    """The state before a step; where it is a restart, its objects move as measured, and their god-objects ride along."""
    motions = OrderedDict()
    for i, (name, motion) in enumerate(state.motion.items()):
        thing, position = scene.object[name], now.pose[i, :3]
        assert thing.body is not None
        turn = rotation.normalise(now.pose[i, 3:])
        arm = centre_of(thing.body, thing.shape, position, rotation.to_matrix(turn)) - position
        spin = None if motion.spin is None else now.spin[i]
        velocity = now.velocity[i] if spin is None else now.velocity[i] + jnp.cross(spin, arm)
        seen = Motion(position, turn, velocity, spin)
        motions[name] = jax.tree.map(lambda new, old: jnp.where(now.restart, new, old), seen, motion)
    return replace(state, motion=motions)


def course_of(
    recording: Recording, times: Float[np.ndarray, "T"], noise: Float[np.ndarray, "6"], dtype: Any
) -> Course | None:
    """The measured course at `times` (s); `None` where it was not measured, or too seldom.

    Places and rotation vectors are those of the local cubic through the nearest samples: of 9, or of as many more as
    lie on it about as well (by at most a tenth worse, over the `noise` of places, m, and angles, rad), because their
    noise is then the smaller. `restart` is true where the samples reach.
    """
    sampled, poses = recording.pose_t, recording.pose
    if sampled is None or poses is None or len(sampled) < _SPANS[0]:
        return None
    between = float(np.median(np.diff(sampled)))
    if between > _LONGEST:
        return None
    found, rms = _smoothed(sampled, poses, times, _SPANS[0], noise)
    for span in [n for n in _SPANS[1:] if n <= len(sampled)]:
        smoother, wider = _smoothed(sampled, poses, times, span, noise)
        if wider > _AS_WELL * rms:
            break
        found = smoother
    gap = np.diff(sampled)[np.clip(np.searchsorted(sampled, times) - 1, 0, len(sampled) - 2)]
    seen = (times >= sampled[0]) & (times <= sampled[-1]) & (gap <= 2 * between)
    seen[0] = False  # there the scene says where things are
    pose, velocity, spin = (jnp.asarray(x, dtype) for x in found)
    return Course(pose, velocity, spin, jnp.asarray(seen))


def unseen(steps: int, objects: int, dtype: Any) -> Course:
    """A course that was not measured: no restarts."""
    still = jnp.zeros((steps, objects, 3), dtype)
    return Course(jnp.zeros((steps, objects, 7), dtype), still, still, jnp.zeros(steps, bool))


def _smoothed(
    sampled: Float[np.ndarray, "N"],
    poses: Float[np.ndarray, "N O 7"],
    times: Float[np.ndarray, "T"],
    span: int,
    noise: Float[np.ndarray, "6"],
) -> tuple[tuple[np.ndarray, ...], float]:
    """Pose, velocity and spin from local cubics, and how far samples lie from those in units of the noise."""
    pieces = np.array_split(times, -(-len(times) // _AT_ONCE))
    parts = [_cubics(sampled, poses, some, span, noise) for some in pieces]
    pose, velocity, spin, off = (np.concatenate(x) for x in zip(*parts, strict=True))
    return (pose, velocity, spin), float(np.sqrt(np.mean(off) / (1 - (_DEGREE + 1) / span)))


def _cubics(sampled, poses, times, span: int, noise) -> tuple[np.ndarray, ...]:
    """As `_smoothed`; the mean squared distance of samples at each of the times."""
    first = np.clip(np.searchsorted(sampled, times) - span // 2, 0, len(sampled) - span)
    near = first[:, None] + np.arange(span)
    length = sampled[near[:, -1]] - sampled[near[:, 0]]
    powers = ((sampled[near] - times[:, None]) / length[:, None])[..., None] ** np.arange(_DEGREE + 1)
    samples = poses[near]
    middle = samples[:, span // 2]
    base = np.broadcast_to(middle[:, None, :, 3:], (*samples.shape[:-1], 4))
    turned = (_rotation(base).inv() * _rotation(samples[..., 3:])).as_rotvec().reshape(*base.shape[:-1], 3)
    values = np.concatenate([samples[..., :3], turned], axis=-1)
    cubic = np.einsum("tkn,tnoj->tkoj", np.linalg.pinv(powers), values)
    off = (values - np.einsum("tnk,tkoj->tnoj", powers, cubic)) / noise

    place, vector = cubic[:, 0, :, :3], cubic[:, 0, :, 3:]
    rate = cubic[:, 1] / length[:, None, None]
    turn = _rotation(middle[..., 3:]) * Rotation.from_rotvec(vector.reshape(-1, 3))
    # In the object's frame the spin is d(vector)/dt: the vector, from the nearest sample, is small.
    spin = np.reshape(turn.apply(rate[..., 3:].reshape(-1, 3)), vector.shape)
    orientation = turn.as_quat(scalar_first=True).reshape(*place.shape[:-1], 4)
    return np.concatenate([place, orientation], axis=-1), rate[..., :3], spin, np.mean(off**2, axis=(1, 2, 3))


def _rotation(quaternions: Float[np.ndarray, "*n 4"]) -> Rotation:
    return Rotation.from_quat(quaternions.reshape(-1, 4), scalar_first=True)


def stacked(courses: Sequence[Course]) -> Course:
    """Courses of one size along a first axis."""
    return jax.tree.map(lambda *x: jnp.stack(x), *courses)
