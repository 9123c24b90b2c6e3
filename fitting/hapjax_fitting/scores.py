"""How much less certain the data leave each number than white noise of one size a channel would."""

from collections.abc import Mapping

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .noise import correlation_time, lost
from .problem import Problem, channels_of, residuals_at
from .uncertainty import Certainty

_STEP = {np.dtype("float64"): 1e-4, np.dtype("float32"): 0.1}  # standard errors
_ALIKE = 0.1  # by how much a column's square may differ between difference quotients and derivatives


def widened(
    free: Float[Array, " p"],
    problem: Problem,
    residuals: Float[np.ndarray, " n"],
    slopes: Float[np.ndarray, "m p"],
    back: Float[np.ndarray, "p p"] | None,
    certain: Certainty,
    given: Mapping[str, float] | None,
) -> Float[np.ndarray, " p"]:
    """By how many times the standard errors of a Gauss-Newton covariance are too small; at least 1.

    It takes a channel's residuals for noise of one size. Noise may differ by axis, grow with the force, or
    be there just where a number shows. So each sample's pull on each estimate is looked at, (J'J)^-1 J_t' r_t, and the
    variance of their sum, times the residuals' `correlation_time` (White 1980, A heteroskedasticity-consistent covariance
    matrix estimator). Noise that was given is believed, and priors are.

    **Arguments:** `slopes`, the Jacobian by the reported numbers, in few rows, those of priors last; `back`, the derivative
    of the free numbers by the reported ones.
    """
    count, known, here = len(free), problem.known(), residuals
    factors, steps, inverse = np.ones(count), np.sqrt(np.diag(certain.covariance)), certain.inverse
    seen = np.flatnonzero(steps > 0)
    columns = np.zeros((len(here) - known, count))
    for i in seen.tolist():
        step = _STEP[np.dtype(free.dtype)] * steps[i]
        along = step * (np.eye(count)[i] if back is None else back[:, i])
        there = residuals_at(free + jnp.asarray(along, free.dtype), problem)
        columns[:, i] = ((there - here) / step)[: len(here) - known]
    rows = slopes[len(slopes) - known :]
    # Where a touch begins or slides a step earlier, a difference quotient is no derivative.
    square = np.sum(slopes.astype(np.float64) ** 2, axis=0)
    wrong = np.abs(np.sum(columns**2, axis=0) + np.sum(rows**2, axis=0) - square) > _ALIKE * square
    if wrong[seen].any():
        return factors
    variance = problem.weighed * np.sum((rows @ inverse) ** 2, axis=0)
    pulls, taken = columns @ inverse, given or {}
    pieces = [(key, np.where(lost(r)[..., None], 0, r)) for key, r in channels_of(here, problem)]
    alike = {key: correlation_time([r for k, r in pieces if k == key]) for key, _ in pieces}
    surplus = problem.measured() / (problem.measured() - problem.fitted())
    for i in seen.tolist():
        for (key, r), (_, pull) in zip(pieces, channels_of(pulls[:, i], problem), strict=True):
            at_each = np.sum(pull**2) if key in taken else np.sum(np.sum(r * pull, axis=2) ** 2)
            variance[i] += at_each * (1 if key in taken else surplus * alike[key])
    factors[seen] = np.sqrt(np.maximum(1, variance[seen] / steps[seen] ** 2))
    return factors
