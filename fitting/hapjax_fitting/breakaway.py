"""The static mu beside a kinetic one: the forces know it only by when a finger breaks away.

Before that it sticks whatever mu_static is, and after that it slides at mu_kinetic; so the residuals are constant
in mu_static but for jumps, where another step is the first to slide. Gradients are 0: it is searched by its loss.
"""

from collections.abc import Callable

import numpy as np
from jaxtyping import Array, Float

from .grip import largest_ratio, raised, value_near
from .parameters import find_leaf
from .problem import NOTICEABLE, Problem, loss_at


def is_static(problem: Problem, i: int) -> bool:
    """Whether a free number is the mu_static of a surface or contact."""
    return problem.parameters[i].path.endswith(".mu_static")


def broken_away(free: Float[Array, " p"], problem: Problem, variance: float) -> Float[Array, " p"] | None:
    """Free numbers with a mu_static that explains the data better, if there is one."""
    found, lowest = None, float(loss_at(free, problem)) - NOTICEABLE * variance / 2
    for i in filter(lambda i: is_static(problem, i), range(len(problem.parameters))):
        start = free if found is None else found
        loss = _loss_of(start, problem, i)
        low, high = _range(start, problem, i)
        for _ in range(2):  # the second time more finely, about the best of the first
            values = np.geomspace(low, high, 100) if 0 < low < high else np.zeros(0)
            losses = [loss(float(value)) for value in values]
            if not losses:
                break
            best = int(np.argmin(losses))
            if losses[best] < lowest:
                lowest, found = losses[best], _with(start, problem, i, float(values[best]))
            low, high = float(values[max(best - 1, 0)]), float(values[min(best + 1, 99)])
    return found


def between(free: Float[Array, " p"], problem: Problem, i: int, allowed: float) -> tuple[float, float]:
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
    sticking = problem.scene_at(raised(free, parameter, i))
    return low, 1.02 * largest_ratio(sticking, problem.groups, parameter)


def _loss_of(free: Float[Array, " p"], problem: Problem, i: int) -> Callable[[float], float]:
    return lambda value: float(loss_at(_with(free, problem, i, value), problem))


def _with(free: Float[Array, " p"], problem: Problem, i: int, value: float) -> Float[Array, " p"]:
    return free.at[i].set(value_near(problem.parameters[i], value, free))
