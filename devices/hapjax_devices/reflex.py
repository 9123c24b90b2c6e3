"""The part of a hand's impedance that answers late: stretch reflexes."""

from collections import deque
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hapjax import InputError


@dataclass(frozen=True)
class Reflex:
    """Stiffness and damping that act on where the hand was `delay` seconds ago, beside the intrinsic ones of a `Hand`.

    Intrinsic and reflex parts side by side, the second late, are the form in which joints are identified: R. E.
    Kearney, R. B. Stein and L. Parameswaran, Identification of intrinsic and reflex contributions to human ankle
    stiffness dynamics, IEEE Transactions on Biomedical Engineering 44, 1997. Short loops of the arm take 25 to 60 ms.

    **Arguments:** `stiffness` in N/m and `damping` in N s/m, 0 or above; `delay` in s, one period of the operator or more.
    """

    stiffness: float
    damping: float = 0.0
    delay: float = 0.04

    def __post_init__(self):
        for name in ("stiffness", "damping"):
            value = getattr(self, name)
            if not 0 <= value < np.inf:
                raise InputError(f"{name} of the reflex is {value}; allowed: 0 or above")
        if not 0 < self.delay <= 10:
            raise InputError(f"delay of the reflex is {self.delay} s; allowed: above 0, at most 10")


class ReflexArc:
    """What a reflex pulls with, sample after sample of `period` seconds; nothing before its first delay is over."""

    def __init__(self, reflex: Reflex, period: float):
        late = reflex.delay / period
        if late < 1 - 1e-9:
            raise InputError(
                f"delay of the reflex is {reflex.delay} s; allowed: the period, {period} s, or more"
            )
        self._reflex = reflex
        # Of each sample's pull, how much of it is in the mean over the coming sample: straight lines in between.
        weights = np.zeros(int(late) + 3)
        for lag in (late, max(late - 1, 0.0)):
            whole = int(lag)
            weights[whole : whole + 2] += 0.5 * np.array([1 - (lag - whole), lag - whole])
        self._weights = weights
        self._pulls = deque([np.zeros(3)] * len(weights), maxlen=len(weights))

    def __call__(
        self, offset: Float[np.ndarray, "3"], velocity: Float[np.ndarray, "3"]
    ) -> Float[np.ndarray, "3"]:
        """The force (N) of the coming sample, from where the hand is (m) and moves (m/s) beside its goal now."""
        self._pulls.appendleft(-self._reflex.stiffness * offset - self._reflex.damping * velocity)
        return self._weights @ np.array(self._pulls)
