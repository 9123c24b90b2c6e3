"""How much less certain the data leave each number than white noise of one size a channel would."""

from collections.abc import Iterator, Mapping, Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .noise import correlation_time, lost
from .parameters import stems_of
from .problem import Problem, channels_of, pieces_of, residuals_at
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
    count, known, inverse = len(free), problem.known(), certain.inverse
    factors, steps = np.ones(count), np.sqrt(np.diag(certain.covariance))
    sizes = _STEP[np.dtype(free.dtype)] * steps
    changes = _changes(free, problem, residuals, sizes, np.eye(count) if back is None else back)
    rows = slopes[len(slopes) - known :]
    # Where a touch begins or slides a step earlier, a difference quotient is no derivative.
    square, found = (
        np.sum(slopes.astype(np.float64) ** 2, axis=0),
        np.sum(rows.astype(np.float64) ** 2, axis=0),
    )
    for _, _, own, quotients in _by_recording(residuals, changes, problem, sizes):
        found[own] += np.sum(quotients**2, axis=(0, 1))
    wrong = np.abs(found - square) > _ALIKE * square
    if wrong[steps > 0].any():
        return factors
    variance = problem.weighed * np.sum((rows @ inverse) ** 2, axis=0)
    pieces, taken = channels_of(residuals, problem), given or {}
    alike = {
        key: correlation_time([np.where(lost(r)[..., None], 0, r) for name, r in pieces if name == key])
        for key in {key for key, _ in pieces}
    }
    surplus = problem.measured() / (problem.measured() - problem.fitted())
    for key, r, own, quotients in _by_recording(residuals, changes, problem, sizes):
        pull = quotients @ inverse[own]
        if key in taken:
            variance += np.sum(pull**2, axis=(0, 1))
        else:
            variance += surplus * alike[key] * np.sum(np.einsum("nm,nmp->np", r, pull) ** 2, axis=0)
    seen = steps > 0
    factors[seen] = np.sqrt(np.maximum(1, variance[seen] / steps[seen] ** 2))
    return factors


def _changes(
    free: Float[Array, " p"],
    problem: Problem,
    residuals: Float[np.ndarray, " n"],
    sizes: Float[np.ndarray, " p"],
    directions: Float[np.ndarray, "p p"],
) -> list[Float[np.ndarray, " n"]]:
    """By how much a step of each reported number changes the residuals; those of one path of all recordings are moved at
    once, as each has an influence on its own recording alone."""
    found = []
    for stem in stems_of(problem.reported):
        along = directions[:, stem] @ sizes[stem]
        found.append(residuals_at(free + jnp.asarray(along, free.dtype), problem) - residuals)
    return found


def _by_recording(
    residuals: Float[np.ndarray, " n"],
    changes: Sequence[Float[np.ndarray, " n"]],
    problem: Problem,
    sizes: Float[np.ndarray, " p"],
) -> Iterator[tuple[str, np.ndarray, list[int], np.ndarray]]:
    """Of each channel of each recording: its name, the residuals (N, m), 0 where it was lost, which numbers it depends on,
    and the difference quotients by those (N, m, q)."""
    stems = stems_of(problem.reported)
    apart = (pieces_of(x, problem) for x in (residuals, *changes))
    for (key, group, _, here), *there in zip(*apart, strict=True):
        for row, place in enumerate(group.places.tolist()):
            own = [stem[place] if len(stem) > 1 else stem[0] for stem in stems]
            size = np.where(sizes[own] > 0, sizes[own], np.inf)
            quotients = np.stack([piece[row] for *_, piece in there], axis=-1) / size
            yield key, np.where(lost(here[row][None])[0][:, None], 0, here[row]), own, quotients
