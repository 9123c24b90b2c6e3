"""The static mu beside a kinetic one: the forces know it only by when a finger breaks away.

Before that it sticks whatever mu_static is, and after that it slides at mu_kinetic; so the residuals are constant
in mu_static but for jumps, where another step is the first to slide. Gradients are 0: it is searched by its loss, and its
likelihood itself, a staircase, says how well it is known.
"""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .grip import largest_ratio, raised, value_near
from .parameters import find_leaf
from .problem import NOTICEABLE, Problem, loss_at

_LANES = 10  # rollouts side by side, to bound the memory
_CELLS = 100
_UNLIKELY = 15.0  # values less likely than the best by exp(-15) count for nothing
_NARROWINGS = 3


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
            values = np.geomspace(low, high, _CELLS) if 0 < low < high else np.zeros(0)
            if not len(values):
                break
            losses = _losses(start, problem, i, values)
            best = int(np.argmin(losses))
            if losses[best] < lowest:
                lowest, found = float(losses[best]), _with(start, problem, i, float(values[best]))
            low, high = float(values[max(best - 1, 0)]), float(values[min(best + 1, _CELLS - 1)])
    return found


def posterior(free: Float[Array, " p"], problem: Problem, i: int, variance: float) -> Posterior:
    """How likely each mu_static is, all else as in `free`; `variance`, that of the whitened residuals.

    Where a jump of the likelihood is far above the noise, all values between two jumps are alike likely, and no other.
    """
    low, high = _between(free, problem, i, 2 * _UNLIKELY * variance)
    for _ in range(_NARROWINGS):
        edges = np.linspace(low, high, _CELLS + 1)
        losses = _losses(free, problem, i, (edges[1:] + edges[:-1]) / 2)
        weight = np.exp((losses.min() - losses) / variance)
        likely = np.flatnonzero(weight > np.exp(-_UNLIKELY))
        low, high = float(edges[likely[0]]), float(edges[likely[-1] + 1])
        if 2 * (high - low) > edges[-1] - edges[0]:
            break
    return Posterior(edges, weight / weight.sum())


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
    kinetic = find_leaf(problem.scene_at(free), parameter.path.removesuffix("mu_static") + "mu_kinetic")
    low = float(kinetic if parameter.index is None else kinetic[parameter.index])
    return low, 1.02 * largest_ratio(raised(free, parameter, i), problem, parameter)


def _loss_of(free: Float[Array, " p"], problem: Problem, i: int) -> Callable[[float], float]:
    return lambda value: float(loss_at(_with(free, problem, i, value), problem))


def _losses(
    free: Float[Array, " p"], problem: Problem, i: int, values: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " n"]:
    """The loss at each of the values."""
    points = np.stack([np.asarray(_with(free, problem, i, float(value))) for value in values])
    return np.asarray(_losses_at(jnp.asarray(points), problem), np.float64)


@jax.jit
def _losses_at(points: Float[Array, "n p"], problem: Problem) -> Float[Array, " n"]:
    return jax.lax.map(lambda free: loss_at(free, problem), points, batch_size=_LANES)


def _with(free: Float[Array, " p"], problem: Problem, i: int, value: float) -> Float[Array, " p"]:
    return free.at[i].set(value_near(problem.parameters[i], value, free))
