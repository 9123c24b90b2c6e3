"""Physiological tremor: what pushes a hand to and fro that wants to be still."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from hapjax import InputError

LINES = 24  # in the band, an axis: they come back together after minutes only


@dataclass(frozen=True)
class Tremor:
    """A random force on the hand between two frequencies, the same at a time t however long a run is.

    On each axis a sum of sines of one size, each at a random place of its own part of the band and with a random phase.
    Hands at rest in the air tremble most at 6 to 12 Hz (M. Lakie and others, Journal of Physiology 593, 2015), with peaks
    of 0.0015 to 0.035 g (P. Wade, M. A. Gresty and L. J. Findley, Archives of Neurology 39, 1982): 2 to 50 mN of 0.15 kg.

    **Arguments:** `amplitude` in N, the root mean square on each axis; `low` and `high` in Hz; `seed`, another for each
    finger that is to tremble by itself.
    """

    amplitude: float = 0.02
    low: float = 8.0
    high: float = 12.0
    seed: int = 0

    def __post_init__(self):
        if not 0 <= self.amplitude < np.inf:
            raise InputError(f"amplitude of the tremor is {self.amplitude} N; allowed: 0 or above")
        if not 0 < self.low < self.high < np.inf:
            raise InputError(
                f"low and high of the tremor are {self.low} and {self.high} Hz; allowed: above 0, low below high"
            )
        if self.seed < 0:
            raise InputError(f"seed of the tremor is {self.seed}; allowed: 0 or above")

    def force(self, t: float) -> Float[np.ndarray, "3"]:
        """The force (N) at `t` seconds."""
        rates, phases = self._lines
        return self.amplitude * np.sqrt(2 / LINES) * np.sum(np.sin(rates * t + phases), axis=1)

    @cached_property
    def _lines(self) -> tuple[np.ndarray, np.ndarray]:
        random = np.random.default_rng(self.seed)
        part = (np.arange(LINES) + random.random((3, LINES))) / LINES
        return 2 * np.pi * (self.low + (self.high - self.low) * part), 2 * np.pi * random.random((3, LINES))
