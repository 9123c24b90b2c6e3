"""The search of a fit: from its starts, and again from where a better place may be."""

from collections.abc import Mapping, Sequence

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hapjax import Recording

from . import robust
from .around import lowest_around
from .breakaway import broken_away
from .grip import cost_of_grip, holding_instead, slipping_instead
from .parameters import scatter
from .plateau import elsewhere
from .problem import NOTICEABLE, Problem, loss_at, residuals_at, spread_at, stacked_residuals
from .reduced import reduced
from .sharding import gathered
from .shooting import ALONE, EXPLAINED, shots
from .solve import Solutions, expect, solve
from .success import gone_astray, variance_of

_MOST_SEARCHES = 4
_PLACES, _FAR = 64, 20.0  # looked at where all starts went astray, and up to which factor off
_SHELLS = 6  # at least, around where a search ended
_MOST_TURNS, _ENOUGH = 8, 2  # of looking around, and of looking around in vain
_MOST_WEIGHINGS, _SETTLED = 4, 0.01


def searched(
    problem: Problem,
    first: Float[Array, " p"],
    recordings: Sequence[Recording],
    starts: int,
    spread: float,
    seed: int,
    max_steps: int,
) -> Solutions:
    """Solve, and again from where a better place may be that gradients do not lead to."""
    scattered = scatter(first, problem.parameters, starts, spread, seed)
    begin = shots(scattered, problem, recordings)
    ends = _search(problem, begin, max_steps)
    if len(begin) < starts and ALONE**2 <= variance_of(ends.loss, problem.measured()) < EXPLAINED**2:
        more = shots(scattered[len(begin) :], problem, recordings)
        ends = ends.joined(_search(problem, more, max_steps, begun=len(begin)))
    if not problem.scene.moving() and gone_astray(ends.loss, problem.measured()):  # else there are shots
        ends = ends.joined(
            _search(problem, _from_afar(problem, first, starts, seed), max_steps, begun=starts)
        )
    if starts > 1 and problem.scene.moving() and not problem.starts:
        ends = _looked_around(problem, ends, len(begin), seed, max_steps)
    for _ in range(_MOST_SEARCHES - 1):
        better = _better(problem, ends)
        if better is None:
            break
        about = scatter(better, problem.parameters, len(begin), spread, seed)
        before, ends = ends, ends.joined(_search(problem, about, max_steps, begun=len(ends.loss)))
        if ends.loss[ends.best] == before.loss[before.best]:
            break
    return ends


def _from_afar(problem: Problem, first: Float[Array, " p"], starts: int, seed: int) -> Float[Array, "S p"]:
    """Of many places far around the first start those with the least loss."""
    about = scatter(first, problem.parameters, max(_PLACES, starts), _FAR, seed)
    losses = jnp.stack([loss_at(place, problem) for place in about])
    return about[jnp.argsort(losses)[:starts]]


def _looked_around(problem: Problem, ends: Solutions, batch: int, seed: int, max_steps: int) -> Solutions:
    """Search from places around the best end, in batches of one size, as long as that leads to better ones.

    Where the recordings are explained, only places that are better themselves are gone on from. Only better ends are
    counted: what comes back to the end that it began around is no evidence for it.
    """
    begun, in_vain = len(ends.loss), 0
    shells = -(-_SHELLS // batch) * batch
    for turn in range(_MOST_TURNS):
        variance = variance_of(ends.loss, problem.measured())
        chance, explained = NOTICEABLE * variance / 2, variance < ALONE**2
        places, losses = lowest_around(ends, problem, variance, shells, seed + turn)
        if explained and not losses[0] < ends.loss[ends.best] - chance:
            break
        before = ends.loss[ends.best]
        for some in places[:batch][None] if explained else places.reshape(-1, batch, places.shape[1]):
            found = _search(problem, some, max_steps, begun)
            begun += batch
            if found.loss[found.best] < ends.loss[ends.best] - chance:
                ends = ends.joined(found.at_best)
        in_vain = 0 if ends.loss[ends.best] < before else in_vain + 1
        if in_vain == _ENOUGH:
            break
    return ends


def _search(problem: Problem, begin: Float[Array, "S p"], max_steps: int, begun: int = 0) -> Solutions:
    """Solve from several starts, numbered from `begun` on in the trace."""
    expect(begun + len(begin))
    tolerance = 1e-8 if begin.dtype == jnp.float64 else 1e-5
    places = begun + jnp.arange(len(begin))
    ends = solve(stacked_residuals, begin, places, problem, tolerance, tolerance, max_steps, reduced)
    return jax.tree.map(lambda x: jnp.asarray(gathered(x)), ends)  # what follows is of one device


def _better(problem: Problem, ends: Solutions) -> Array | None:
    """Where to search again: a better place that the solver's gradients do not lead to, if there is one."""
    free = ends.free[ends.best]
    variance = 2 * float(ends.loss[ends.best]) / problem.measured()
    cost = cost_of_grip(free, problem)
    holding = holding_instead(free, problem, cost < -NOTICEABLE * variance, variance)
    if holding is not None:
        return holding
    flat = cost <= NOTICEABLE * variance
    found = slipping_instead(free, problem, flat, variance) if flat.any() else None
    found = elsewhere(ends, problem, variance) if found is None else found
    return broken_away(ends, problem, variance) if found is None else found


def weighed(
    problem: Problem, ends: Solutions, noise: Mapping[str, float] | None, max_steps: int
) -> tuple[Problem, Solutions]:
    """Where priors are known, search on, from where each start ended, with data that count for what they turned out to be
    worth; and the problem whose priors are so much heavier."""
    if problem.priors is None:
        return problem, ends
    for _ in range(_MOST_WEIGHINGS):
        variance = spread_at(problem, residuals_at(ends.free[ends.best], problem), noise)[2]
        if abs(variance / problem.weighed - 1) < _SETTLED:
            break
        problem = problem.weighing(variance)
        ends = _search(problem, ends.free, max_steps, begun=len(ends.loss))
        if problem.loss != "squares":
            ends = robust.polished(stacked_residuals, reduced, ends, problem)
    return problem, ends
