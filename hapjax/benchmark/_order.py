"""What errors over dt and over run time say: the order of convergence, and who is ahead at equal run time."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

DECADES, LEAST = 1.5, 4  # the finest decades of dt that a fit takes, and the least number of points
AGREE = 0.1  # by how much orders from step to step differ at most, where errors go like one power of dt
STEEPEST = 6.0  # no rule here is of an order above 4: where errors grow faster with dt, a run is unstable
ROUNDING = 10 * np.finfo(float).eps  # of a step, in units of what is compared


def fitted_order(
    dts: Iterable[float],
    errors: Iterable[float | None],
    seconds: float,
    floor: float,
    gain: float = 1.0,
    scatters: bool = True,
) -> float | None:
    """The slope of log error over log dt in the finest 1.5 decades in which errors stand above noise, and runs are stable.

    The noise is `floor`, to which the truth is known, or the rounding of as many steps, times the `gain` with which it grows
    by the end. Where chance does not make errors `scatter`, only so many of the finest steps count that the orders from each
    to the next AGREE: coarser ones do not yet go like a power of dt. `None`: fewer than four points.
    """
    kept = sorted(
        (dt, e)
        for dt, e in zip(dts, errors, strict=True)
        if e is not None and np.isfinite(e) and e > 3 * max(floor, gain * ROUNDING * seconds / dt)
    )
    if len(kept) < LEAST:
        return None
    fit = np.log10(kept)
    fit = fit[fit[:, 0] <= fit[0, 0] + DECADES + 0.005]
    jumps = np.flatnonzero(np.diff(fit[:, 1]) > STEEPEST * np.diff(fit[:, 0]))
    fit = fit[: jumps[0] + 1] if len(jumps) else fit
    if not scatters:
        each = np.diff(fit[:, 1]) / np.diff(fit[:, 0])
        spread = np.maximum.accumulate(each) - np.minimum.accumulate(each)
        fit = fit[: 1 + np.count_nonzero(spread <= AGREE)]
    return float(np.polyfit(fit[:, 0], fit[:, 1], 1)[0]) if len(fit) >= LEAST else None


def best_within(
    curves: Mapping[str, Sequence[Any]], run: float, floor: float
) -> tuple[float, str, float] | None:
    """The least law error among all points that take at most `run` s a simulated second: error, curve, dt."""
    found = [
        (max(p.law_error, floor), name, p.dt)
        for name, points in curves.items()
        for p in points
        if p.run <= run and np.isfinite(p.law_error)
    ]
    return min(found, default=None)


def equal_time(
    ours: Mapping[str, Sequence[Any]], theirs: Mapping[str, Sequence[Any]], floor: float
) -> list[dict[str, Any]]:
    """Who errs how much at the run times that both sides have, a third of a decade apart.

    Both sides at their best: any integrator, any dt that takes no longer. A `factor` up to 1: the first side is at or
    below the other.
    """
    runs = [[p.run for points in side.values() for p in points] for side in (ours, theirs)]
    if not all(runs):
        return []
    first, last = max(map(min, runs)), min(map(max, runs))
    rows = []
    for run in first * 10 ** (np.arange(np.floor(3 * np.log10(max(last / first, 1))) + 1) / 3):
        left, right = best_within(ours, run, floor), best_within(theirs, run, floor)
        if left is None or right is None:
            continue
        rows.append(
            {
                "run": float(run),
                "factor": left[0] / right[0],
                "hapjax": {"error": left[0], "integrator": left[1], "dt": left[2]},
                "mujoco": {"error": right[0], "integrator": right[1], "dt": right[2]},
            }
        )
    return rows
