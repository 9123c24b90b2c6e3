"""fit: a scene, recordings, and which of its numbers are free."""

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from itertools import count

import jax
import jax.numpy as jnp

from hapjax import Recording, Scene, cast
from hapjax.progress import following as shown_by

from . import robust
from .arguments import check_count, check_names, check_recordings, check_search
from .correlated import correlated
from .dropping import lost_at, lost_of, of_nothing, without
from .findings import findings_of
from .grip import is_mu
from .interrupt import once_more, stopping_at_interrupts
from .misfit import misfit
from .noise import noise_of
from .observation import CHANNELS, observation_of
from .outcome import result_of
from .parameters import Selector, free_parameters, paths_of, reported
from .priors import priors_of
from .problem import Problem, channels_of, numbers_in, residuals_at, side_by_side, stacked_residuals
from .progress import following
from .reduced import reduced
from .result import FitResult
from .search import searched, weighed
from .sensors import Sensors, Setup, explicit
from .sharding import over_devices
from .solve import Trace, listen, so_far
from .start import starts_of
from .whole_body import made_explicit

_MOST_RETURNS = 2


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
    check_recordings(scene, recordings, names, channels)
    check_search(starts, spread, seed, max_steps, loss)
    check_names(free, noise=noise, bounds=bounds, priors=priors)
    scene = cast(scene, jnp.result_type(float))
    sensors = explicit(sensors or Sensors(), paths_of(scene, free), scene.integrator.dt.dtype)
    scene = made_explicit(scene, paths_of(scene, free))
    apart = (each,) if isinstance(each, str) else tuple(each)
    dropped, begin, trace = frozenset(), None, Trace()
    showing = following(trace, max_steps) if progress else listen(trace)
    with stopping_at_interrupts(trace), showing:
        laid = [observation_of(scene, r, channels, name) for r, name in zip(recordings, names, strict=True)]
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
            check_count(problem)
            first = problem.start() if begin is None or len(begin) != len(parameters) else begin
            try:
                ends = searched(problem, first, used, starts, spread, seed, max_steps)
                if loss != "squares":
                    ends = robust.polished(stacked_residuals, reduced, ends, problem)
                problem, ends = weighed(problem, ends, noise, max_steps)
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

    def told() -> FitResult:
        result = result_of(problem, ends, residuals, trace, used, called, seconds, noise, lost)
        result = result if enough else of_nothing(result)
        # Of several recordings one may be without a slip, whatever the others tell.
        several = len(recordings) > 1
        friction = any(is_mu(p) and (several or not result.parameters[p.name].identified) for p in parameters)
        measured_by = {name: result.sensors_of(name) for name in called}
        found = findings_of(scene, recordings, names, friction, measured_by)
        if enough:
            found += tuple(misfit(residuals, problem, called, noise or ()))
            found += tuple(correlated(channels_of(residuals, problem), noise or (), loss))
        return replace(result, findings=found)

    with shown_by(None, doing="intervals and findings", shown=progress):
        return once_more(trace, told)
