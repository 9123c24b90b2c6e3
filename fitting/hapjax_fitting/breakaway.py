"""The static mu beside a kinetic one: the forces know it only by when a finger breaks away.

Before that it sticks whatever mu_static is, and after that it slides at mu_kinetic; so the residuals are constant
in mu_static but for jumps, where another step is the first to slide. Gradients are 0: it is searched by its loss, and its
likelihood itself, a staircase, says how well it is known.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .grip import largest_ratio, raised, value_near
from .parameters import find_leaf
from .problem import NOTICEABLE, Problem, loss_at
from .sharding import gathered

_LANES, _AT_ONCE = 50, 100_000  # rollouts side by side, and steps of them, to bound the memory
_TRIED, _CELLS, _DRAWS = 100, 50, 20
_UNLIKELY = 15.0  # values less likely than the best by exp(-15) count for nothing
_ZOOMS = 6
_SAME = 1e-3  # a difference of a loss that is none


@dataclass(frozen=True)
class Posterior:
    """How likely each value of a number is, with a flat prior: constant in cells between `edges` (n + 1), each of a
    `weight` (n,), which sum to 1."""

    edges: Float[np.ndarray, " m"]
    weight: Float[np.ndarray, " n"]

    def mean(self) -> float:
        """The value with the least mean square error."""
        return float(np.sum(self.weight * (self.edges[1:] + self.edges[:-1]) / 2))

    def deviation(self) -> float:
        """The standard deviation."""
        middle, width = (self.edges[1:] + self.edges[:-1]) / 2, np.diff(self.edges)
        return float(np.sqrt(np.sum(self.weight * ((middle - self.mean()) ** 2 + width**2 / 12))))

    def central(self, share: float) -> tuple[float, float]:
        """The interval that leaves half of the rest of the probability on either side."""
        below = np.concatenate([[0.0], np.cumsum(self.weight)])
        low, high = np.interp([(1 - share) / 2, (1 + share) / 2], below, self.edges)
        return float(low), float(high)


def is_static(problem: Problem, i: int) -> bool:
    """Whether a free number is the mu_static of a surface or contact."""
    return problem.parameters[i].path.endswith(".mu_static")


def broken_away(free: Float[Array, " p"], problem: Problem, variance: float) -> Float[Array, " p"] | None:
    """Free numbers with a mu_static that explains the data better, if there is one."""
    found, lowest = None, float(loss_at(free, problem)) - NOTICEABLE * variance / 2
    for i in filter(lambda i: is_static(problem, i), range(len(problem.parameters))):
        start = free if found is None else found
        low, high = _range(start, problem, i)
        for _ in range(2):  # the second time more finely, about the best of the first
            values = np.geomspace(low, high, _TRIED) if 0 < low < high else np.zeros(0)
            if not len(values):
                break
            losses = _losses(np.tile(start, (len(values), 1)), problem, i, values)
            best = int(np.argmin(losses))
            # The middle of all that are as good: at the edge the next step of another number would meet a jump.
            alike = np.flatnonzero(losses <= losses[best] + _SAME * variance)
            middle = alike[(len(alike) - 1) // 2] if np.ptp(alike) < len(alike) else best
            if losses[middle] < lowest:
                lowest, found = float(losses[middle]), _with(start, problem, i, float(values[middle]))
            low, high = float(values[max(best - 1, 0)]), float(values[min(alike[-1] + 1, _TRIED - 1)])
    return found


def posterior(
    free: Float[Array, " p"], problem: Problem, i: int, variance: float, covariance: Float[np.ndarray, "p p"]
) -> Posterior:
    """How likely each mu_static is; `variance`, that of the whitened residuals, `covariance`, that of the others.

    Where a jump of the likelihood is far above the noise, all values between two jumps are alike likely, and no other.
    Where the jumps are depends on the other numbers, which are not known either: it is the mean over draws of them,
    each as likely as the data make it.
    """
    low, high = _between(free, problem, i, 2 * _UNLIKELY * variance)
    least, most = _range(free, problem, i)
    others, surplus = _draws(free, i, covariance)
    for _ in range(_ZOOMS):
        edges = np.linspace(low, high, _CELLS + 1)
        middles = (edges[1:] + edges[:-1]) / 2
        losses = _losses(np.tile(others, (_CELLS, 1)), problem, i, np.repeat(middles, len(others)))
        logs = surplus - losses.reshape(_CELLS, len(others)) / variance
        weight = np.exp(logs - logs.max()).sum(axis=1)
        likely = np.flatnonzero(weight > np.exp(-_UNLIKELY) * weight.max())
        wide, first, last = high - low, edges[likely[0]], edges[likely[-1] + 1]
        low = max(least, low - wide / 2) if likely[0] == 0 else first
        high = min(most, high + wide / 2) if likely[-1] == _CELLS - 1 else last
        if low >= edges[0] and high <= edges[-1] and 2 * (high - low) > wide:
            break
    return Posterior(edges, weight / weight.sum())


def _draws(free: Float[Array, " p"], i: int, covariance: Float[np.ndarray, "p p"]):
    """Likely values of the other numbers, half of them opposite the other half; and by how much more often the data
    want each than it is drawn, as a logarithm, but for the loss."""
    spread = np.array(covariance)
    spread[i], spread[:, i] = 0, 0
    size, direction = np.linalg.eigh(spread)
    count = max(_DRAWS // 2, len(free))
    # Made orthogonal: the draws have exactly the spread that is asked for, in every direction.
    normal, _ = np.linalg.qr(np.random.default_rng(0).standard_normal((count, len(free))))
    normal *= np.sqrt(count)
    normal = np.concatenate([normal, -normal]) * (size > 0)
    moved = (normal * np.sqrt(np.maximum(size, 0))) @ direction.T
    return np.asarray(free)[None] + moved, 0.5 * np.sum(normal**2, axis=1)


def _between(free: Float[Array, " p"], problem: Problem, i: int, allowed: float) -> tuple[float, float]:
    """The lowest and highest mu_static at which twice the loss is at most `allowed` above that of `free`."""
    loss = _loss_of(free, problem, i)
    most = float(loss_at(free, problem)) + allowed / 2
    value = float(problem.parameters[i].transform.value(free[i]))
    low, high = _range(free, problem, i)
    return _edge(loss, most, value, min(low, value)), _edge(loss, most, value, max(high, value))


def _edge(loss: Callable[[float], float], most: float, inside: float, outside: float) -> float:
    """Where the loss passes `most` on the way from `inside` to `outside`, by bisection."""
    if loss(outside) <= most:
        return outside
    for _ in range(30):
        middle = (inside + outside) / 2
        inside, outside = (middle, outside) if loss(middle) <= most else (inside, middle)
    return outside


def _range(free: Float[Array, " p"], problem: Problem, i: int) -> tuple[float, float]:
    """From the kinetic mu, below which it cannot be, to where nothing breaks away."""
    parameter = problem.parameters[i]
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
    return gathered(_losses_at(points, problem, lanes)).astype(np.float64)


@partial(jax.jit, static_argnums=2)
def _losses_at(points: Float[Array, "n p"], problem: Problem, lanes: int) -> Float[Array, " n"]:
    return jax.lax.map(lambda free: loss_at(free, problem), points, batch_size=lanes)


def _with(free: Float[Array, " p"], problem: Problem, i: int, value: float) -> Float[Array, " p"]:
    return free.at[i].set(value_near(problem.parameters[i], value, free))
