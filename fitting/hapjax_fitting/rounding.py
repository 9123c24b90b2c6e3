"""Readings in steps that no noise blurs: samples that read the same err alike, and no residual shows it."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .observation import Observation, Samples
from .problem import Problem, pieces_of
from .sharding import gathered

_FINEST = 1e-6  # of the largest value: what is closer differs by how numbers are kept
_LEAST = 20.0  # times that: a smaller step is none
# Of the variance of rounding: where residuals have less, what was measured goes in steps itself.
_EXACT = 0.01
_SPARE = 2  # readings beyond the numbers fitted, without which that can not be seen


class Readings(NamedTuple):
    """Samples of an axis put together by what they read: `level` (k,), how many steps from 0; the sums of their pulls on
    each estimate, outwards from 0, and of the squares of these (k, p); from `low` to `high` (k,), how much farther out the
    model has them."""

    level: Int[np.ndarray, " k"]
    pulls: Float[np.ndarray, "k p"]
    squares: Float[np.ndarray, "k p"]
    low: Float[np.ndarray, " k"]
    high: Float[np.ndarray, " k"]

    def variance(self, step: float) -> Float[np.ndarray, " p"]:
        """What rounding adds to the variance of each estimate, beside what the residuals show.

        The errors of samples that read the same have a mean. Each is at most half a step, and the model says by how much
        they differ, w: so the mean lies within (step - w) / 2 of 0. Nothing tells more of it, as the fit has moved the
        model by it.
        """
        off = (self.low + self.high) / 2
        if len(off) > self.pulls.shape[1] + _SPARE and np.mean(off**2) < _EXACT * step**2 / 12:
            return np.zeros(self.pulls.shape[1])
        unknown = np.maximum(step - (self.high - self.low), 0) ** 2 / 12
        return unknown @ np.maximum(self.pulls**2 - self.squares, 0)


def readings_of(
    step: float,
    measured: Float[np.ndarray, " n"],
    residual: Float[np.ndarray, " n"],
    pull: Float[np.ndarray, "n p"],
) -> Readings:
    """One axis of one recording, by what it read. What rounds is taken to round alike on both sides of 0."""
    counts = pull.any(axis=1)
    side = np.where(measured < 0, -1.0, 1.0)
    share = sharpness(residual[counts] / step)
    outwards, off = (pull * (share * side)[:, None])[counts], (side * residual)[counts]
    level = np.rint(np.abs(measured[counts]) / step).astype(np.int64)
    return together([Readings(level, outwards, outwards**2, off, off)])


def together(parts: Sequence[Readings]) -> Readings:
    """Those of all parts, those of one level put together."""
    whole = [np.concatenate(column) for column in zip(*parts, strict=True)]
    order = np.argsort(whole[0], kind="stable")
    level, pulls, squares, low, high = (column[order] for column in whole)
    begins = np.flatnonzero(np.diff(level, prepend=-1))
    if not len(begins):
        return parts[0]
    return Readings(
        level[begins],
        np.add.reduceat(pulls, begins),
        np.add.reduceat(squares, begins),
        np.minimum.reduceat(low, begins),
        np.maximum.reduceat(high, begins),
    )


def sharpness(residual: Float[np.ndarray, " n"]) -> float:
    """How much of the mean error of rounding noise leaves, 1 without noise, from successive residuals in steps.

    Noise of s steps leaves exp(-2 pi^2 s^2) (Widrow and Kollar 2008, Quantization Noise: the first term of the Fourier
    series of the mean error). Its variance is half that of the change from one to the next, less a quarter of a squared
    step, the most that rounding has in it: of a value between two steps.
    """
    changes = np.diff(residual)
    noise = max(0.0, float(np.mean(changes**2)) / 2 - 1 / 4) if len(changes) else 0.0
    return float(np.exp(-2 * np.pi**2 * noise))


def step_of(values: Float[np.ndarray, " n"]) -> float:
    """The step of which all values are whole multiples apart, by Euclid's algorithm; 0: there is none."""
    found = np.unique(values)
    gaps, finest = np.diff(found), _FINEST * np.abs(found).max(initial=0)
    gaps = gaps[gaps > finest]
    if len(gaps) < 2:
        return 0.0
    step = gaps.min()
    while step > _LEAST * finest:
        whole = np.rint(gaps / step)
        rest = np.abs(gaps - step * whole)
        if rest.max() <= finest:
            return float(np.sum(gaps) / np.sum(whole))
        step = rest[rest > finest].min()
    return 0.0


def steps_in(problem: Problem, residuals: Float[np.ndarray, " n"]) -> dict[str, dict[int, float]]:
    """Of each channel those axes that were read in steps, over all recordings, and their steps, N or m."""
    values: dict[str, dict[int, list[np.ndarray]]] = {}
    for key, group, samples, _ in pieces_of(residuals, problem):
        if key != "angle":
            measured = measured_in(group, samples)
            taken = None if samples.taken is None else gathered(samples.taken)[: group.count]
            rows = [*measured] if taken is None else [m[:n] for m, n in zip(measured, taken, strict=True)]
            for axis in range(measured.shape[-1]):  # a recording may have fewer fingers than another
                axes = values.setdefault(key, {})
                axes.setdefault(axis, []).extend(row[:, axis] for row in rows)
    found = {
        key: {axis: step_of(np.concatenate(columns)) for axis, columns in axes.items()}
        for key, axes in values.items()
    }
    coarse = {key: {axis: step for axis, step in steps.items() if step} for key, steps in found.items()}
    return {key: steps for key, steps in coarse.items() if steps}


def measured_in(group: Observation, samples: Samples) -> Float[np.ndarray, "R N m"]:
    """What a group's samples say, as residuals stand; of poses the place."""
    value = gathered(samples.value)[: group.count, ..., :3]
    return value.reshape(*value.shape[:2], -1)
