"""How noisy the measurements are: given, or estimated from the recordings."""

from collections.abc import Mapping, Sequence
from typing import Any

import jax.numpy as jnp
import numpy as np
from hapjax import InputError, Recording

from .observation import Noise

_FIELDS = ("force", "position", "angle")


def noise_of(recordings: Sequence[Recording], given: Mapping[str, float] | None, dtype: Any) -> Noise:
    """Standard deviations of force (N), position (m) and angle (rad).

    What is not given is estimated from the third differences along each channel, which a smooth signal hardly
    has and white noise has sqrt(20)-fold: their median size over 0.6745 sqrt(20).
    """
    given = dict(given or {})
    for name, value in given.items():
        if name not in _FIELDS:
            raise InputError(f"noise names {name}; allowed: {', '.join(_FIELDS)}")
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"noise of {name} is {value}; allowed: above 0")
    found = {
        "force": _estimate([r.force for r in recordings if r.force is not None]),
        "position": _estimate([r.pose[..., :3] for r in recordings if r.pose is not None]),
        # A small rotation vector is twice the change of the quaternion's vector part.
        "angle": 2 * _estimate([r.pose[..., 3:] for r in recordings if r.pose is not None]),
    }
    return Noise(**{name: jnp.asarray(given.get(name, found[name]), dtype) for name in _FIELDS})


def _estimate(series: Sequence[np.ndarray]) -> float:
    """The noise of several series (N, ...), from their third differences; never 0, also where the data are exact."""
    moving = [np.abs(np.diff(s, n=3, axis=0)).ravel() for s in series if len(s) > 3]
    if not moving or not sum(len(m) for m in moving):
        return 1.0
    differences = np.concatenate(moving)
    differences = differences[differences > 0]
    size = max(float(np.abs(s).max()) for s in series)
    floor = max(1e-6 * size, 1e-12)
    return max(float(np.median(differences)) / (0.6745 * np.sqrt(20)), floor) if len(differences) else floor
