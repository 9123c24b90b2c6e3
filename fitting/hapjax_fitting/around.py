"""Places around where a search ended: the loss of what bounces is rough, and a descent ends in one of many hollows."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .parameters import size_at
from .problem import Problem, loss_at
from .solve import Solutions

_NEAREST, _FARTHEST = 3.0, 1000.0  # standard errors
_OFF = np.log(2)  # of how far off a number may well be: no place is farther
_PLACES = 16  # in each shell


def lowest_around(
    ends: Solutions, problem: Problem, variance: float, shells: int, seed: int
) -> tuple[Float[Array, "s p"], Float[np.ndarray, " s"]]:
    """Of so many shells around the best end the place with the least loss each, the least first, and these losses.

    A shell is an ellipsoid on which the linear model has one loss: at so many standard errors, for residuals of the
    `variance`, from 3 to 1000. How far the next hollow is nobody knows.
    """
    free, random = np.asarray(ends.free[ends.best], np.float64), np.random.default_rng(seed)
    _, values, right = np.linalg.svd(ends.slopes.astype(np.float64), full_matrices=False)
    error = np.sqrt(variance) / np.maximum(values, np.finfo(float).eps * max(values[0], 1.0))
    farthest = _OFF * np.array([size_at(p, float(x)) for p, x in zip(problem.parameters, free, strict=True)])
    places, losses = [], []
    for distance in np.geomspace(_NEAREST, _FARTHEST, shells):
        way = random.standard_normal((_PLACES, len(free)))
        way *= distance / np.linalg.norm(way, axis=1, keepdims=True)
        about = free + np.clip((error * way) @ right, -farthest, farthest)
        about = jnp.asarray(about, ends.free.dtype)
        met = np.array([float(loss_at(place, problem)) for place in about])
        lowest = int(np.argmin(np.where(np.isfinite(met), met, np.inf)))
        places.append(about[lowest])
        losses.append(met[lowest])
    order = np.argsort(losses)
    return jnp.stack(places)[order], np.array(losses)[order]
