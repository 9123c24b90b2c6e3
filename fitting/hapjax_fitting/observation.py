"""What a recording says about a scene: measured samples beside the model's, each channel at its own times."""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Shaped

from hapjax import InputError, Recording, Reply, Scene, State, rollout, rotation, step
from hapjax.errors import within

from .course import Course, restarted
from .sensors import Sensors
from .sharding import Layout, gathered
from .spells import forces_in, onwards
from .start import Start, begun

CHANNELS = ("force", "pose")
_LARGEST = 1e6  # N or m
LOST = 1e6  # the whitened residual of what the model cannot follow
_MOST_STEPS = 10_000_000  # almost three hours at 1 kHz
_LONG_AGO = 1e8  # s since 1970: in 1973
PERFECT = Sensors()
AT_REST: Mapping[str, Start] = MappingProxyType({})  # where the scene puts things


class Samples(eqx.Module):
    """Measured values, and where they lie among the model's steps: between `index` and the next by
    `weight`; only the first `taken` were measured, the rest fills up (`None`: all were)."""

    value: Float[Array, "*r N n m"]
    index: Int[Array, "*r N"]
    weight: Float[Array, "*r N"]
    taken: Int[Array, "*r"] | None = None

    def between(self, series: Float[Array, "T n m"]) -> Float[Array, "N n m"]:
        """The model's series at the measurement's times, linearly interpolated."""
        weight = self.weight[:, None, None]
        return (1 - weight) * series[self.index] + weight * series[self.index + 1]

    def beside(self, steps: Bool[Array, " T"]) -> Bool[Array, " N"]:
        """Which samples are interpolated from some of the steps."""
        first, second = steps[self.index], steps[self.index + 1]
        return (first & (self.weight < 1)) | (second & (self.weight > 0))

    def only(self, found: Shaped[Array, "N *k"]) -> Shaped[Array, "N *k"]:
        """The same, with 0 for what was not measured."""
        if self.taken is None:
            return found
        here = jnp.arange(len(found), dtype=self.taken.dtype) < self.taken
        return jnp.where(here.reshape(-1, *(1 for _ in found.shape[1:])), found, jnp.zeros_like(found))

    def earlier(self, steps: Float[Array, ""], length: Int[Array, ""] | int) -> "Samples":
        """The same samples so many steps earlier in a series of this length, none beyond its ends."""
        place = self.weight - steps
        whole = jnp.floor(place)
        index, weight = self.index + whole.astype(self.index.dtype), place - whole
        weight = jnp.where(index < 0, 0, jnp.where(index > length - 2, 1, weight))
        return replace(self, index=jnp.clip(index, 0, length - 2), weight=weight)


class Observation(eqx.Module):
    """One recording, ready to be compared: the fingers' path on the model's time grid and the measured
    samples.

    `hips` (T, F, 3) m at intervals of the integrator's dt; `force` (N, F, 3) N; `pose` (N, O, 7); `gimbals` (T, F) rad,
    where the scene's torsion reads them; `place`, which of the recordings it is; `spells` (S, L), its spells of contact
    where they run side by side; `course`, where the model's objects are put back to where they were measured; `layout`,
    over which devices stacked recordings are spread; `steps`, how many are of the recording, the rest repeats its end
    (`None`: all are).
    """

    hips: Float[Array, "*r T F 3"]
    force: Samples | None
    pose: Samples | None
    gimbals: Float[Array, "*r T F"] | None = None
    place: Int[Array, "*r"] = eqx.field(default_factory=lambda: jnp.zeros((), jnp.int32))
    spells: Int[Array, "*r S L"] | None = None
    course: Course | None = None
    layout: Layout | None = eqx.field(static=True, default=None)
    steps: Int[Array, "*r"] | None = None

    @property
    def count(self) -> int:
        """How many recordings are stacked, without those that only fill up."""
        return len(self.hips) if self.layout is None else self.layout.count

    def numbers(self) -> int:
        """How many numbers were measured, in one recording or in all that are stacked: a pose is seven, of which six are
        free."""
        recordings, found = self.count if self.hips.ndim == 4 else 1, 0
        for samples, free in ((self.force, 3), (self.pose, 6)):
            if samples is not None:
                times = (
                    recordings * samples.value.shape[-3]
                    if samples.taken is None
                    else int(np.sum(gathered(samples.taken)[: self.count]))
                )
                found += times * samples.value.shape[-2] * free
        return found

    @property
    def places(self) -> Int[np.ndarray, " R"]:
        """Which recordings are stacked."""
        return gathered(self.place)[: self.count]


class Noise(eqx.Module):
    """Standard deviations of the measurements: `force` N, `position` m, `angle` rad."""

    force: Float[Array, ""]
    position: Float[Array, ""]
    angle: Float[Array, ""]


def observation_of(scene: Scene, recording: Recording, channels: tuple[str, ...], name: str) -> Observation:
    """Lay a recording on the scene's time grid. **Raises:** `InputError` where the two do not belong
    together."""
    if recording.hip is None or recording.hip_t is None:
        raise InputError(f"{name}: hip was not recorded; allowed: a recording with the fingers' positions")
    if len(recording.hip_t) < 2:
        raise InputError(f"{name}: hip has {len(recording.hip_t)} sample; allowed: at least 2")
    _check_size(recording, name)
    with within(f"{name}: "):
        recording.check_pauses()
    dtype, dt = scene.integrator.dt.dtype, float(scene.integrator.dt)
    start, hips = _on_grid(recording.hip_t, recording.hip, dt, name)
    force = pose = None
    if "force" in channels and recording.force is not None and recording.force_t is not None:
        force = _samples(recording.force_t, recording.force, start, dt, len(hips), dtype, f"{name}: force")
    if "pose" in channels and recording.pose is not None and recording.pose_t is not None:
        objects = scene.moving()
        if recording.pose.shape[1] != len(objects):
            raise InputError(
                f"{name}: pose has {recording.pose.shape[1]} objects; "
                f"allowed: {len(objects)}, as many as move in the scene"
            )
        pose = _samples(recording.pose_t, recording.pose, start, dt, len(hips) + 1, dtype, f"{name}: pose")
    if force is None and pose is None:
        raise InputError(
            f"{name}: nothing to compare was recorded; allowed: a recording with {' or '.join(channels)}"
        )
    gimbals = None
    if scene.torsion is not None and scene.torsion.needs_gimbal:
        with within(f"{name}: "):
            gimbals = jnp.asarray(recording.gimbal_at(start + dt * np.arange(len(hips))), dtype)
    return Observation(jnp.asarray(hips, dtype), force, pose, gimbals)


def as_sensed(sensors: Sensors, observation: Observation, dt: Float[Array, ""]) -> Observation:
    """The observation with its path in the world's frame, and its samples at the times of what they show."""
    steps, force, pose = observation.steps, observation.force, observation.pose
    steps = len(observation.hips) if steps is None else steps
    if force is not None and sensors.force_delay is not None:
        force = force.earlier(sensors.force_delay / dt, steps)
    if pose is not None and sensors.pose_delay is not None:
        pose = pose.earlier(sensors.pose_delay / dt, steps + 1)
    return replace(observation, hips=sensors.turned(observation.hips), force=force, pose=pose)


def residuals(
    scene: Scene,
    observation: Observation,
    noise: Noise,
    sensors: Sensors = PERFECT,
    starts: Mapping[str, Start] = AT_REST,
) -> dict[str, Float[Array, "N m"]]:
    """Predicted minus measured over the noise, m numbers a sample, for each of `force`, `position`, `angle`.

    A step's forces belong to the time of its HIP, its poses to the end of the step. A sample of which the model says
    nothing, because it left the range of sense, counts as `LOST` standard deviations, whatever the numbers: a search is
    not drawn to where there are more of them.
    """
    found = {}
    said = predicted(scene, observation, sensors, starts)

    def kept(samples: Samples, r: Float[Array, "N n 3"]) -> Float[Array, "N m"]:
        return samples.only(jnp.where(jnp.abs(r) < LOST, r, LOST).reshape(len(r), -1))

    if observation.force is not None:
        found["force"] = kept(observation.force, (said["force"] - observation.force.value) / noise.force)
    if observation.pose is not None:
        pose, measured = said["pose"], observation.pose.value
        off = (pose[..., :3] - measured[..., :3]) / noise.position
        found["position"] = kept(observation.pose, off)
        turned = _turn_between(measured[..., 3:], pose[..., 3:]) / noise.angle
        found["angle"] = kept(observation.pose, turned)
    return found


def predicted(
    scene: Scene,
    observation: Observation,
    sensors: Sensors = PERFECT,
    starts: Mapping[str, Start] = AT_REST,
) -> dict[str, Float[Array, "N n m"]]:
    """What the sensors show of the scene in each observed channel at the times of its samples; NaN from a lost step on
    until the model is found again: at the next spell or restart, else nowhere."""
    observation = as_sensed(sensors, observation, scene.integrator.dt)
    found = _predicted(scene, observation, starts)
    return found | {"force": sensors.shown(found["force"])} if "force" in found else found


def _predicted(
    scene: Scene, observation: Observation, starts: Mapping[str, Start]
) -> dict[str, Float[Array, "N n m"]]:
    if observation.spells is not None and observation.force is not None:
        force, lost = forces_in(scene, observation.hips, observation.spells)
        return {"force": _unless(lost, observation.force, force)}
    state, reply = played(scene, observation.hips, observation.gimbals, observation.course, starts)
    found = {}
    if observation.force is not None:
        found["force"] = _unless(reply.lost, observation.force, reply.force)
    if observation.pose is not None:
        first = jnp.stack([jnp.concatenate([m.position, m.orientation]) for m in state.motion.values()])
        lost = jnp.concatenate([jnp.zeros(1, bool), reply.lost])
        found["pose"] = _unless(
            lost, observation.pose, _unflipped(jnp.concatenate([first[None], reply.pose]))
        )
    return found


def _unless(
    lost: Bool[Array, " T"], samples: Samples, series: Float[Array, "T n m"]
) -> Float[Array, "N n m"]:
    """The model's series at the measurement's times; NaN where it is lost."""
    return jnp.where(samples.beside(lost)[:, None, None], jnp.nan, samples.between(series))


def played(
    scene: Scene,
    hips: Float[Array, "T F 3"],
    gimbals: Float[Array, "T F"] | None,
    course: Course | None = None,
    starts: Mapping[str, Start] = AT_REST,
) -> tuple[State, Reply]:
    """The state before the first step, and the replies of all, with the restarts of a course. `lost` are all steps from a
    lost one on until the next restart."""
    state = begun(scene, starts, hips[0], None if gimbals is None else gimbals[0])
    if course is None:
        reply = rollout(scene, state, hips, gimbals=gimbals)[1]
        return state, replace(reply, lost=onwards(reply.lost))

    def one(carry: tuple[State, Array], x):
        (state, lost), (hip, gimbal, now) = carry, x
        state, reply = step(scene, restarted(scene, state, now), hip, gimbal=gimbal)
        lost = reply.lost | (lost & ~now.restart)
        return (state, lost), replace(reply, lost=lost)

    return state, jax.lax.scan(one, (state, jnp.zeros((), bool)), (hips, gimbals, course))[1]


def _unflipped(pose: Float[Array, "T O 7"]) -> Float[Array, "T O 7"]:
    """The same poses, each quaternion of the sign of the one before: q and -q are one turn, their mean is none."""
    turn = pose[..., 3:]
    flipped = jnp.sum(turn[1:] * turn[:-1], axis=-1, keepdims=True) < 0
    odd = jnp.cumsum(flipped, axis=0) % 2 == 1
    return jnp.concatenate(
        [pose[..., :3], jnp.concatenate([turn[:1], jnp.where(odd, -turn[1:], turn[1:])])], axis=-1
    )


def _turn_between(first: Float[Array, "N O 4"], second: Float[Array, "N O 4"]) -> Float[Array, "N O 3"]:
    """The rotation vector (rad) from one orientation to the other, in the first one's frame."""

    def one(p, q):
        return rotation.to_rotation_vector(rotation.product(rotation.conjugate(p), rotation.normalise(q)))

    return jax.vmap(jax.vmap(one))(first, second)


def _check_size(recording: Recording, name: str) -> None:
    """Refuse what no device measures: squared, it would overflow."""
    positions = None if recording.pose is None else recording.pose[..., :3]
    channels = (
        ("hip", "m", recording.hip_t, recording.hip),
        ("force", "N", recording.force_t, recording.force),
        ("pose", "m", recording.pose_t, positions),
    )
    for channel, unit, times, values in channels:
        if times is None or values is None:
            continue
        flat = np.reshape(values, (len(times), -1))
        wrong = np.argwhere(np.abs(flat) > _LARGEST)
        if len(wrong):
            row, column = wrong[0]
            raise InputError(
                f"{name}: {channel} is {flat[row, column]:g} {unit} at {times[row]:g} s; "
                f"allowed: {-_LARGEST:g} to {_LARGEST:g} {unit}"
            )


def _on_grid(times: np.ndarray, hip: np.ndarray, dt: float, name: str) -> tuple[float, np.ndarray]:
    """The fingers' path at intervals of dt: as recorded if it has them, else interpolated."""
    # Every time is compared, not every interval: a clock that is slow by a thousandth drifts by samples.
    if np.allclose(times - times[0], dt * np.arange(len(times)), rtol=0, atol=1e-3 * dt):
        return float(times[0]), hip
    steps = int(np.floor((times[-1] - times[0]) / dt + 1e-6)) + 1
    if not 2 <= steps <= _MOST_STEPS:
        raise InputError(
            f"{name}: hip lasts {times[-1] - times[0]:g} s, {steps} steps of the integrator's dt, {dt:g} s; "
            f"allowed: 2 to {_MOST_STEPS} steps"
        )
    grid = times[0] + dt * np.arange(steps)
    flat = hip.reshape(len(times), -1)
    return float(times[0]), np.stack([np.interp(grid, times, c) for c in flat.T], axis=-1).reshape(
        steps, *hip.shape[1:]
    )


def _epoch(times, start: float) -> str:
    """What is said where one of two clocks counts from 1970 and the other does not."""
    if (times[0] > _LONG_AGO) == (start > _LONG_AGO):
        return ""
    return f"; {'its clock' if times[0] > _LONG_AGO else 'the clock of hip'} looks like Unix time"


def _samples(times, values, start: float, dt: float, length: int, dtype, name: str) -> Samples:
    place = (times - start) / dt
    inside = (place >= -1e-6) & (place <= length - 1 + 1e-6)
    if not inside.any():
        raise InputError(
            f"{name}_t runs from {times[0]:.10g} to {times[-1]:.10g} s; allowed: times within those of hip, "
            f"{start:.10g} to {start + dt * (length - 1):.10g} s, counted from the same moment{_epoch(times, start)}"
        )
    place = np.clip(place[inside], 0, length - 1)
    index = np.minimum(np.floor(place).astype(np.int32), length - 2)
    return Samples(jnp.asarray(values[inside], dtype), jnp.asarray(index), jnp.asarray(place - index, dtype))
