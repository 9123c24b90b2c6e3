"""Sensors beside the devices, each with its own noise and its own clock."""

import numpy as np
from jaxtyping import Float

from hapjax import InputError


class ForceSensor:
    """Measures the forces that the devices put out, with white noise.

    **Arguments:** `rate` in Hz; `noise`, the standard deviation of each axis in N, 0 or above; `seed` of the
    noise.
    """

    def __init__(self, rate: float = 500.0, noise: float = 0.02, seed: int = 0):
        _check("the force sensor's rate", rate, "Hz", above=True)
        _check("the force sensor's noise", noise, "N")
        self.rate, self.noise = rate, noise
        self._random = np.random.default_rng([seed, 1])

    def measure(self, force: Float[np.ndarray, "F 3"]) -> Float[np.ndarray, "F 3"]:
        """A sample of `force` (N)."""
        return force + self.noise * self._random.standard_normal(force.shape)


class PoseTracker:
    """Measures the poses of the moving objects, with white noise on the place and on the rotation.

    **Arguments:** `rate` in Hz; `place_noise`, the standard deviation of each axis in m; `angle_noise`,
    that of each component of the rotation vector in rad; both 0 or above; `seed` of the noise.
    """

    def __init__(
        self,
        rate: float = 100.0,
        place_noise: float = 1e-4,
        angle_noise: float = np.radians(0.1),
        seed: int = 0,
    ):
        _check("the pose tracker's rate", rate, "Hz", above=True)
        _check("the pose tracker's place_noise", place_noise, "m")
        _check("the pose tracker's angle_noise", angle_noise, "rad")
        self.rate, self.place_noise, self.angle_noise = rate, place_noise, angle_noise
        self._random = np.random.default_rng([seed, 2])

    def measure(self, pose: Float[np.ndarray, "O 7"]) -> Float[np.ndarray, "O 7"]:
        """A sample of `pose`, each x y z (m) qw qx qy qz."""
        pose = np.asarray(pose, np.float64)
        place = pose[:, :3] + self.place_noise * self._random.standard_normal((len(pose), 3))
        turned = _turn(self.angle_noise * self._random.standard_normal((len(pose), 3)), pose[:, 3:])
        return np.concatenate([place, turned], axis=1)


def _turn(vector: Float[np.ndarray, "O 3"], q: Float[np.ndarray, "O 4"]) -> Float[np.ndarray, "O 4"]:
    """Quaternions w x y z turned by rotation vectors (rad), normalised. In NumPy: the servo loop calls it."""
    angle = np.linalg.norm(vector, axis=1, keepdims=True)
    p = np.sinc(angle / (2 * np.pi)) / 2 * vector  # sin(a / 2) times the axis, at 0 too
    w = np.cos(angle / 2)
    real = w * q[:, :1] - np.sum(p * q[:, 1:], axis=1, keepdims=True)
    turned = np.concatenate([real, w * q[:, 1:] + q[:, :1] * p + np.cross(p, q[:, 1:])], axis=1)
    return turned / np.linalg.norm(turned, axis=1, keepdims=True)


def _check(name: str, value: float, unit: str, above: bool = False) -> None:
    if not (value > 0 if above else value >= 0) or not np.isfinite(value):
        raise InputError(f"{name} is {value} {unit}; allowed: {'above 0' if above else '0 or above'}")
