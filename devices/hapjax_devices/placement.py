"""Where a device stands in the world."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hapjax import InputError


@dataclass(frozen=True)
class Placement:
    """Where a device stands: what its driver calls its own frame, moved to `position` and turned by `orientation`.

    **Arguments:** `position` (3,) m, of the device's own origin in the world; `orientation`, a quaternion w x y z of any
    length above 0.

    **Raises:** `InputError` for numbers out of range.
    """

    position: Iterable[float | int] = (0.0, 0.0, 0.0)
    orientation: Iterable[float | int] = (1.0, 0.0, 0.0, 0.0)

    def __post_init__(self):
        position = np.array([*self.position], np.float64)
        if position.shape != (3,) or not np.isfinite(position).all():
            raise InputError(
                f"position of the device is {position.tolist()} m; allowed: three finite numbers"
            )
        object.__setattr__(self, "position", position)
        q = np.array([*self.orientation], np.float64)
        if q.shape != (4,) or not np.isfinite(q).all() or not q.any():
            raise InputError(
                f"orientation of the device is {q.tolist()}; allowed: a quaternion w x y z, not 0"
            )
        object.__setattr__(self, "orientation", q / np.linalg.norm(q))

    def rotation(self) -> Float[np.ndarray, "3 3"]:
        """The matrix that turns directions of the device's own frame into the world's."""
        w, x, y, z = np.asarray(self.orientation).tolist()
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        return np.eye(3) + 2 * w * cross + 2 * cross @ cross
