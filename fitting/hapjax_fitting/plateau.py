"""Numbers that have no influence where a search ended: whether they have some elsewhere, and up to where they have none."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Array, Float

from .breakaway import is_unseen
from .grip import is_mu, value_near
from .problem import NOTICEABLE, Problem, loss_at
from .solve import Solutions
from .transform import Log

_FACTORS = (10.0, 100.0, 1000.0)
_BISECTIONS = 8


def without_influence(jacobian: Float[np.ndarray, "m p"], problem: Problem) -> list[int]:
    """The places of numbers above 0, no mu among them, of which no residual depends on."""
    length = np.sqrt(np.sum(np.asarray(jacobian, np.float64) ** 2, axis=0))
    silent = length <= np.sqrt(np.finfo(jacobian.dtype).eps) * length.max(initial=0)
    return [
        i
        for i, p in enumerate(problem.parameters)
        if silent[i] and isinstance(p.transform, Log) and not is_mu(p) and not is_unseen(problem, i)
    ]


def elsewhere(ends: Solutions, problem: Problem, variance: float) -> Float[Array, " p"] | None:
    """Free numbers that explain the data better, with one that has no influence up to a factor of 1000 off; if any do."""
    free, found = ends.free[ends.best], None
    least = float(ends.loss[ends.best])
    lowest = least - NOTICEABLE * variance / 2
    for i in without_influence(ends.slopes, problem):
        met: dict[float, float] = {}

        def differs(factor: float, i: int = i, met: dict[float, float] = met) -> bool:
            met[factor] = float(loss_at(_scaled(free, problem, i, factor), problem))
            return not np.isclose(met[factor], least, rtol=1e-6)

        for sign in (-1, 1):
            _edge(differs, sign)
        best = min(met, key=lambda factor: met[factor])
        if met[best] < lowest:
            found, lowest = _scaled(free, problem, i, best), met[best]
    return found


def ends_of(
    free: Float[Array, " p"], problem: Problem, i: int, chance: float
) -> tuple[float | None, float | None]:
    """Between which values twice the loss is at most `chance` larger, the others kept; `None`: as far as was looked, a
    factor of 1000."""
    most = float(loss_at(free, problem)) + chance / 2

    def worse(factor: float) -> bool:
        return float(loss_at(_scaled(free, problem, i, factor), problem)) > most

    value = float(problem.parameters[i].transform.value(free[i]))
    low, high = (_edge(worse, sign) for sign in (-1, 1))
    return None if low is None else value * low, None if high is None else value * high


def _edge(is_beyond: Callable[[float], bool], sign: int) -> float | None:
    """The factor from which on, up or down, the loss is another; `None`: nowhere."""
    inside = 1.0
    for factor in _FACTORS:
        outside = factor**sign
        if is_beyond(outside):
            for _ in range(_BISECTIONS):
                middle = float(np.sqrt(inside * outside))
                inside, outside = (inside, middle) if is_beyond(middle) else (middle, outside)
            return outside
        inside = outside
    return None


def _scaled(free: Float[Array, " p"], problem: Problem, i: int, factor: float) -> Float[Array, " p"]:
    parameter = problem.parameters[i]
    return free.at[i].set(value_near(parameter, factor * float(parameter.transform.value(free[i])), free))
