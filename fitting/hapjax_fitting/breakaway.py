"""Numbers that gradients do not see: those that say from where on something gives way, and nothing else.

The static mu beside a kinetic one shows only in when a finger breaks away: before that it sticks whatever mu_static is, and
after that it slides at mu_kinetic. A dead band shows only in which torques turn nothing, Karnopp's velocity band only in
which slips are slow enough to hold. So the residuals are constant in such a number but for jumps, where another step is the
first to give way. Gradients are 0: it is searched by its loss, and its likelihood itself, a staircase, says how well it is
known. Where its jumps are depends on the other numbers, whose gradients do not see them: a search of those may stop at a
jump, and all are then searched together.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.special import ndtri
from scipy.stats import qmc

from .grip import largest_ratio, raised, value_near
from .parameters import find_leaf
from .problem import NOTICEABLE, Problem, loss_at
from .sharding import gathered
from .solve import Solutions
from .uncertainty import certainty

_LANES, _AT_ONCE = 50, 100_000  # rollouts side by side, and steps of them, to bound the memory
_TRIED = 100  # values, for the same other numbers
_BANDS, _FAR_OFF = ("dead_band", "velocity_band"), 1e6  # up to which factor their ranges are looked for
_CHI95 = 3.841459  # of chi-squared with one degree of freedom
_TOGETHER, _FARTHER = 512, 2.0  # points, and how many times farther off than is likely
_CELLS, _MARGIN = 1024, 20  # of a staircase, and how many at an end are to be unlikely
_BEYOND, _WIDER = 0.1, 12  # a share of the width on either side, and how many times it may grow threefold
_UNLIKELY = 15.0  # values less likely than the best by exp(-15) count for nothing
_SAME = 1e-3  # a difference of a loss that is none


@dataclass(frozen=True)
class Posterior:
    """How likely each value of a number is, with a flat prior: constant in cells between `edges` (n + 1), each of a
    `weight` (n,), which sum to 1. `cut`: its range ends at the lowest edge, and it may as well be there."""

    edges: Float[np.ndarray, " m"]
    weight: Float[np.ndarray, " n"]
    cut: bool = False

    def mean(self) -> float:
        """The value with the least mean square error."""
        return float(np.sum(self.weight * (self.edges[1:] + self.edges[:-1]) / 2))

    def deviation(self) -> float:
        """The standard deviation."""
        middle, width = (self.edges[1:] + self.edges[:-1]) / 2, np.diff(self.edges)
        return float(np.sqrt(np.sum(self.weight * ((middle - self.mean()) ** 2 + width**2 / 12))))

    def central(self, share: float) -> tuple[float, float]:
        """The interval that leaves half of the rest of the probability on either side; all of it above, where it is cut."""
        below = np.concatenate([[0.0], np.cumsum(self.weight)])
        shares = (0.0, share) if self.cut else ((1 - share) / 2, (1 + share) / 2)
        low, high = np.interp(shares, below, self.edges)
        return float(low), float(high)


def is_unseen(problem: Problem, i: int) -> bool:
    """Whether a free number is one that gradients do not see."""
    return _leaf(problem, i) in ("mu_static", *_BANDS)


def _leaf(problem: Problem, i: int) -> str:
    return problem.parameters[i].path.rsplit(".", 1)[-1]


def broken_away(ends: Solutions, problem: Problem, variance: float) -> Float[Array, " p"] | None:
    """Free numbers that explain the data better with another value of one that gradients do not see, if there are any.

    Or, where the search of the others stopped at a jump, those from which it may go on.
    """
    free, found, covariance = ends.free[ends.best], None, _covariance(ends)
    lowest = float(ends.loss[ends.best]) - NOTICEABLE * variance / 2
    for i in filter(lambda i: is_unseen(problem, i), range(len(problem.parameters))):
        low, high = _range(free, problem, i)
        if not 0 < low < high:
            continue
        scanned = _scanned(free, problem, i, variance, low, high)
        if scanned.loss < lowest or scanned.at_a_jump:
            free, lowest = scanned.free, min(scanned.loss, lowest)
            found = free
        others, _ = _draws(scanned.free, i, _FARTHER**2 * variance * covariance, _TOGETHER)
        values = np.linspace(scanned.low, scanned.high, _TOGETHER)
        losses = _losses(others, problem, i, values)
        best = int(np.argmin(losses))
        if losses[best] < lowest:
            free = _with(jnp.asarray(others[best], free.dtype), problem, i, float(values[best]))
            found, lowest = free, float(losses[best])
    return found


def _covariance(ends: Solutions) -> Float[np.ndarray, "p p"]:
    """Of the free numbers at the best end, for residuals of variance 1."""
    matrix = ends.slopes.astype(np.float64)
    rows, count = matrix.shape
    return certainty(matrix, np.ones(rows), np.full(count, np.inf), np.ones(count, bool)).covariance


@dataclass(frozen=True)
class _Scan:
    """The free numbers with the best value of one for these others, in the middle of all that are as good: at the edge the
    next step of another number would meet a jump.

    Their `loss`; between which values, `low` and `high`, others may be better together with other numbers; and whether
    the value before was `at_a_jump`.
    """

    free: Float[Array, " p"]
    loss: float
    low: float
    high: float
    at_a_jump: bool


def _scanned(
    free: Float[Array, " p"], problem: Problem, i: int, variance: float, low: float, high: float
) -> _Scan:
    """Look at values of number `i` from `low` to `high`, and then more finely about the best."""
    least, most = low, high
    for _ in range(2):
        values = np.geomspace(low, high, _TRIED)
        losses = _losses(np.tile(free, (_TRIED, 1)), problem, i, values)
        best = int(np.argmin(losses))
        alike = np.flatnonzero(losses <= losses[best] + _SAME * variance)
        middle = int(alike[(len(alike) - 1) // 2]) if np.ptp(alike) < len(alike) else best
        low, high = float(values[max(best - 1, 0)]), float(values[min(alike[-1] + 1, _TRIED - 1)])
    first, last = values[max(alike[0] - 1, 0)], values[min(alike[-1] + 1, _TRIED - 1)]
    inside = values[min(alike[0] + 1, alike[-1])], values[max(alike[-1] - 1, alike[0])]
    value = float(problem.parameters[i].transform.value(free[i]))
    return _Scan(
        _with(free, problem, i, float(values[middle])),
        float(losses[middle]),
        max(least, float(first - (last - first) / 2)),
        min(most, float(last + (last - first) / 2)),
        bool(first <= value < inside[0] or inside[1] < value <= last),
    )


def posterior(
    free: Float[Array, " p"], problem: Problem, i: int, variance: float, covariance: Float[np.ndarray, "p p"]
) -> Posterior:
    """How likely each value of a number is; `variance`, that of the whitened residuals, `covariance`, that of the others.

    Where a jump of the likelihood is far above the noise, all values between two jumps are alike likely, and no other.
    Where the jumps are depends on the other numbers, which are not known either: each cell is tried with other ones,
    as likely as the data make them.
    """
    low, high = _between(free, problem, i, 2 * _UNLIKELY * variance)
    least, most = _range(free, problem, i)
    others, surplus = _draws(free, i, covariance, _CELLS)

    def weighed(low: float, high: float, beyond: float):
        low, high = max(least, low - beyond * (high - low)), min(most, high + beyond * (high - low))
        edges = np.linspace(low, high, _CELLS + 1)
        logs = surplus - _losses(others, problem, i, (edges[1:] + edges[:-1]) / 2) / variance
        likely = np.flatnonzero(logs > logs.max() - _UNLIKELY)
        return edges, np.exp(logs - logs.max()), likely[0], likely[-1] + 1

    edges, weight, first, last = weighed(low, high, _BEYOND)
    for _ in range(_WIDER):
        is_cut = first < _MARGIN and edges[0] > least, last > _CELLS - _MARGIN and edges[-1] < most
        if not any(is_cut):
            break
        edges, weight, first, last = weighed(float(edges[first]), float(edges[last]), 1.0)
    if 2 * (last - first) < _CELLS:
        edges, weight, _, _ = weighed(float(edges[first]), float(edges[last]), _BEYOND)
    smooth = np.convolve(weight, np.ones(_MARGIN), "valid")
    may_be_least = edges[0] <= least and smooth[0] > np.exp(-_CHI95 / 2) * smooth.max()
    return Posterior(edges, weight / weight.sum(), bool(may_be_least) and _leaf(problem, i) == "mu_static")


def _draws(free: Float[Array, " p"], i: int, covariance: Float[np.ndarray, "p p"], count: int):
    """Likely values of the other numbers, evenly spread (Sobol' 1967, On the distribution of points in a cube), for
    as many values of number `i` in a row; and by how much more often the data want each than it is drawn, as a
    logarithm, but for the loss. `count`: a power of 2."""
    spread = np.array(covariance)
    spread[i], spread[:, i] = 0, 0
    size, direction = np.linalg.eigh(spread)
    even = qmc.Sobol(len(free), scramble=False).random(count) + 0.5 / count
    normal = ndtri(even) * (size > 0)
    moved = (normal * np.sqrt(np.maximum(size, 0))) @ direction.T
    return np.asarray(free)[None] + moved, 0.5 * np.sum(normal**2, axis=1)


def _between(free: Float[Array, " p"], problem: Problem, i: int, allowed: float) -> tuple[float, float]:
    """The lowest and highest value at which twice the loss is at most `allowed` above that of `free`."""
    loss = _loss_of(free, problem, i)
    most = float(loss_at(free, problem)) + allowed / 2
    value = float(problem.parameters[i].transform.value(free[i]))
    low, high = _range(free, problem, i)
    return _edge(loss, most, value, min(low, value)), _edge(loss, most, value, max(high, value))


def open_ends(
    free: Float[Array, " p"], problem: Problem, i: int, variance: float
) -> tuple[float | None, float | None] | None:
    """What is known of a band that explains the data as well at an end of its range, where it has no part in anything: up
    to where, or from where on, it does (95 %); `None` at an open end. `None` of a band with no such end."""
    if _leaf(problem, i) not in _BANDS:
        return None
    low, high = _range(free, problem, i)
    if low == high:
        return None, None
    loss, least = _loss_of(free, problem, i), float(loss_at(free, problem))
    as_well = [2 * (loss(end) - least) <= NOTICEABLE * variance for end in (low, high)]
    if not any(as_well):
        return None
    lower, upper = _between(free, problem, i, _CHI95 * variance)
    return None if as_well[0] else lower, None if as_well[1] else upper


def _edge(loss: Callable[[float], float], most: float, inside: float, outside: float) -> float:
    """Where the loss passes `most` on the way from `inside` to `outside`, by bisection."""
    if loss(outside) <= most:
        return outside
    for _ in range(30):
        middle = (inside + outside) / 2
        inside, outside = (middle, outside) if loss(middle) <= most else (inside, middle)
    return outside


def _range(free: Float[Array, " p"], problem: Problem, i: int) -> tuple[float, float]:
    """Between which values the loss may change.

    Of a mu_static from the kinetic mu, below which it cannot be, to where nothing breaks away. Of a band as it does: below,
    all gives way, and above, nothing; the ends are equal where there is no difference.
    """
    parameter = problem.parameters[i]
    if _leaf(problem, i) in _BANDS:
        value = float(parameter.transform.value(free[i]))
        values = np.geomspace(value / _FAR_OFF, value * _FAR_OFF, _TRIED)
        losses = _losses(np.tile(free, (_TRIED, 1)), problem, i, values)
        above, below = (np.flatnonzero(~np.isclose(losses, losses[end], rtol=1e-6)) for end in (0, -1))
        if not len(above) or not len(below):
            return value, value
        return float(values[above[0] - 1]), float(values[below[-1] + 1])
    kinetic = find_leaf(
        problem.scene_at(free, parameter.place or 0), parameter.path.removesuffix("mu_static") + "mu_kinetic"
    )
    low = float(kinetic if parameter.index is None else kinetic[parameter.index])
    return low, 1.02 * largest_ratio(raised(free, parameter, i), problem, parameter)


def _loss_of(free: Float[Array, " p"], problem: Problem, i: int) -> Callable[[float], float]:
    return lambda value: float(loss_at(_with(free, problem, i, value), problem))


def _losses(
    free: Float[Any, "n p"], problem: Problem, i: int, values: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """The loss at each of several points, with these values of one number."""
    points = jnp.asarray(free).at[:, i].set(value_near(problem.parameters[i], values, free))
    steps = sum(group.hips.shape[0] * group.hips.shape[1] for group in problem.groups)
    lanes = max(1, min(_LANES, _AT_ONCE // steps))
    whole = jnp.pad(points, ((0, -len(points) % lanes), (0, 0)), mode="edge").reshape(-1, lanes, len(free[0]))
    losses = [gathered(_losses_at(some, problem)) for some in whole]  # one program, however many points
    return np.concatenate(losses)[: len(points)].astype(np.float64)


@jax.jit
def _losses_at(points: Float[Array, "n p"], problem: Problem) -> Float[Array, " n"]:
    return jax.vmap(lambda free: loss_at(free, problem))(points)


def _with(free: Float[Array, " p"], problem: Problem, i: int, value: float) -> Float[Array, " p"]:
    return free.at[i].set(value_near(problem.parameters[i], value, free))
