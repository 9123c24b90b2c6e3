"""The last look at every force before it goes to a device."""

import numpy as np
from jaxtyping import Float, Shaped

# A force scaled to the limit may come out over it by the rounding of three products and a root.
_BELOW = 1 - 8 * np.finfo(np.float64).eps


class ForceGuard:
    """Makes of any forces some that are finite and within the limits of their devices.

    A force with a component that is NaN or infinite becomes no force; one over its device's limit keeps its
    direction and gets the limit as its norm.

    **Arguments:** `limits` (F,) N, the largest norm for each finger.

    **Attributes:** `not_finite` and `limited`, how many forces were changed for either reason so far.
    """

    def __init__(self, limits: Float[np.ndarray, "F"]):
        self._limits = np.asarray(limits, np.float64)
        self.not_finite = 0
        self.limited = 0

    def __call__(self, forces: Shaped[np.ndarray, "F 3"]) -> Float[np.ndarray, "F 3"]:
        """The forces (N) that may go to the devices, as a new float64 array."""
        safe = np.array(forces, np.float64)
        finite = np.isfinite(safe).all(axis=1)
        if not finite.all():
            self.not_finite += int(np.sum(~finite))
            safe[~finite] = 0
        with np.errstate(
            over="ignore"
        ):  # the norm of the largest numbers is infinite: their limit is then no force
            size = np.hypot(np.hypot(safe[:, 0], safe[:, 1]), safe[:, 2])
        over = size > self._limits
        if over.any():
            self.limited += int(np.sum(over))
            unit = safe[over] / size[over, None]
            safe[over] = unit * (self._limits[over] * _BELOW)[:, None]
        return safe
