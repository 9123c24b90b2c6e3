"""The last look at every force before it goes to a device."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import hypot, isfinite

import numpy as np
from jaxtyping import Float, Shaped

from hapjax import InputError

from .event import Diary

# A force scaled to the limit may come out over it by the rounding of three products and a root.
_BELOW = 1 - 8 * np.finfo(np.float64).eps


@dataclass(frozen=True)
class Limits:
    """What a device may be told to do.

    `force`: the largest norm, N, above 0; `None`, and at most: the device's own `force_limit`. `slew`: how fast the force
    may rise or turn, N/s, above 0; a quick hand, 1 m/s, on the stiffest wall that 1 kHz can hold, 4000 N/m, needs the
    default. `ramp`: in how many s the force of a finger that is let in comes up, 0 or above.

    **Raises:** `InputError` for numbers out of range.
    """

    force: float | None = None
    slew: float = 4000.0
    ramp: float = 0.5

    def __post_init__(self):
        if self.force is not None and not 0 < self.force < np.inf:
            raise InputError(f"force of the limits is {self.force} N; allowed: above 0")
        if not self.slew > 0:
            raise InputError(f"slew of the limits is {self.slew} N/s; allowed: above 0")
        if not 0 <= self.ramp < np.inf:
            raise InputError(f"ramp of the limits is {self.ramp} s; allowed: 0 or above")


@dataclass
class Counts:
    """How many forces of one device were changed, for each reason: see `Safety`."""

    not_finite: int = 0
    limited: int = 0
    slewed: int = 0
    ramped: int = 0


class Safety:
    """What every force of every finger goes through as the last step.

    In this order:

    - A force with a component that is NaN or infinite becomes none (`not_finite`).
    - A finger is let in when its device is connected, is back after a fault, and after no force was put out because one
      was not finite or the loop was far too late. Its force then comes up from none in `Limits.ramp` (`ramped`), unless
      or until the finger is free: what it touches then begins with no force anyway.
    - A force over the device's limit keeps its direction and gets the limit as its norm (`limited`).
    - A force that has risen or turned faster than `Limits.slew` goes as far from the last one as it may (`slewed`). It may
      always fall.

    **Arguments:** `force_limits` of the devices, N; `rate` of the loop, Hz; `limits`, those of all devices or a sequence
    with those of each; `diary`, to which it is said when any of this begins and ends.

    **Attributes:** `counts`, of each device; `total`, of all of them.

    **Raises:** `InputError` for another number of limits than of devices.
    """

    def __init__(
        self,
        force_limits: Sequence[float],
        rate: float,
        limits: Limits | Sequence[Limits] = Limits(),  # noqa: B008
        diary: Diary | None = None,
    ):
        each = [limits] * len(force_limits) if isinstance(limits, Limits) else [*limits]
        if len(each) != len(force_limits):
            raise InputError(f"limits has {len(each)} items; allowed: {len(force_limits)}, one a device")
        diary = diary or Diary(rate)
        self.total = Counts()
        self._gates = [
            _Gate(finger, *pair, rate, diary, self.total)
            for finger, pair in enumerate(zip(force_limits, each, strict=True))
        ]
        self.counts = [gate.counts for gate in self._gates]

    def __call__(self, tick: int, finger: int, force: Sequence[float]) -> Float[np.ndarray, "3"]:
        """The force (N) that may go to the device of a finger at a tick."""
        return np.array(self._gates[finger].passed(tick, *force))

    def within(self, forces: Shaped[np.ndarray, "F 3"]) -> Float[np.ndarray, "F 3"]:
        """Forces (N) that are finite and within the limits, for what wants to know before the last step."""
        rows = zip(self._gates, forces.tolist(), strict=True)
        return np.array([gate.limited(*force) for gate, force in rows])

    def cut(self, finger: int) -> None:
        """The device of a finger puts out nothing now; the next force is the first of one that is let in."""
        self._gates[finger].cut()

    def cut_all(self) -> None:
        """The next force of each finger is none, and the first of one that is let in."""
        for gate in self._gates:
            gate.cut()


class _Gate:
    """The safety of one finger. In plain numbers: calls of NumPy for three of them take longer than all of it."""

    def __init__(
        self, finger: int, force_limit: float, limits: Limits, rate: float, diary: Diary, total: Counts
    ):
        self._finger, self._diary, self._total, self.counts = finger, diary, total, Counts()
        self._most = float(force_limit if limits.force is None else min(limits.force, force_limit))
        self._step = limits.slew / rate
        self._ramp = max(1, round(limits.ramp * rate))  # ticks
        self.cut()

    def cut(self) -> None:
        self._let_in, self._since, self._last = True, 0, (0.0, 0.0, 0.0)

    def passed(self, tick: int, x: float, y: float, z: float) -> tuple[float, float, float]:
        if isfinite(x) and isfinite(y) and isfinite(z):
            x, y, z = self._ramped(tick, x, y, z)
        self._last = self._slewed(*self.limited(x, y, z))
        return self._last

    def limited(self, x: float, y: float, z: float) -> tuple[float, float, float]:
        """The force, finite and within the device's limit."""
        if not (isfinite(x) and isfinite(y) and isfinite(z)):
            self._count("not_finite")
            self.cut()
            return 0.0, 0.0, 0.0
        size = hypot(x, y, z)
        if size > self._most:
            self._count("limited")
            return self._scaled(size, x, y, z)
        return x, y, z

    def _ramped(self, tick: int, x: float, y: float, z: float) -> tuple[float, float, float]:
        if self._let_in:
            self._let_in, self._since = False, tick
        elif self._since < 0:
            return x, y, z
        share = (tick - self._since) / self._ramp
        if share >= 1 or not (x or y or z):
            self._since = -1
            return x, y, z
        self._count("ramped")
        return share * x, share * y, share * z

    def _slewed(self, x: float, y: float, z: float) -> tuple[float, float, float]:
        """Of the forces from none to the last one that which is nearest, and from there as far as allowed."""
        a, b, c = self._last
        along = a * a + b * b + c * c
        share = min(max((a * x + b * y + c * z) / along, 0.0), 1.0) if along else 0.0
        a, b, c = share * a, share * b, share * c
        u, v, w = x - a, y - b, z - c
        gap = hypot(u, v, w)
        if gap <= self._step:
            return x, y, z
        self._count("slewed")
        part = self._step / gap
        x, y, z = a + part * u, b + part * v, c + part * w
        size = hypot(x, y, z)
        return self._scaled(size, x, y, z) if size > self._most else (x, y, z)

    def _scaled(self, size: float, x: float, y: float, z: float) -> tuple[float, float, float]:
        part = self._most * _BELOW
        return x / size * part, y / size * part, z / size * part

    def _count(self, kind: str) -> None:
        for counts in (self.counts, self._total):
            setattr(counts, kind, getattr(counts, kind) + 1)
        self._diary.count(kind, self._finger)
