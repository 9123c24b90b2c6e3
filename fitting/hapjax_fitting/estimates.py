"""Estimates in the parameters' own units, and what is said of those that the data do not fix."""

from functools import partial

import jax
import numpy as np
from jaxtyping import Array

from .breakaway import open_ends, posterior
from .grip import is_needed, largest_ratio, raised
from .parameters import Parameter
from .problem import NOTICEABLE, Problem
from .result import Estimate
from .transform import Logit, Transform
from .uncertainty import Certainty

_WIDTH95, _WIDTH99 = 1.959964, 2.575829


def estimate(parameter: Parameter, free: Array, known: Certainty, i: int) -> Estimate:
    """A number that the data fix."""
    transform = parameter.transform
    deviation = float(np.sqrt(known.covariance[i, i]))
    slope = float(_slope(transform, free))
    return Estimate(
        float(transform.value(free)),
        abs(slope) * deviation,
        _interval(transform, free, deviation, _WIDTH95),
        True,
        interval99=_interval(transform, free, deviation, _WIDTH99),
    )


def breakaway(problem: Problem, free: Array, i: int, variance: float, covariance: np.ndarray) -> Estimate:
    """A number that gradients do not see, by its likelihood: the mean and the middle of what it leaves."""
    ends = open_ends(free, problem, i, variance)
    if ends is not None:
        return Estimate(None, None, ends, False, reason=_as_well(ends))
    likely = posterior(free, problem, i, variance, covariance)
    ends = [
        (_at_most(problem, free, i, covariance, width) or low if likely.cut else low, high)
        for (low, high), width in ((likely.central(0.95), _WIDTH95), (likely.central(0.99), _WIDTH99))
    ]
    reason = f"no more than {ends[0][1]:.4g}, and may be as low as mu_kinetic" if likely.cut else None
    return Estimate(likely.mean(), likely.deviation(), ends[0], True, interval99=ends[1], reason=reason)


def _as_well(ends: tuple[float | None, float | None]) -> str:
    """Why a number that shows nowhere near is not known."""
    which = {(True, False): "any smaller one", (False, True): "any larger one"}
    which = which.get((ends[0] is None, ends[1] is None))
    return "the data do not depend on it" if which is None else f"{which} explains the data as well"


def _at_most(problem: Problem, free: Array, i: int, covariance: np.ndarray, width: float) -> float | None:
    """The lower end of the interval of the mu_kinetic beside a mu_static; `None` where it is not free."""
    own = problem.parameters[i]
    for j, p in enumerate(problem.parameters):
        beside = p.path == own.path.replace("mu_static", "mu_kinetic") and p.index == own.index
        if beside and p.place in (None, own.place):
            return _interval(p.transform, free[j], float(np.sqrt(covariance[j, j])), width)[0]
    return None


def _interval(transform, free, deviation: float, width: float) -> tuple[float, float]:
    return float(transform.value(free - width * deviation)), float(transform.value(free + width * deviation))


def not_identified(
    problem: Problem,
    free: Array,
    known: Certainty,
    i: int,
    cost: float,
    chance: float,
    explained: bool,
    ends: tuple[float | None, float | None],
) -> Estimate:
    """No number, but why not, and how large a mu is at least; or between which `ends` a number is that shows beyond."""
    parameter, bound = problem.parameters[i], None
    end = _reached_bound(parameter, float(free[i]))
    sticks = cost <= chance and not parameter.path.endswith("mu_kinetic")  # which says nothing of sliding
    if sticks and explained:
        bound = largest_ratio(raised(free, parameter, i) if cost <= 0 else free, problem, parameter) or None
    if end is not None:
        reason = f"ran to its bound {end:g}"
    elif sticks and not explained:
        reason = "the model does not explain the data"
    elif bound is not None and not is_needed(bound, free, problem, i, chance / NOTICEABLE):
        bound, reason = None, "the data do not depend on it"
    elif cost <= chance and bound is None:
        reason = "nothing slid" if parameter.path.endswith("mu_kinetic") else "nothing touched"
    elif cost <= chance:
        reason = "nothing slipped" if cost <= 0 else "hardly anything slipped"
    elif known.tied_to(i):
        reason = f"not to be told apart from {', '.join(problem.reported[j].name for j in known.tied_to(i))}"
    elif known.covariance[i, i] > 0:
        reason = "the data hardly depend on it"
    else:
        reason = _as_well(ends)
    return Estimate(None, None, ends if bound is None else (bound, None), False, reason=reason)


def _reached_bound(parameter: Parameter, free: float) -> float | None:
    if not isinstance(parameter.transform, Logit) or abs(free) < np.log(100):
        return None
    return parameter.transform.high if free > 0 else parameter.transform.low


@partial(jax.jit, static_argnums=0)
def _slope(transform: Transform, free: Array) -> Array:
    return jax.grad(transform.value)(free)
