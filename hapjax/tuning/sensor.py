"""A force sensor and a pose tracker that are not there, on a real object that is another scene."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..extras import need
from ..scene import Scene, dtype_of
from ..simulate import init, rollout

CHUNK = 50  # ticks that are answered together: one compiled program for all


class Measured(NamedTuple):
    """What was measured at each of T ticks: `force` (T, F, 3) N on the fingers; `pose` (T, O, 7) m and quaternion of the
    objects that move, at the ticks' ends."""

    force: Float[np.ndarray, "T F 3"]
    pose: Float[np.ndarray, "T O 7"]


class SimulatedSensor:
    """Measures what a scene, the truth, would answer to fingers, with white noise.

    It has to be shown every tick from the first one on: an object that moves is where all of them have moved it.

    **Arguments:** the `truth`; the `rate` of the ticks, Hz; `seed` of the noise.
    """

    def __init__(self, truth: Scene, rate: float, seed: int = 0):
        devices = need("hapjax_devices", "devices")
        self._truth, self._dt, self._state = truth, 1 / rate, None
        self._force, self._pose = devices.ForceSensor(rate, seed=seed), devices.PoseTracker(rate, seed=seed)
        self._turned = truth.torsion is not None and truth.torsion.needs_gimbal
        self.noise = self._force.noise

    def measure(self, hip: Float[np.ndarray, "T F 3"], gimbal: Float[np.ndarray, "T G"]) -> Measured:
        """What is measured at the next CHUNK ticks with the fingers at `hip` (m) and their gimbals at `gimbal` (rad)."""
        dtype = dtype_of(self._truth)
        hips = jnp.asarray(hip, dtype)
        gimbals = jnp.asarray(gimbal, dtype) if self._turned else None
        if self._state is None:
            self._state = init(self._truth, hips[0], None if gimbals is None else gimbals[0])
        self._state, reply = rollout(self._truth, self._state, hips, self._dt, gimbals)
        force, pose = np.asarray(reply.force, np.float64), np.asarray(reply.pose, np.float64)
        noisy = self._force.measure(force.reshape(-1, 3)).reshape(force.shape)
        return Measured(noisy, self._pose.measure(pose.reshape(-1, 7)).reshape(pose.shape))
