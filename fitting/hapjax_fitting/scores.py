"""How much less certain the data leave each number than white noise of one size a channel would."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .noise import correlation_time, lost
from .parameters import stems_of
from .problem import Problem, channels_of, pieces_of, residuals_at
from .robust import curvature, slope, unrooted
from .rounding import measured_in, readings_of, together
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
    coarse: Mapping[str, Mapping[int, float]],
) -> Float[np.ndarray, " p"]:
    """By how many times the standard errors of a Gauss-Newton covariance are too small; at least 1.

    It takes a channel's residuals for noise of one size. Noise may differ by axis, grow with the force, or
    be there just where a number shows. So each sample's pull on each estimate is looked at, (J'J)^-1 J_t' r_t, and the
    variance of their sum, times the residuals' `correlation_time` (White 1980, A heteroskedasticity-consistent covariance
    matrix estimator). Noise that was given is believed, and priors are. Of a robust loss a sample's pull is psi of its
    residual, over what psi' leaves of J'J (Huber 1981, section 7.6). Where values were read in steps, what rounding errs by
    alike is added: the residuals do not show it, and no size of noise that is given has it.

    **Arguments:** `slopes`, the Jacobian by the reported numbers, in few rows, those of priors last; `back`, the derivative
    of the free numbers by the reported ones; `coarse`, the `steps_in` the values.
    """
    count, known, inverse = len(free), problem.known(), certain.inverse
    factors, steps = np.ones(count), np.sqrt(np.diag(certain.covariance))
    sizes = _STEP[np.dtype(free.dtype)] * steps
    residuals = _of_data(residuals, problem)
    changes = _changes(free, problem, residuals, sizes, np.eye(count) if back is None else back)
    rows = slopes[len(slopes) - known :]
    # Where a touch begins or slides a step earlier, a difference quotient is no derivative.
    square, found = (
        np.sum(slopes.astype(np.float64) ** 2, axis=0),
        np.sum(rows.astype(np.float64) ** 2, axis=0),
    )
    for _, _, own, quotients, _ in _by_recording(residuals, changes, problem, sizes):
        found[own] += np.sum(quotients**2, axis=(0, 1))
    wrong = np.abs(found - square) > _ALIKE * square
    if wrong[steps > 0].any():
        return factors
    if problem.loss != "squares":
        inverse = _bent(residuals, changes, problem, sizes, rows, inverse)
    variance = problem.weighed * np.sum((rows @ inverse) ** 2, axis=0)
    alike, taken = _alike(residuals, problem), given or {}
    surplus = problem.measured() / (problem.measured() - problem.fitted())
    read = {}
    for key, r, own, quotients, measured in _by_recording(residuals, changes, problem, sizes):
        pull = quotients @ inverse[own]
        psi = slope(r, problem.loss)
        if key in taken:
            variance += np.sum(pull**2, axis=(0, 1)) * (1.0 if problem.loss == "squares" else np.mean(psi**2))
        else:
            variance += surplus * alike[key] * np.sum(np.einsum("nm,nmp->np", psi, pull) ** 2, axis=0)
        here = {axis: step for axis, step in coarse.get(key, {}).items() if axis < r.shape[1]}
        for axis, step in here.items():
            in_units = measured[:, axis], r[:, axis] * float(getattr(problem.noise, key))
            read.setdefault((key, axis), []).append(readings_of(step, *in_units, pull[:, axis]))
    for (key, axis), parts in read.items():
        variance += together(parts).variance(coarse[key][axis]) / float(getattr(problem.noise, key)) ** 2
    seen = steps > 0
    factors[seen] = np.sqrt(np.maximum(1, variance[seen] / steps[seen] ** 2))
    return factors


def _alike(residuals: Float[np.ndarray, " n"], problem: Problem) -> dict[str, float]:
    """Of each channel over how many samples pulls err alike."""
    parts: dict[str, list[np.ndarray]] = {}
    for key, r in channels_of(residuals, replace(problem, loss="squares")):
        parts.setdefault(key, []).append(slope(np.where(lost(r)[..., None], 0, r), problem.loss))
    return {key: correlation_time(series) for key, series in parts.items()}


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
        found.append(
            _of_data(residuals_at(free + jnp.asarray(along, free.dtype), problem), problem) - residuals
        )
    return found


def _of_data(stacked: Float[np.ndarray, " n"], problem: Problem) -> Float[np.ndarray, " m"]:
    """The residuals themselves, without those of priors."""
    return unrooted(stacked[: len(stacked) - problem.known()], problem.loss)


def _bent(
    residuals: Float[np.ndarray, " n"],
    changes: Sequence[Float[np.ndarray, " n"]],
    problem: Problem,
    sizes: Float[np.ndarray, " p"],
    rows: Float[np.ndarray, "k p"],
    inverse: Float[np.ndarray, "p p"],
) -> Float[np.ndarray, "p p"]:
    """The inverse of a robust loss's own curvature, J' psi' J, where (J'J)^-1 is its like of squares."""
    matrix = rows.astype(np.float64).T @ rows
    for _, r, own, quotients, _ in _by_recording(residuals, changes, problem, sizes):
        bend = curvature(r, problem.loss)
        matrix[np.ix_(own, own)] += np.einsum("nmp,nm,nmq->pq", quotients, bend, quotients, optimize=True)
    size = np.sqrt(np.diag(inverse))
    scale = np.outer(size, size)  # 0 for numbers that nothing shows
    return scale * np.linalg.pinv(scale * matrix, rcond=1e-12, hermitian=True)


def _by_recording(
    residuals: Float[np.ndarray, " n"],
    changes: Sequence[Float[np.ndarray, " n"]],
    problem: Problem,
    sizes: Float[np.ndarray, " p"],
) -> Iterator[tuple[str, np.ndarray, list[int], np.ndarray, np.ndarray]]:
    """Of each channel of each recording: its name, the residuals (N, m), 0 where it was lost, which numbers it depends on,
    the difference quotients by those (N, m, q), and what was measured."""
    stems = stems_of(problem.reported)
    apart = (pieces_of(x, problem) for x in (residuals, *changes))
    for (key, group, samples, here), *there in zip(*apart, strict=True):
        measured = measured_in(group, samples)
        for row, place in enumerate(group.places.tolist()):
            own = [stem[place] if len(stem) > 1 else stem[0] for stem in stems]
            size = np.where(sizes[own] > 0, sizes[own], np.inf)
            quotients = np.stack([piece[row] for *_, piece in there], axis=-1) / size
            yield (
                key,
                np.where(lost(here[row][None])[0][:, None], 0, here[row]),
                own,
                quotients,
                measured[row],
            )
