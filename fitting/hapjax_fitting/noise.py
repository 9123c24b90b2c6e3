"""How noisy the measurements are: given, estimated from the recordings, or seen in the residuals."""

from collections.abc import Mapping, Sequence
from numbers import Real
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float
from scipy.ndimage import uniform_filter1d

from hapjax import InputError, Recording

from .observation import LOST, Noise

_ENOUGH, _LONG = 20, 101  # samples: so many tell noise from a force, and of so many the mean is taken
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
        if isinstance(value, bool) or not isinstance(value, Real) or not 0 < float(value) < np.inf:
            raise InputError(f"noise of {name} is {value!r}; allowed: a number above 0")
    poses = [r.pose for r in recordings if r.pose is not None]
    found = {
        "force": _third([r.force for r in recordings if r.force is not None]),
        "position": _third([p[..., :3] for p in poses]),
        # A turn from one sample to the next is a first difference already.
        "angle": _estimate([np.diff(_turns(p[..., 3:]), n=2, axis=0) for p in poses], np.pi),
    }
    return Noise(**{name: jnp.asarray(given.get(name, found[name]), dtype) for name in _FIELDS})


def is_quiet(force: Float[np.ndarray, "N F 3"], noise: float) -> bool:
    """Whether a force is no more than noise (N): each sample of it, and, but for what it always is, its mean over a time."""
    strongest = float(np.linalg.norm(force, axis=-1).max())
    if strongest == 0 or len(force) < _ENOUGH:
        return strongest == 0
    mean = uniform_filter1d(force - np.median(force, axis=0), min(_LONG, len(force)), axis=0)
    return strongest <= 6 * noise and float(np.linalg.norm(mean, axis=-1).max()) <= noise


def _third(series: Sequence[np.ndarray]) -> float:
    size = max((float(np.abs(s).max()) for s in series), default=1.0)
    return _estimate([np.diff(s, n=3, axis=0) for s in series], size)


def _estimate(thirds: Sequence[np.ndarray], size: float) -> float:
    """The noise of series of a given size, from their third differences; never 0, also where the data are
    exact."""
    differences = np.concatenate([np.abs(d).ravel() for d in thirds] or [np.zeros(0)])
    if not len(differences):
        return 1.0
    differences = differences[differences > 0]
    floor = max(1e-6 * size, 1e-12)
    return max(float(np.median(differences)) / (0.6745 * np.sqrt(20)), floor) if len(differences) else floor


def _turns(quaternions: Float[np.ndarray, "N O 4"]) -> Float[np.ndarray, "M O 3"]:
    """The rotation vectors (rad, small) from each sample to the next, in the frame of the first."""
    first, second = quaternions[:-1], quaternions[1:]
    w, v = first[..., :1], first[..., 1:]
    scalar = np.sum(first * second, axis=-1, keepdims=True)
    vector = w * second[..., 1:] - second[..., :1] * v - np.cross(v, second[..., 1:])
    return 2 * np.sign(scalar) * vector


def spread_of(
    channels: Sequence[tuple[str, Float[Any, "_ _ _"]]], given: Mapping[str, float] | None, free: int
) -> tuple[dict[str, float], Float[np.ndarray, " n"]]:
    """Root mean square of each channel's whitened residuals, and the variance that each residual stands for.

    Noise that was given is believed: variance 1. Noise that was estimated is replaced by what the residuals
    turned out to be, allowing for the `free` numbers fitted to them, times their `correlation_time`: where
    the model is wrong, neighbouring residuals err alike, and count as fewer samples than there are. Samples that
    the model lost count for nothing, unless it lost all of a channel.
    """
    parts: dict[str, list[np.ndarray]] = {}
    followed: dict[str, int] = {}
    for key, r in channels:
        parts.setdefault(key, []).append(np.where(lost(r)[..., None], 0, np.asarray(r, np.float64)))
        followed[key] = followed.get(key, 0) + int(np.sum(~lost(r))) * r.shape[2]
    for key in [key for key, number in followed.items() if not number]:
        parts[key] = [np.asarray(r, np.float64) for name, r in channels if name == key]
        followed[key] = sum(r.size for r in parts[key])
    size = {key: float(np.sqrt(sum(np.sum(x**2) for x in r) / followed[key])) for key, r in parts.items()}
    count = sum(followed.values())
    variance = {
        key: 1.0 if key in (given or {}) else size[key] ** 2 * count / (count - free) * correlation_time(r)
        for key, r in parts.items()
    }
    return size, np.concatenate([np.full(r.size, variance[key]) for key, r in channels])


def lost(residuals: Float[Any, "R N _"]) -> Bool[np.ndarray, "R N"]:
    """Which samples the model lost, as far as their residuals tell."""
    return np.all(np.asarray(residuals) > 0.99 * LOST, axis=2)


def correlation_time(series: Sequence[Float[np.ndarray, "_ _ _"]]) -> float:
    """How many successive residuals err alike, at least 1: 1 + 2 sum of their autocorrelation.

    The sum ends where two neighbouring terms first are no longer above 0 together (Geyer 1992, section 3.3,
    the initial positive sequence). The mean is not taken off: a constant error is one error, however often
    it is measured.
    """
    length = max(r.shape[1] for r in series)
    products = np.zeros(length)
    for r in series:
        spectrum = np.abs(np.fft.rfft(r, 2 * r.shape[1], axis=1)) ** 2
        products[: r.shape[1]] += np.fft.irfft(spectrum, axis=1)[:, : r.shape[1]].sum(axis=(0, 2))
    if products[0] <= 0:
        return 1.0
    correlation = products / products[0]
    pairs = correlation[: length // 2 * 2].reshape(-1, 2).sum(axis=1)
    ends = np.flatnonzero(pairs <= 0)
    return max(1.0, 2 * float(np.sum(pairs[: ends[0] if len(ends) else None])) - 1)
