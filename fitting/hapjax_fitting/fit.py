"""fit: a scene, recordings, and which of its numbers are free."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import count
from numbers import Real
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hapjax import InputError, Recording, Scene, cast

from . import robust
from .breakaway import broken_away, is_unseen
from .dropping import lost_at, lost_of, of_nothing, without
from .estimates import breakaway, estimate, not_identified
from .findings import findings_of
from .grip import cost_of_grip, holding_instead, is_mu, slipping_instead, value_near
from .identifiability import identifiability
from .interrupt import stopping_at_interrupts
from .noise import lost as is_lost
from .noise import noise_of, spread_of
from .observation import CHANNELS, observation_of
from .parameters import Selector, free_parameters, paths_of, reported, scatter
from .plateau import elsewhere, ends_of, without_influence
from .possible import possible
from .priors import priors_of
from .problem import (
    NOTICEABLE,
    Problem,
    channels_of,
    loss_at,
    numbers_in,
    residuals_at,
    side_by_side,
    stacked_residuals,
)
from .progress import following
from .reduced import reduced, reduced_rows
from .result import FitResult
from .scores import widened
from .sensors import Sensors, Setup, explicit
from .sharding import gathered, over_devices
from .shooting import ALONE, EXPLAINED, shots
from .solve import Solutions, Trace, expect, listen, so_far, solve
from .start import starts_of
from .uncertainty import certainty, information
from .whole_body import made_explicit

_MOST_SEARCHES = 4
_PLACES, _FAR = 64, 20.0  # looked at where all starts went astray, and up to which factor off
_MOST_RETURNS = 2
_MOST_WEIGHINGS, _SETTLED = 4, 0.01
# Residuals beyond so many times the noise: what the model says of slip is then not what the recordings say.
_EXPLAINED = 10.0


def fit(
    scene: Scene,
    recordings: Recording | Sequence[Recording],
    free: Selector,
    *,
    observe: str | Sequence[str] = CHANNELS,
    noise: Mapping[str, float] | None = None,
    sensors: Sensors | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    priors: Mapping[str, tuple[float, float]] | None = None,
    each: str | Sequence[str] = (),
    starts: int = 8,
    spread: float = 2.0,
    seed: int = 0,
    max_steps: int = 100,
    loss: str = "squares",
    progress: bool = False,
    names: Sequence[str] | None = None,
) -> FitResult:
    """Find the free numbers of a scene with which it answers as recorded.

    The recorded HIP path is the input; forces on the fingers and poses of the objects are compared with the
    measured ones, each at its own times, over their noise. Levenberg-Marquardt runs from several starts;
    the best end is the estimate, its Gauss-Newton covariance gives standard errors and 95 % intervals. With objects
    that move and were seen to, each start is first brought near by shooting in windows.

    **Arguments:**

    - `scene`: its free numbers are the first start. With 64-bit numbers on, the fit is in float64 whatever its type.
    - `recordings`: one or several, all of this scene.
    - `free`: paths, or a function from the scene to its free leaves. Beside those of the scene, of what begins moving:
      `start.NAME.velocity` ..., see `Start`; usually in `each`. They start where the recordings' first poses have them.
    - `observe`: what is compared, of `force` and `pose`.
    - `noise`: standard deviations `force` (N), `position` (m), `angle` (rad); estimated from the data where
      absent.
    - `sensors`: how the recordings were measured, where that is known; free numbers of theirs (`sensor.force_bias` ...)
      start there, or where a perfect sensor has them.
    - `bounds`: (low, high) by path.
    - `priors`: (mean, standard deviation) by path, of what is known beforehand. Of numbers above 0 the mean is the median,
      and the deviation that of the logarithm; all others are Gaussian in their own unit.
    - `each`: of the free paths those that have a number of their own for every recording, named `path @ recording`; the
      others are shared.
    - `starts`, `spread`, `seed`: how many starts, with windows at most; all but the first off by random factors up to
      `spread`.
    - `max_steps`: solver steps for a start.
    - `loss`: `squares`; `huber` or `student` where some samples are outliers.
    - `progress`: show the steps on the terminal.
    - `names`: of the recordings, for messages and the report.

    Ctrl-C ends the search: the best numbers so far are returned, with `interrupted` true. Where there are none yet, or at
    a second Ctrl-C, it raises `KeyboardInterrupt` as usual.

    **Raises:** `InputError`, in one sentence, where the arguments do not fit together.
    """
    began = time.perf_counter()
    recordings = [recordings] if isinstance(recordings, Recording) else list(recordings)
    channels = (observe,) if isinstance(observe, str) else tuple(observe)
    names = [f"recording {i + 1}" for i in range(len(recordings))] if names is None else list(names)
    _check(scene, recordings, names, channels)
    _check_numbers(starts, spread, seed, max_steps)
    if loss not in robust.LOSSES:
        raise InputError(f"loss is {loss!r}; allowed: {', '.join(robust.LOSSES)}")
    scene = cast(scene, jnp.result_type(float))
    sensors = explicit(sensors or Sensors(), paths_of(scene, free), scene.integrator.dt.dtype)
    scene = made_explicit(scene, paths_of(scene, free))
    apart = (each,) if isinstance(each, str) else tuple(each)
    laid = [observation_of(scene, r, channels, name) for r, name in zip(recordings, names, strict=True)]
    dropped, begin, trace = frozenset(), None, Trace()
    showing = following(trace, max_steps) if progress else listen(trace)
    with stopping_at_interrupts(trace), showing:
        for attempt in count():
            trace.best.clear()
            left = without(laid, dropped)
            used, called = [recordings[i] for i in left], [names[i] for i in left]
            begins = starts_of(scene, used, paths_of(scene, free))
            first_one = jax.tree.map(lambda x: x[0], begins)
            parameters = free_parameters(Setup(scene, sensors, first_one), free, bounds, apart, called)
            groups = over_devices(side_by_side(scene, list(left.values()), parameters, sensors))
            size = noise_of(used, noise, scene.integrator.dt.dtype)
            known = priors_of(priors, reported(parameters), scene.integrator.dt.dtype)
            problem = Problem(scene, groups, size, parameters, sensors, known, begins, loss)
            _check_count(problem)
            first = problem.start() if begin is None or len(begin) != len(parameters) else begin
            try:
                ends = _searches(problem, first, used, starts, spread, seed, max_steps)
                if loss != "squares":
                    ends = robust.polished(stacked_residuals, reduced, ends, problem)
                problem, ends = _weighed(problem, ends, noise, max_steps)
            except (KeyboardInterrupt, jax.errors.JaxRuntimeError) as error:
                trace.interrupted |= isinstance(error, KeyboardInterrupt)
                if not (trace.interrupted and trace.best):
                    raise KeyboardInterrupt if trace.interrupted else error  # noqa: B904  a stop is no consequence
                ends = so_far(reduced, problem, trace)
            best = ends.free[ends.best]
            residuals = residuals_at(best, problem)
            lost = lost_at(best, residuals, problem, scene, laid, dropped)
            # What the new numbers follow comes back, but not for ever: that might go round in circles.
            lost = lost if attempt < _MOST_RETURNS else dropped | lost
            enough = numbers_in(without(laid, lost).values()) > problem.fitted()
            if trace.interrupted or lost == dropped or not enough:
                break
            dropped, begin = lost, best
    seconds, lost = time.perf_counter() - began, lost_of(lost, names)
    result = _result(problem, ends, residuals, trace, used, called, seconds, noise, lost)
    result = result if enough else of_nothing(result)
    friction = any(map(is_mu, parameters))
    measured_by = {name: result.sensors_of(name) for name in called}
    return replace(result, findings=findings_of(scene, recordings, names, friction, measured_by))


def _searches(
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
    if len(begin) < starts and ALONE**2 <= _variance(ends.loss, problem.measured()) < EXPLAINED**2:
        more = shots(scattered[len(begin) :], problem, recordings)
        ends = ends.joined(_search(problem, more, max_steps, begun=len(begin)))
    if not problem.scene.moving() and _gone_astray(ends.loss, problem.measured()):  # else there are shots
        ends = ends.joined(
            _search(problem, _from_afar(problem, first, starts, seed), max_steps, begun=starts)
        )
    for _ in range(_MOST_SEARCHES - 1):
        better = _better(problem, ends)
        if better is None:
            break
        about = scatter(better, problem.parameters, len(begin), spread, seed)
        before, ends = ends, ends.joined(_search(problem, about, max_steps, begun=len(ends.loss)))
        if ends.loss[ends.best] == before.loss[before.best]:
            break
    return ends


def _gone_astray(losses: Float[Array, " S"], measured: int) -> bool:
    """Whether no start explains so many measured numbers, and fewer than half, or than two, ended at one loss."""
    variance = _variance(losses, measured)
    alike = _alike(losses, variance)
    return len(losses) > 1 and variance >= EXPLAINED**2 and alike < max(2, len(losses) / 2)


def _variance(losses: Float[Array, " S"], measured: int) -> float:
    """That of the residuals where they are least."""
    return 2 * float(np.min(losses)) / measured


def _alike(losses: Float[Array, " S"], variance: float) -> int:
    """How many starts ended at the least loss but for chance, where the residuals have this variance.

    Residuals that err alike say less of the numbers than as many that do not. But two ends at which the same recording has
    other residuals are two.
    """
    least = float(np.min(losses))
    return int(np.sum(np.asarray(losses) <= least + NOTICEABLE * variance / 2))


def _from_afar(problem: Problem, first: Float[Array, " p"], starts: int, seed: int) -> Float[Array, "S p"]:
    """Of many places far around the first start those with the least loss."""
    about = scatter(first, problem.parameters, max(_PLACES, starts), _FAR, seed)
    losses = jnp.stack([loss_at(place, problem) for place in about])
    return about[jnp.argsort(losses)[:starts]]


def _search(problem: Problem, begin: Float[Array, "S p"], max_steps: int, begun: int = 0) -> Solutions:
    """Solve from several starts, numbered from `begun` on in the trace."""
    expect(begun + len(begin))
    tolerance = 1e-8 if begin.dtype == jnp.float64 else 1e-5
    places = begun + jnp.arange(len(begin))
    ends = solve(stacked_residuals, begin, places, problem, tolerance, tolerance, max_steps, reduced)
    return jax.tree.map(lambda x: jnp.asarray(gathered(x)), ends)  # what follows is of one device


def _weighed(
    problem: Problem, ends: Solutions, noise: Mapping[str, float] | None, max_steps: int
) -> tuple[Problem, Solutions]:
    """Where priors are known, search on, from where each start ended, with data that count for what they turned out to be
    worth; and the problem whose priors are so much heavier."""
    if problem.priors is None:
        return problem, ends
    for _ in range(_MOST_WEIGHINGS):
        variance = _spread(problem, residuals_at(ends.free[ends.best], problem), noise)[2]
        if abs(variance / problem.weighed - 1) < _SETTLED:
            break
        problem = problem.weighing(variance)
        ends = _search(problem, ends.free, max_steps, begun=len(ends.loss))
        if problem.loss != "squares":
            ends = robust.polished(stacked_residuals, reduced, ends, problem)
    return problem, ends


def _spread(
    problem: Problem, residuals: Float[np.ndarray, " n"], noise: Mapping[str, float] | None
) -> tuple[dict[str, float], Float[np.ndarray, " m"], float]:
    """Of each channel the root mean square of its residuals; of each residual what variance it stands for in the
    covariance; and what variance they stand for in the loss, on average."""
    channels = channels_of(residuals, problem)
    size, variance = spread_of(channels, noise, problem.fitted())
    typical = float(np.mean(variance))
    if problem.loss != "squares":
        typical, variance = robust.spreads(channels, noise, problem.loss)
    return size, variance, typical


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


def _result(
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
    best = ends.best
    free, matrix = ends.free[best], np.asarray(ends.jacobian)
    channels = channels_of(residuals, problem)
    size, variance, typical = _spread(problem, residuals, given_noise)
    variance = reduced_rows(channels, variance, len(free))
    variance = np.concatenate([variance, np.full(problem.known(), problem.weighed)])  # priors are believed
    cost, chance = cost_of_grip(free, problem), NOTICEABLE * typical
    said, shown = problem.reported, problem.report(free)
    back = problem.by_reported(free)
    slopes = matrix if back is None else matrix @ back
    widest = np.array([p.transform.widest for p in said])
    known = certainty(slopes, variance, widest, cost > chance)
    factors = np.ones(len(free))
    if problem.loss == "squares" and not set(size) <= set(given_noise or {}):
        factors = widened(free, problem, residuals, slopes, back, known, given_noise)
        known = known.widened(factors, widest)
    spread = known.covariance if back is None else back @ known.covariance @ back.T
    explained = max(size.values()) < _EXPLAINED  # in units of the noise
    flat = without_influence(matrix, problem) if problem.reported == problem.parameters else []
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
    near = _alike(ends.loss, min(typical, _variance(ends.loss, problem.measured())))
    reason = (
        f"interrupted after {sum(map(len, trace.losses.values()))} steps"
        if trace.interrupted
        else _why_not(
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


def _why_not(
    tolerant: bool, size: float, near: int, starts: int, moving: bool = False, flat: Sequence[str] = ()
) -> str | None:
    """Why a fit does not count as converged; `None`: it does.

    A solver's tolerances are no evidence of the best fit: the model explains the recordings, or several starts, and no
    small share of them, ended at the same loss; but not where a number that is `flat` has no influence. Something that is
    `moving` may bounce to many places, at each of which a few starts end. Where others were tried and ended elsewhere,
    a start that is alone has to explain the recordings to the noise.
    """
    if not tolerant:
        return "the solver reached max_steps before it met its tolerances"
    enough = max(2, min(3, starts), starts / 2) if moving else max(2, starts / 4)
    if size >= (ALONE if starts > 1 else EXPLAINED) and near < enough:
        return (
            f"the residuals are {size:.1f} times the noise, and {near} of {starts} starts ended at this loss"
        )
    if size >= EXPLAINED and flat:
        return f"the residuals are {size:.1f} times the noise, and {', '.join(flat)} has no influence there"
    return None


def _check(scene: Any, recordings: Sequence[Any], names: Sequence[str], channels: tuple[str, ...]) -> None:
    if not recordings:
        raise InputError("no recording is given; allowed: at least one")
    if len(names) != len(recordings):
        raise InputError(
            f"names has {len(names)} names for {len(recordings)} recordings; allowed: one for each"
        )
    if not channels:
        raise InputError(f"observe is empty; allowed: {', '.join(CHANNELS)}")
    for channel in channels:
        if channel not in CHANNELS:
            raise InputError(f"observe names {channel!r}; allowed: {', '.join(CHANNELS)}")
    if channels == ("pose",) and not scene.moving():
        raise InputError("observe is pose, but no object in the scene moves; allowed: force")


def _check_numbers(starts: Any, spread: Any, seed: Any, max_steps: Any) -> None:
    limits = (("starts", starts, 1, 10_000), ("max_steps", max_steps, 1, 100_000), ("seed", seed, 0, 2**63))
    for name, value, low, high in limits:
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise InputError(f"{name} is {value!r}; allowed: a whole number from {low} to {high}")
    if isinstance(spread, bool) or not isinstance(spread, Real) or not 1 <= float(spread) <= 1e6:
        raise InputError(f"spread is {spread!r}; allowed: 1 to 1000000")


def _check_count(problem: Problem) -> None:
    measured = problem.measured()
    if measured + problem.known() <= len(problem.parameters):
        raise InputError(
            f"free has {len(problem.parameters)} numbers, and the recordings {measured} to fit them to; "
            "allowed: fewer free numbers than measured ones"
        )
