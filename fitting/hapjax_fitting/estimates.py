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


def estimate(parameter: Parameter, free: Array, known: Certainty, i: int) -> Estimate:
    """A number that the data fix."""
    transform = parameter.transform
    deviation = float(np.sqrt(known.covariance[i, i]))
    slope = float(_slope(transform, free))
    return Estimate(
        float(transform.value(free)),
        abs(slope) * deviation,
        _interval(transform, free, deviation, 1.959964),
        True,
        interval99=_interval(transform, free, deviation, 2.575829),
    )


def breakaway(problem: Problem, free: Array, i: int, variance: float, covariance: np.ndarray) -> Estimate:
    """A number that gradients do not see, by its likelihood: the mean and the middle of what it leaves."""
    ends = open_ends(free, problem, i, variance)
    if ends is not None:
        which = {(True, False): "any smaller one", (False, True): "any larger one"}
        which = which.get((ends[0] is None, ends[1] is None))
        reason = "the data do not depend on it" if which is None else f"{which} explains the data as well"
        return Estimate(None, None, ends, False, reason=reason)
    likely = posterior(free, problem, i, variance, covariance)
    return Estimate(
        likely.mean(), likely.deviation(), likely.central(0.95), True, interval99=likely.central(0.99)
    )


def _interval(transform, free, deviation: float, width: float) -> tuple[float, float]:
    return float(transform.value(free - width * deviation)), float(transform.value(free + width * deviation))


def not_identified(
    problem: Problem, free: Array, known: Certainty, i: int, cost: float, chance: float, explained: bool
) -> Estimate:
    """No number, but why not, and how large a mu is at least."""
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
        reason = "the data do not depend on it"
    return Estimate(None, None, (bound, None), False, reason=reason)


def _reached_bound(parameter: Parameter, free: float) -> float | None:
    if not isinstance(parameter.transform, Logit) or abs(free) < np.log(100):
        return None
    return parameter.transform.high if free > 0 else parameter.transform.low


@partial(jax.jit, static_argnums=0)
def _slope(transform: Transform, free: Array) -> Array:
    return jax.grad(transform.value)(free)
