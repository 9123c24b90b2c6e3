"""A human hand as a mass on a spring and a damper, whose other end follows a script or goes where it is told."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy.polynomial.polynomial import polyder, polyval
from numpy.typing import ArrayLike

from hapjax import InputError

from .reflex import Reflex, ReflexArc
from .tremor import Tremor


@dataclass(frozen=True)
class Hand:
    """An operator's hand: `mass` in kg, `stiffness` in N/m, `damping` in N s/m, all above 0.

    `damping` None is critical damping, 2 sqrt(stiffness mass). `reflex`: what pulls late, beside these; `tremor`: what
    makes the hand tremble; None: off.
    """

    mass: float = 0.15
    stiffness: float = 400.0
    damping: float | None = None
    reflex: Reflex | None = None
    tremor: Tremor | None = None

    def __post_init__(self):
        for name in ("mass", "stiffness", "damping"):
            value = getattr(self, name)
            if value is not None and not 0 < value < np.inf:
                raise InputError(f"{name} of the hand is {value}; allowed: above 0")

    def transition(self, period: float) -> Float[np.ndarray, "2 2"]:
        """What becomes of (offset, velocity) from the spring's end in `period` seconds without a force.

        The exponential of t A, A = [[0, 1], [-k/m, -c/m]], in closed form: with s = c / 2m and w^2 = s^2 -
        k/m it is exp(-s t) (cosh(w t) I + sinh(w t) / w (A + s I)); w is imaginary below critical damping.
        """
        c = 2 * np.sqrt(self.stiffness * self.mass) if self.damping is None else self.damping
        decay = c / (2 * self.mass)
        w = np.emath.sqrt(decay**2 - self.stiffness / self.mass)
        matrix = np.array([[0.0, 1.0], [-self.stiffness / self.mass, -c / self.mass]])
        # Near critical damping sinh(w t) / w is a ratio of two roundings; its limit is t.
        slope = period if abs(w * period) < 1e-6 else np.sinh(w * period) / w
        moved = np.cosh(w * period) * np.eye(2) + slope * (matrix + decay * np.eye(2))
        return np.exp(-decay * period) * np.real(moved)


class Operator:
    """A hand that follows a path and yields to forces: m x'' = k (p - x) + c (p' - x') + f.

    Exact for a force that is constant and a path that is straight between samples, so stable for any
    period. Time is counted in samples, never taken from a clock: the same script gives the same motion. The hand's
    reflex and tremor add to f, each with its mean over the sample, which is exact to second order in the period.

    **Arguments:** `path` (T, 3) m, where the hand wants to be at each sample, its last row from then on, or where
    `again`, the whole of it from the first row on, without end; `period` in s between samples, above 0.
    """

    def __init__(self, path: Float[np.ndarray, "T 3"], period: float, hand: Hand, again: bool = False):
        path = np.array(path, np.float64)
        if path.ndim != 2 or path.shape[1] != 3 or not len(path) or not np.all(np.isfinite(path)):
            raise InputError(
                f"path has the shape {path.shape}; allowed: (T, 3) finite numbers in m, T at least 1"
            )
        if not 0 < period < np.inf:
            raise InputError(f"period is {period} s; allowed: above 0")
        self._path, self._period, self._again = path, period, again
        self._passage: tuple[int, int, np.ndarray] | None = (
            None  # its first sample, how many, its coefficients
        )
        self._reflex = None if hand.reflex is None else ReflexArc(hand.reflex, period)
        self._tremor = hand.tremor
        self._transition = hand.transition(period).tolist()
        self._compliance = 1 / hand.stiffness
        self._sample = 0
        self.position = path[0].copy()
        self.velocity = np.zeros(3)

    def advance(self, force: Float[np.ndarray, "3"]) -> None:
        """Go on to the next sample while `force` (N) pushes the hand."""
        start, end = self._goal(self._sample), self._goal(self._sample + 1)
        if self._reflex is not None:
            force = force + self._reflex(self.position - start, self.velocity - (end - start) / self._period)
        if self._tremor is not None:
            force = force + self._tremor.force((self._sample + 0.5) * self._period)
        axes = zip(*(x.tolist() for x in (start, end, force, self.position, self.velocity)), strict=True)
        self.position, self.velocity = np.array([self._moved(*axis) for axis in axes]).T
        self._sample += 1

    def _moved(
        self, start: float, end: float, force: float, position: float, velocity: float
    ) -> tuple[float, float]:
        """Of one axis, place and velocity at the next sample. NumPy's calls take longer for three of them."""
        pace = (end - start) / self._period
        rest = force * self._compliance  # where the force alone would hold the hand, from the path
        offset, slip = position - start - rest, velocity - pace
        (a, b), (c, d) = self._transition
        return end + rest + a * offset + b * slip, pace + c * offset + d * slip

    @property
    def goal(self) -> Float[np.ndarray, "3"]:
        """Where the hand wants to be now, m."""
        return self._goal(self._sample)

    def go_to(self, point: ArrayLike, duration: float) -> None:
        """From now on the hand wants to be at `point` (m), and passes there in `duration` seconds, in place of its path.

        The goal goes on from its place, velocity and acceleration to rest at the point with the least jerk, a quintic
        (Flash and Hogan 1985); within the passage it can be told anew.

        **Raises:** `InputError` for a point that is not three finite numbers, and a duration not above 0.
        """
        end = _point(point)
        if not 0 < duration < np.inf:
            raise InputError(f"duration is {duration} s; allowed: above 0")
        count = max(1, round(duration / self._period))
        place, velocity, acceleration = self._goal_moves()
        first, second, way = velocity * count, acceleration * count**2, end - place
        coefficients = [
            *(place, first, second / 2, 10 * way - 6 * first - 1.5 * second),
            *(-15 * way + 8 * first + 1.5 * second, 6 * way - 3 * first - 0.5 * second),
        ]
        self._passage = self._sample, count, np.array(coefficients)

    def follow(self, point: ArrayLike, speed: float) -> None:
        """From now on the hand wants to be at `point` (m), and goes there straight at `speed` (m/s), in place of its path.

        **Raises:** `InputError` for a point that is not three finite numbers, and a speed not above 0.
        """
        end = _point(point)
        if not 0 < speed < np.inf:
            raise InputError(f"speed is {speed} m/s; allowed: above 0")
        place = self.goal
        way = end - place
        count = max(1, int(np.ceil(np.sqrt(way @ way) / (speed * self._period))))
        self._passage = self._sample, count, np.array([place, way])

    def _goal_moves(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The goal's place, velocity and acceleration now, in samples."""
        place = self._goal(self._sample)
        if self._passage is None:
            return place, place - self._goal(max(self._sample - 1, 0)), np.zeros(3)
        begun, count, coefficients = self._passage
        u = min((self._sample - begun) / count, 1.0)
        slopes = (polyder(coefficients, order) for order in (1, 2))
        velocity, acceleration = (polyval(u, slope) / count**order for order, slope in enumerate(slopes, 1))
        return place, velocity, acceleration

    def _goal(self, sample: int) -> Float[np.ndarray, "3"]:
        if self._passage is not None:
            begun, length, coefficients = self._passage
            return np.asarray(polyval(min((sample - begun) / length, 1.0), coefficients))
        count = len(self._path)
        return self._path[sample % count if self._again else min(sample, count - 1)]


def _point(point: ArrayLike) -> Float[np.ndarray, "3"]:
    found = np.array(point, np.float64)
    if found.shape != (3,) or not np.all(np.isfinite(found)):
        raise InputError(f"point is {np.asarray(point).tolist()}; allowed: three finite numbers in m")
    return found


def waypoints(
    times: Sequence[float], values: ArrayLike, t: Float[np.ndarray, "T"]
) -> Float[np.ndarray, "T ..."]:
    """Smooth passage from value to value: at rest at each of `times` (s), and of least jerk in between.

    The least jerk from rest to rest is the quintic 10 u^3 - 15 u^4 + 6 u^5 (Flash and Hogan 1985). Before the
    first time and after the last, their values hold.

    **Arguments:** `times`, increasing, one for each of `values` (numbers or arrays of one shape); `t` (T,) s,
    where the passage is wanted.
    """
    knots, levels = np.asarray(times, np.float64), np.asarray(values, np.float64)
    if knots.ndim != 1 or len(knots) < 2 or len(levels) != len(knots) or np.any(np.diff(knots) <= 0):
        raise InputError(
            f"times are {list(times)}; allowed: two or more that increase, one for each of the values"
        )
    t = np.clip(t, knots[0], knots[-1])
    leg = np.clip(np.searchsorted(knots, t, side="right") - 1, 0, len(knots) - 2)
    u = (t - knots[leg]) / (knots[leg + 1] - knots[leg])
    blend = u**3 * (10 + u * (6 * u - 15))
    blend = blend.reshape(blend.shape + (1,) * (levels.ndim - 1))
    return levels[leg] + blend * (levels[leg + 1] - levels[leg])
