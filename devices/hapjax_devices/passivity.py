"""Time-domain passivity control: damping where, and only where, the loop has given out energy.

B. Hannaford and J.-H. Ryu, Time-domain passivity control of haptic interfaces, IEEE Transactions on Robotics and
Automation 18, 2002.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Shaped

from hapjax import InputError


@dataclass(frozen=True)
class Passivity:
    """Asks the servo loop to keep each device passive.

    `delay`: by how many samples the devices' positions are late, 0 to 100: 1 for a `VirtualDevice`. `most_damping`:
    the largest damping that is added, N s/m, above 0. Beyond the moving mass over the loop's period a damper turns the
    finger round within a sample.
    """

    delay: int = 0
    most_damping: float = 20.0

    def __post_init__(self):
        if not isinstance(self.delay, int) or isinstance(self.delay, bool) or not 0 <= self.delay <= 100:
            raise InputError(f"delay of the passivity control is {self.delay!r}; allowed: 0 to 100 samples")
        if not 0 < self.most_damping < np.inf:
            raise InputError(
                f"most_damping of the passivity control is {self.most_damping} N s/m; allowed: above 0"
            )


class PassivityControl:
    """Watches the energy that goes into each device's loop, and damps the finger where it is below 0.

    With f the force that a device puts out and x the position that is read, d samples late, what the finger has
    put in is, exactly for a force that is held from sample to sample,

        E[n] = E[n-1] - f[n-1-d] . (x[n] - x[n-1])

    What the forces of the d samples that are not seen yet and of the one to come will add is foretold with the last
    velocity v = (x[n] - x[n-1]) / T. Where the sum is below 0, Hannaford and Ryu's damping is added that makes it 0:

        W = E[n] - T v . (f[n-d] + ... + f[n])       a = -W / (T |v|^2)       f[n] <- f[n] - a v

    with a at most `most_damping`. `Safety` then limits the force.

    **Arguments:** `period` T in s; `hip` (F, 3) m, where the fingers are.

    **Attributes:** `energy` (F,) J, E of the last call; `lowest` (F,) J, the lowest E so far; `damped`, how many forces
    were changed so far.
    """

    def __init__(self, settings: Passivity, period: float, hip: Shaped[np.ndarray, "F 3"]):
        self._settings, self._period = settings, period
        self._hip = np.array(hip, np.float64)
        self._held = np.zeros((settings.delay + 1, *self._hip.shape))  # N, put out lately, the oldest first
        self.energy = np.zeros(len(self._hip))
        self.lowest = np.zeros(len(self._hip))
        self.damped = 0

    def __call__(
        self, forces: Float[np.ndarray, "F 3"], hip: Shaped[np.ndarray, "F 3"]
    ) -> Float[np.ndarray, "F 3"]:
        """The forces (N) to put out with the fingers read at `hip` (m): `forces`, damped where it has to be."""
        moved = hip - self._hip
        self._hip[:] = hip
        self.energy -= np.sum(self._held[0] * moved, axis=1)
        np.minimum(self.lowest, self.energy, out=self.lowest)
        coming = np.sum(self._held[1:], axis=0) + forces
        short = np.sum(coming * moved, axis=1) - self.energy  # J that will be missing
        way = np.sum(moved**2, axis=1)
        lacking = (short > 0) & (way > 0)
        if not lacking.any():
            return forces
        self.damped += int(np.sum(lacking))
        damping = np.zeros(len(way))
        damping[lacking] = np.minimum(
            short[lacking] * self._period / way[lacking], self._settings.most_damping
        )
        return forces - damping[:, None] * moved / self._period

    def put_out(self, forces: Float[np.ndarray, "F 3"]) -> None:
        """Note the forces (N) that the devices really put out until the next call."""
        self._held[:-1] = self._held[1:]
        self._held[-1] = forces
