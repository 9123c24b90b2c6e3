"""fit: a scene, recordings, and which of its numbers are free."""

import time
from collections.abc import Mapping, Sequence
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from hapjax import InputError, Recording, Scene
from jaxtyping import Array, Float

from .grip import largest_ratio
from .noise import noise_of
from .observation import CHANNELS, Noise, Observation, observation_of, residuals
from .parameters import Parameter, Selector, free_parameters, values_of, with_values
from .progress import following
from .result import Estimate, FitResult
from .solve import Solutions, Trace, jacobian, listen, solve
from .uncertainty import Certainty, certainty

# Twice a difference in loss is chi-squared with one degree of freedom, which exceeds this once in a hundred.
_NOTICEABLE = 6.635


class Problem(eqx.Module):
    """What the residuals need besides the free numbers. Recordings of equal sizes are stacked, to run side by side."""

    scene: Scene
    groups: tuple[Observation, ...]
    noise: Noise
    parameters: tuple[Parameter, ...] = eqx.field(static=True)

    def scene_at(self, free: Float[Array, " p"]) -> Scene:
        """The scene with the free numbers put in."""
        values = jnp.stack([p.transform.value(x) for p, x in zip(self.parameters, free, strict=True)])
        return with_values(self.scene, self.parameters, values)


def fit(
    scene: Scene,
    recordings: Recording | Sequence[Recording],
    free: Selector,
    *,
    observe: Sequence[str] = CHANNELS,
    noise: Mapping[str, float] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    starts: int = 8,
    spread: float = 2.0,
    seed: int = 0,
    max_steps: int = 100,
    progress: bool = False,
    names: Sequence[str] | None = None,
) -> FitResult:
    """Find the free numbers of a scene with which it answers as recorded.

    The recorded HIP path is the input; forces on the fingers and poses of the objects are compared with the
    measured ones, each at its own times, over their noise. Levenberg-Marquardt runs from several starts side by
    side; the best end is the estimate, its Gauss-Newton covariance gives standard errors and 95 % intervals.

    **Arguments:**

    - `scene`: its free numbers are the first start. Its numbers' type (float64, better) is that of the fit.
    - `recordings`: one or several, all of this scene.
    - `free`: paths, or a function from the scene to its free leaves.
    - `observe`: what is compared, of `force` and `pose`.
    - `noise`: standard deviations `force` (N), `position` (m), `angle` (rad); estimated from the data where absent.
    - `bounds`: (low, high) by path.
    - `starts`, `spread`, `seed`: how many starts; all but the first off by random factors up to `spread`.
    - `max_steps`: solver steps for a start.
    - `progress`: show the steps on the terminal.
    - `names`: of the recordings, for messages and the report.

    **Raises:** `InputError`, in one sentence, where the arguments do not fit together.
    """
    began = time.perf_counter()
    recordings = [recordings] if isinstance(recordings, Recording) else list(recordings)
    names = [f"recording {i + 1}" for i in range(len(recordings))] if names is None else list(names)
    _check(scene, recordings, observe, starts, spread, max_steps)
    parameters = free_parameters(scene, free, bounds)
    groups = _grouped(scene, recordings, tuple(observe), names)
    problem = Problem(scene, groups, noise_of(recordings, noise, scene.integrator.dt.dtype), parameters)

    first = _start(problem)
    scattered = _scatter(first, starts, spread, seed)
    tolerance = 1e-8 if first.dtype == jnp.float64 else 1e-5
    trace = Trace()
    with following(trace, starts, max_steps) if progress else listen(trace):
        ends = jax.block_until_ready(
            solve(_stacked_residuals, scattered, problem, tolerance, tolerance, max_steps)
        )
    best = int(np.argmin(np.where(np.isfinite(ends.loss), ends.loss, np.inf)))
    return _result(problem, ends, best, trace, recordings, names, time.perf_counter() - began, noise)


def _stacked_residuals(free: Float[Array, " p"], problem: Problem) -> Float[Array, " n"]:
    return jnp.concatenate([r for _, r in _by_channel(free, problem)])


def _by_channel(free: Float[Array, " p"], problem: Problem) -> list[tuple[str, Float[Array, " n"]]]:
    scene = problem.scene_at(free)
    found = []
    for group in problem.groups:
        each = jax.vmap(partial(residuals, scene), in_axes=(0, None))(group, problem.noise)
        found += [(channel, r.ravel()) for channel, r in each.items()]
    return found


@eqx.filter_jit
def _evaluate(free: Float[Array, " p"], problem: Problem):
    """Residuals by channel (as a list in the Jacobian's order), and the Jacobian."""
    return _by_channel(free, problem), jacobian(_stacked_residuals, free, problem)


@eqx.filter_jit
def _loss(free: Float[Array, " p"], problem: Problem) -> Float[Array, ""]:
    return 0.5 * jnp.sum(_stacked_residuals(free, problem) ** 2)


def _result(
    problem: Problem,
    ends: Solutions,
    best: int,
    trace: Trace,
    recordings: Sequence[Recording],
    names: Sequence[str],
    wall_s: float,
    given_noise: Mapping[str, float] | None,
) -> FitResult:
    free = ends.free[best]
    channels, matrix = _evaluate(free, problem)
    size, variance = _spread_of(channels, given_noise)
    unbounded = _slips_too_little(free, problem)
    widest = np.array([p.transform.widest for p in problem.parameters])
    known = certainty(np.asarray(matrix), variance, widest, ~unbounded)
    scene = problem.scene_at(free)
    estimates = {
        p.name: _estimate(
            p, free[i], known, i, largest_ratio(scene, problem.groups, p) if unbounded[i] else None
        )
        for i, p in enumerate(problem.parameters)
    }
    units = {"force": problem.noise.force, "position": problem.noise.position, "angle": problem.noise.angle}
    rms = {key: size[key] * float(units[key]) for key in size}
    finite = np.asarray(ends.loss)[np.isfinite(ends.loss)]
    return FitResult(
        parameters=estimates,
        scene=scene,
        loss=float(ends.loss[best]),
        residual_rms={("pose" if key == "position" else key): value for key, value in rms.items()},
        converged=bool(ends.converged[best]),
        starts=len(ends.loss),
        starts_at_best=int(np.sum(finite <= finite.min() + _NOTICEABLE / 2)) if len(finite) else 0,
        wall_s=wall_s,
        covariance=known.covariance,
        singular_values=known.singular_values,
        trace=trace.losses,
        recordings=tuple(recordings),
        names=tuple(names),
    )


def _estimate(parameter: Parameter, free: Array, known: Certainty, i: int, bound: float | None) -> Estimate:
    transform = parameter.transform
    deviation = float(np.sqrt(known.covariance[i, i]))
    if not known.identified[i]:
        return Estimate(None, None, (bound, None), False)
    slope = float(jax.grad(transform.value)(free))
    return Estimate(
        float(transform.value(free)),
        abs(slope) * deviation,
        _interval(transform, free, deviation, 1.959964),
        True,
        interval99=_interval(transform, free, deviation, 2.575829),
    )


def _interval(transform, free, deviation: float, width: float) -> tuple[float, float]:
    return float(transform.value(free - width * deviation)), float(transform.value(free + width * deviation))


def _spread_of(channels, given_noise: Mapping[str, float] | None) -> tuple[dict[str, float], np.ndarray]:
    """Root mean square of each channel's whitened residuals, and the variance of each residual.

    Noise that was given is believed; noise that was estimated is replaced by what the residuals turned out to be.
    """
    squares: dict[str, list[np.ndarray]] = {}
    for key, r in channels:
        squares.setdefault(key, []).append(np.asarray(r, np.float64) ** 2)
    size = {key: float(np.sqrt(np.mean(np.concatenate(parts)))) for key, parts in squares.items()}
    trusted = given_noise or {}
    variance = np.concatenate(
        [np.full(len(r), 1.0 if key in trusted else size[key] ** 2) for key, r in channels]
    )
    return size, variance


def _slips_too_little(free: Float[Array, " p"], problem: Problem) -> np.ndarray:
    """For each free number, whether it is a mu that could as well be a thousand times larger.

    Where nothing slips, any larger mu explains the data as well, and the solver stops at some value on its way.
    """
    found = np.zeros(len(problem.parameters), bool)
    loss = float(_loss(free, problem))
    for i, p in enumerate(problem.parameters):
        if p.path.rsplit(".", 1)[-1].startswith("mu"):
            value = p.transform.value(free[i])
            high = getattr(p.transform, "high", None)
            larger = 1e3 * value if high is None else value + 0.999 * (high - value)
            found[i] = (
                2 * (float(_loss(free.at[i].set(p.transform.free(larger)), problem)) - loss) < _NOTICEABLE
            )
    return found


def _start(problem: Problem) -> Float[Array, " p"]:
    values = values_of(problem.scene, problem.parameters)
    return jnp.stack([p.transform.free(v) for p, v in zip(problem.parameters, values, strict=True)])


def _scatter(first: Float[Array, " p"], starts: int, spread: float, seed: int) -> Float[Array, "S p"]:
    """The first start, and others off by random factors up to `spread`; the same numbers for the same seed."""
    random = np.random.default_rng(seed).uniform(-1, 1, (starts, len(first)))
    random[0] = 0
    return first[None] + jnp.asarray(np.log(spread) * random, first.dtype)


def _grouped(scene, recordings, channels, names) -> tuple[Observation, ...]:
    """Observations of equal sizes stacked along a first axis."""
    groups: dict[object, list[Observation]] = {}
    for recording, name in zip(recordings, names, strict=True):
        laid = observation_of(scene, recording, channels, name)
        leaves, structure = jax.tree.flatten(laid)
        groups.setdefault((structure, tuple(x.shape for x in leaves)), []).append(laid)
    stacked = tuple(jax.tree.map(lambda *x: jnp.stack(x), *group) for group in groups.values())
    if all(g.force is None and g.pose is None for g in stacked):
        raise InputError(
            f"observe is {', '.join(channels)}, but no recording has it; allowed: a channel that was recorded"
        )
    return stacked


def _check(scene, recordings, observed, starts, spread, max_steps) -> None:
    if not recordings:
        raise InputError("no recording is given; allowed: at least one")
    for channel in observed:
        if channel not in CHANNELS:
            raise InputError(f"observe names {channel!r}; allowed: {', '.join(CHANNELS)}")
    if not observed:
        raise InputError(f"observe is empty; allowed: {', '.join(CHANNELS)}")
    if "pose" in observed and not scene.moving() and list(observed) == ["pose"]:
        raise InputError("observe is pose, but no object in the scene moves; allowed: force")
    for name, value, low, high in (("starts", starts, 1, 10_000), ("max_steps", max_steps, 1, 100_000)):
        if not isinstance(value, int) or not low <= value <= high:
            raise InputError(f"{name} is {value!r}; allowed: a whole number from {low} to {high}")
    if not (np.isfinite(spread) and 1 <= spread <= 1e6):
        raise InputError(f"spread is {spread}; allowed: 1 to 1000000")
