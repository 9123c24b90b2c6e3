"""The fit as one writes it by hand: NumPy, a loop over the samples, SciPy's least squares with its finite differences."""

import numpy as np
import scipy.optimize
from jaxtyping import Float

_NORMAL = np.array([0.0, 0.0, 1.0])


def forces(mu: float, stiffness: float, path: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "T 3"]:
    """The forces (N) of a floor at z = 0 on a finger: a god-object within its friction circle (MHS section 2)."""
    found = np.zeros_like(path)
    god, in_contact = path[0], False
    for i, point in enumerate(path):
        depth = -np.dot(point, _NORMAL)
        if depth <= 0:
            in_contact = False
            continue
        surface = point + depth * _NORMAL
        if not in_contact:
            god, in_contact = surface, True
        offset = god - surface
        offset = offset - np.dot(offset, _NORMAL) * _NORMAL
        length, radius = np.linalg.norm(offset), mu * depth
        if length > radius:
            offset = offset * (radius / length)
        god = surface + offset
        found[i] = stiffness * (depth * _NORMAL + offset)
    return found


def fit(
    path: Float[np.ndarray, "T 3"], force: Float[np.ndarray, "T 3"], noise: float, start: tuple[float, float]
) -> Float[np.ndarray, "2"]:
    """mu and stiffness (N/m) from fingertip positions (m) and forces (N)."""

    def residuals(x):
        return ((forces(x[0], x[1], path) - force) / noise).ravel()

    found = scipy.optimize.least_squares(residuals, start, x_scale=start, bounds=(0, np.inf))
    return found.x
