"""The result of a fit, from where its search ended."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from hapjax import Recording

from .breakaway import is_unseen
from .estimates import breakaway, estimate, not_identified
from .grip import cost_of_grip, value_near
from .identifiability import identifiability
from .noise import lost as is_lost
from .plateau import ends_of, without_influence
from .possible import possible
from .problem import NOTICEABLE, Problem, channels_of, spread_at
from .reduced import reduced_rows
from .result import FitResult
from .rounding import steps_in
from .scores import widened
from .solve import Solutions, Trace
from .success import alike, variance_of, why_not
from .uncertainty import certainty, information

# Residuals beyond so many times the noise: what the model says of slip is then not what the recordings say.
_EXPLAINED = 10.0


def result_of(
    problem: Problem,
    ends: Solutions,
    residuals: Float[np.ndarray, " n"],
    trace: Trace,
    recordings: Sequence[Recording],
    names: Sequence[str],
    wall_s: float,
    given_noise: Mapping[str, float] | None,
    lost: Mapping[str, int],
) -> FitResult:
    """Estimates, intervals and what else there is to say of the best end of a search."""
    best = ends.best
    free, matrix = ends.free[best], ends.slopes
    channels = channels_of(residuals, problem)
    size, variance, typical = spread_at(problem, residuals, given_noise)
    variance = reduced_rows(channels, variance, len(free))
    variance = np.concatenate([variance, np.full(problem.known(), problem.weighed)])  # priors are believed
    cost, chance = cost_of_grip(free, problem), NOTICEABLE * typical
    said, shown = problem.reported, problem.report(free)
    back = problem.by_reported(free)
    slopes = matrix if back is None else matrix @ back
    widest = np.array([p.transform.widest for p in said])
    known = certainty(slopes, variance, widest, cost > chance)
    factors, coarse = np.ones(len(free)), steps_in(problem, residuals)
    if coarse or not set(size) <= set(given_noise or {}):
        factors = widened(free, problem, residuals, slopes, back, known, given_noise, coarse)
        known = known.widened(factors, widest)
    spread = known.covariance if back is None else back @ known.covariance @ back.T
    explained = max(size.values()) < _EXPLAINED  # in units of the noise
    flat = without_influence(matrix, problem)
    limits = {i: ends_of(free, problem, i, chance) for i in flat}
    jumping = [is_unseen(problem, i) and cost[i] > chance for i in range(len(free))]
    estimates = {
        p.name: breakaway(problem, free, i, typical, spread)
        if jumping[i]
        else estimate(p, shown[i], known, i)
        if known.identified[i]
        else not_identified(
            problem, free, known, i, float(cost[i]), chance, explained, limits.get(i, (None, None))
        )
        for i, p in enumerate(said)
    }
    estimated = free
    for i in np.flatnonzero(jumping).tolist():
        if (value := estimates[said[i].name].estimate) is not None:
            estimated = estimated.at[i].set(value_near(problem.parameters[i], value, free))
    setup = problem.setup_at(estimated)
    scene, adjusted = possible(setup.scene)
    fisher = information(matrix, variance)
    units = {name: float(getattr(problem.noise, name)) for name in size}
    rms = {key: size[key] * units[key] for key in size}
    near = alike(ends.loss, min(typical, variance_of(ends.loss, problem.measured())))
    reason = (
        f"interrupted after {sum(map(len, trace.losses.values()))} steps"
        if trace.interrupted
        else why_not(
            bool(ends.converged[best]),
            max(size.values()),
            near,
            len(ends.loss),
            bool(problem.scene.moving()) and not problem.starts,
            [p.name for i, p in enumerate(said) if i in flat],
        )
    )
    return FitResult(
        parameters=estimates,
        scene=scene,
        sensors=setup.sensor,
        loss=float(ends.loss[best]),
        residual_rms={("pose" if key == "position" else key): value for key, value in rms.items()},
        noise=units,
        converged=reason is None,
        reason=reason,
        interrupted=trace.interrupted,
        starts=len(ends.loss),
        starts_at_best=near,
        wall_s=wall_s,
        covariance=known.covariance,
        singular_values=known.singular_values,
        trace=trace.losses,
        recordings=tuple(recordings),
        names=tuple(names),
        lost=lost,
        problem=problem,
        free=np.asarray(free),
        estimated=np.asarray(estimated),
        adjusted=adjusted,
        information=fisher,
        variance=typical,
        widened=factors,
        identifiability=identifiability(
            information(slopes, variance),
            said,
            estimates,
            (cost > chance) & ~np.array(jumping),
            _seconds(recordings),
        ),
        measured={
            key: sum(int(np.sum(~is_lost(r))) * r.shape[2] for name, r in channels if name == key)
            for key in size
        },
    )


def _seconds(recordings: Sequence[Recording]) -> float:
    return sum(float(r.hip_t[-1] - r.hip_t[0]) for r in recordings if r.hip_t is not None)
