"""Recordings played through the fitted scene: what is plotted beside what was measured."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax
import numpy as np

from hapjax import Recording, Scene, Surface, rotation

from .grip import Grip, grips
from .observation import CHANNELS, Observation, as_sensed, observation_of, predicted
from .result import FitResult
from .sensors import Sensors


@dataclass(frozen=True)
class Compared:
    """One channel: measured and predicted values (N, n, m) at the times (N,) s of the samples."""

    time: np.ndarray
    measured: np.ndarray
    predicted: np.ndarray


@dataclass(frozen=True)
class Touching:
    """How fingers touch one object, or an object's points another: over the model's steps (T,) s.

    `normal` and `tangential` (T, n) N; `slipping` (T, n); `limit` (T, n) N, mu times the normal force,
    `None` where mu is not known; `mu`, the slopes of the cone's edge by what they are called; `measured` (K,
    2) N, the measured normal and tangential force of those samples at which a finger touches this object and
    no other.
    """

    path: str
    time: np.ndarray
    normal: np.ndarray
    tangential: np.ndarray
    slipping: np.ndarray
    limit: np.ndarray | None
    mu: Mapping[str, float]
    measured: np.ndarray | None

    def taken_together(self) -> "Touching":
        """All points as one, which slips when every point that touches does."""
        touches = self.normal > 0
        slipping = (self.slipping | ~touches).all(axis=1, keepdims=True) & touches.any(axis=1, keepdims=True)
        normal = self.normal.sum(axis=1, keepdims=True)
        tangential = self.tangential.sum(axis=1, keepdims=True)
        limit = None if self.limit is None else self.limit.sum(axis=1, keepdims=True)
        return replace(self, normal=normal, tangential=tangential, slipping=slipping, limit=limit)


@dataclass(frozen=True)
class Replay:
    """A recording beside what the fitted scene says of it."""

    channels: dict[str, Compared]
    touching: list[Touching]


def replay(result: FitResult, recording: Recording, name: str) -> Replay:
    """Play a recording through the fitted scene."""
    scene, sensors, starts = result.scene_of(name), result.sensors_of(name), result.starts_of(name)
    observation = observation_of(scene, recording, _channels(scene, recording), name)
    said = jax.jit(predicted)(scene, observation, sensors, starts)
    assert recording.hip_t is not None
    dt = float(scene.integrator.dt)
    times = recording.hip_t[0] + dt * np.arange(len(observation.hips))
    channels = {}
    for key in said:
        samples = getattr(observation, key)
        time = times[0] + dt * (np.asarray(samples.index) + np.asarray(samples.weight, np.float64))
        channels[key] = Compared(time, np.asarray(samples.value), np.asarray(said[key]))
    observation = as_sensed(sensors, observation, scene.integrator.dt)
    gimbals = None if observation.gimbals is None else observation.gimbals[None]
    played = grips(scene, observation.hips[None], gimbals, starts)
    found = {path: jax.tree.map(lambda x: np.asarray(x)[0], grip) for path, grip in played.items()}
    return Replay(channels, [_touching(result, name, path, found, times, observation) for path in found])


def _channels(scene: Scene, recording: Recording) -> tuple[str, ...]:
    posed = recording.pose is not None and recording.pose.shape[1] == len(scene.moving()) > 0
    return CHANNELS if posed else ("force",)


def _touching(
    result: FitResult,
    name: str,
    path: str,
    found: dict[str, Any],
    times: np.ndarray,
    observation: Observation,
) -> Touching:
    grip, surface = found[path], _surface(result.scene_of(name), path)
    limit = grip.mu * grip.factor * grip.normal_force
    size = grip.friction_force
    slipping = (size > 0) & (size >= (1 - 1e-4) * limit)
    if surface.mu_kinetic is not None:
        sliding = _of_face(surface.mu_kinetic, grip.face) * grip.factor * grip.normal_force
        slipping |= (size > 0) & (np.abs(size - sliding) <= 1e-4 * sliding)
    measured = (
        _measured(result.sensors_of(name), path, found, observation) if grip.direction is not None else None
    )
    slopes = _slopes(result, name, path, grip)
    if any("at least" in name for name in slopes) or not slopes:
        limit = None
    return Touching(path, times, grip.normal_force, size, slipping, limit, slopes, measured)


def _slopes(result: FitResult, recording: str, path: str, grip: Grip) -> dict[str, float]:
    """Each mu of the faces that were touched, and of the fingers where these differ."""
    surface, touched = _surface(result.scene_of(recording), path), np.asarray(grip.normal_force) > 0
    prefix = f"{path}.surface" if path.startswith("object.") else path
    faces, fingers = np.unique(np.asarray(grip.face)[touched]), np.flatnonzero(touched.any(axis=0))
    found = {}
    for field in ("mu", "mu_static", "mu_kinetic"):
        found |= _known(result, recording, f"{prefix}.{field}", getattr(surface, field), faces)
    if surface.finger_mu is None:
        return found
    factors = _known(result, recording, f"{prefix}.finger_mu", surface.finger_mu, fingers)
    return {
        f"{name} × {finger}": mu * factor for name, mu in found.items() for finger, factor in factors.items()
    }


def _known(result: FitResult, recording: str, path: str, value, places: np.ndarray) -> dict[str, float]:
    """The number of a path, or those of some places in it; a lower bound where that is all that is known."""
    found, field = {}, path.rsplit(".", 1)[-1]
    if value is None:
        return found
    for place in places if value.ndim else (None,):
        index = "" if place is None else f"[{place}]"
        name = f"{path}{index}"
        fitted = result.parameters.get(name, result.parameters.get(f"{name} @ {recording}"))
        if fitted is None or fitted.identified:
            found[f"{field}{index}"] = float(value if place is None else value[place])
        elif fitted.interval95[0] is not None:
            found[f"{field}{index} at least"] = fitted.interval95[0]
    return found


def _surface(scene: Scene, path: str) -> Surface:
    kind, name = path.split(".")
    surface = scene.object[name].surface if kind == "object" else scene.contact[name]
    assert surface is not None
    return surface


def _of_face(mu, face: np.ndarray) -> np.ndarray:
    value = np.asarray(mu)
    return value[face] if value.ndim else value


def _measured(
    sensors: Sensors, path: str, found: dict[str, Any], observation: Observation
) -> np.ndarray | None:
    """Measured forces taken apart along the normals that the model has at those times."""
    if observation.force is None:
        return None
    index = np.asarray(observation.force.index) + np.round(np.asarray(observation.force.weight)).astype(int)
    alone = found[path].normal_force > 0
    for other, grip in found.items():
        if other != path and grip.direction is not None:
            alone &= ~(grip.normal_force > 0)
    force, direction = sensors.corrected(observation.force.value), found[path].direction[index]
    normal = np.sum(force * direction, axis=-1)
    tangential = np.linalg.norm(force - normal[..., None] * direction, axis=-1)
    return np.stack([normal, tangential], axis=-1)[alone[index]]


def relative_turns(first: np.ndarray, quaternions: np.ndarray) -> np.ndarray:
    """The rotation vectors (N, O, 3) rad that lead from orientations (O, 4) to others (N, O, 4), world
    frame."""

    def one(p, q):
        return rotation.to_rotation_vector(rotation.product(rotation.normalise(q), rotation.conjugate(p)))

    return np.asarray(jax.jit(jax.vmap(jax.vmap(one), in_axes=(None, 0)))(first, quaternions))
