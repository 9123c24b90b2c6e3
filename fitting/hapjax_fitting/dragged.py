"""Fits of an object whose motion is known: the total wrench on it tells the friction under its feet."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from scipy.stats import t as student

from hapjax import InputError, Surface, drag
from hapjax._validate import as_float, check_not_negative, check_positive, is_traced

from .parameters import Parameter, Selector, free_parameters, scatter, values_of, with_values
from .result import Estimate
from .solve import jacobian, solve

_MOST_ROUNDS = 50
_LEAST_NOISE = 1e-12  # N^2: no force sensor is better than 1 uN


class Drags(eqx.Module):
    """P drags of an object over a plane, at S times each, on V feet; in the plane's frame (normal +z).

    `feet` (P, S, V, 3) m, and `arms`, the same from the point that moments are about (the centre of mass); `loads` (V,) N
    on the feet; `wrench` (P, S, 3) N of what drags it: fx, fy, and the moment about that point over `gyration` (m), a
    length that weighs moments against forces, such as the feet's radius of gyration. `dt` (s) between the times, for a
    surface whose friction depends on velocity.

    **Raises:** `InputError` where sizes do not fit together, a number is not finite, or a load is below 0.
    """

    feet: Float[Array, "P S V 3"] = eqx.field(converter=as_float)
    arms: Float[Array, "P S V 3"] = eqx.field(converter=as_float)
    loads: Float[Array, " V"] = eqx.field(converter=as_float)
    wrench: Float[Array, "P S 3"] = eqx.field(converter=as_float)
    gyration: Float[Array, ""] = eqx.field(converter=as_float)
    dt: Float[Array, ""] | None = eqx.field(converter=as_float, default=None)

    def __check_init__(self):
        drags, times, feet = np.shape(self.feet)[:3] if np.ndim(self.feet) == 4 else ("P", "S", "V")
        _check_series("feet", self.feet, (drags, times, feet, 3))
        _check_series("arms", self.arms, (drags, times, feet, 3))
        _check_series("wrench", self.wrench, (drags, times, 3))
        check_not_negative("loads", self.loads, shape=(feet,), unit="N")
        check_positive("gyration", self.gyration, unit="m")
        if self.dt is not None:
            check_positive("dt", self.dt, unit="s")


def _check_series(name: str, value: Any, shape: tuple) -> None:
    if np.shape(value) != shape:
        allowed = ", ".join(map(str, shape))
        raise InputError(f"{name} has the shape {np.shape(value)}; allowed: ({allowed})")
    if not is_traced(value) and not np.all(np.isfinite(value)):
        place = np.argwhere(~np.isfinite(value))[0]
        raise InputError(f"{name} is {value[tuple(place)]} at {place.tolist()}; allowed: finite numbers")


class Dragged(eqx.Module):
    """What can be free: the numbers of the `surface` under the feet, and `arms`, a factor on how far out these stand."""

    surface: Surface
    arms: Float[Array, ""]


@dataclass(frozen=True)
class DragFit:
    """The outcome: `parameters` by path, the `surface` and the factor `arms` with the best values, of how many `drags`; the
    `noise` (N) of each recording's forces and of its moments over the radius; `starts`, of which `starts_at_best` ended
    at the best."""

    parameters: Mapping[str, Estimate]
    surface: Surface
    arms: float
    drags: int
    noise: tuple[tuple[float, float], ...]
    starts: int
    starts_at_best: int


class _Question(eqx.Module):
    first: Dragged
    recordings: tuple[Drags, ...]
    variances: tuple[Float[Array, "3"], ...]
    parameters: tuple[Parameter, ...] = eqx.field(static=True)

    def at(self, free: Float[Array, " p"]) -> Dragged:
        values = jnp.stack([p.transform.value(x) for p, x in zip(self.parameters, free, strict=True)])
        return with_values(self.first, self.parameters, values)


def unbalanced(dragged: Dragged, drags: Drags) -> Float[Array, "P S 3"]:
    """The wrench (N) of what drags and of friction together, 0 where the motion is slow and steady (quasi-static)."""
    arms = dragged.arms * drags.arms
    feet = drags.feet - drags.arms + arms
    force = jax.vmap(lambda feet: drag(dragged.surface, feet, drags.loads, drags.dt))(feet)
    moment = jnp.sum(jnp.cross(arms, force)[..., 2], axis=-1) / drags.gyration
    return drags.wrench + jnp.concatenate([jnp.sum(force, axis=2)[..., :2], moment[..., None]], axis=-1)


def fit_drags(
    surface: Surface,
    recordings: Drags | Sequence[Drags],
    free: Selector = "surface.mu",
    *,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    starts: int = 4,
    spread: float = 4.0,
    seed: int = 0,
    max_steps: int = 100,
    name: str = "drags",
) -> DragFit:
    """Find the free numbers of a surface with which its friction balances what dragged an object over it.

    The object's motion is taken as it was measured, and nothing is integrated: each foot's god-object is dragged along
    ([`hapjax.drag`][]), and the total wrench of friction is compared with the measured one, over a noise of each
    recording that is estimated from what remains, one for forces and one for moments. Each drag counts once, however many
    times it has. The samples of one drag share its errors, so standard errors come from leaving out whole drags (the
    jackknife), and intervals from Student's t.

    **Arguments:**

    - `surface`: its free numbers are the first start. Its stiffness is the feet's tangential one (N/m): the stiffer, the
      closer to rigid feet. With 64-bit numbers on, the fit is in float64 whatever its type.
    - `recordings`: one or several, each with a noise of its own. Quasi-static: inertia is left out, and so is what
      the motion does to the loads.
    - `free`: paths from `surface`, such as `surface.mu`, and `arms`, a factor (1 at the start) on how far out the feet
      stand: on the torsional arm, the sum of load times distance over the weight, that moments tell of.
    - `bounds`, `starts`, `spread`, `seed`, `max_steps`: as for [`hapjax_fitting.fit`][].
    - `name`: of the recordings, for messages.

    **Raises:** `InputError` where fewer than two drags are given, where a path names no number, and where the drags do not
    determine what is free.
    """
    given = (recordings,) if isinstance(recordings, Drags) else tuple(recordings)
    count = sum(len(r.wrench) for r in given)
    if count < 2:
        raise InputError(f"{name}: {count} drags are given; allowed: at least 2, for an interval")
    dtype = jnp.result_type(float)
    first, given = jax.tree.map(lambda x: jnp.asarray(x, dtype), (Dragged(surface, jnp.ones(())), given))
    parameters = free_parameters(first, free, bounds)
    question = _Question(first, given, tuple(jnp.ones(3, dtype) for _ in given), parameters)
    begun = [p.transform.free(x) for p, x in zip(parameters, values_of(first, parameters), strict=True)]
    begin = scatter(jnp.stack(begun), parameters, starts, spread, seed)
    free_at, ended, question, per_drag = _settled(question, begin, max_steps, name)
    errors = _jackknife(per_drag)
    # Where there is no noise no drag is missed, also of numbers that none depends on.
    loose = np.maximum(errors, _loose(per_drag)) / np.array([p.transform.widest for p in parameters])
    if not np.all(loose < 1):
        worst = parameters[int(np.argmax(loose))].name
        raise InputError(f"{name}: the drags do not determine {worst}; allowed: forces that oppose friction")
    wide = float(student.ppf(0.975, count - 1)), float(student.ppf(0.995, count - 1))
    near = jnp.all(jnp.abs(ended - free_at[None]) < 1e-4, axis=1)
    best = question.at(free_at)
    return DragFit(
        {p.name: _estimate(p, x, e, wide) for p, x, e in zip(parameters, free_at, errors, strict=True)},
        best.surface,
        float(best.arms),
        count,
        tuple((math.sqrt(float(v[0])), math.sqrt(float(v[2]))) for v in question.variances),
        starts,
        int(jnp.sum(near)),
    )


def _settled(question: _Question, begin: Float[Array, "S p"], max_steps: int, name: str):
    """The best numbers, where each start ended, the question with the noise that remains, and the sums over each drag."""
    tight = 1e-10 if begin.dtype == jnp.float64 else 1e-5
    before = np.full(begin.shape[1], np.inf)
    for _ in range(_MOST_ROUNDS):
        ended = solve(_whitened, begin, jnp.arange(len(begin)), question, tight, tight, max_steps)
        free = ended.free[ended.best]
        per_drag = [[np.asarray(x) for x in _sums(free, question, r)] for r in question.recordings]
        noise = [jnp.asarray(_variance(square.mean(axis=0)), begin.dtype) for square, _, _ in per_drag]
        question = replace(question, variances=tuple(noise))
        if np.abs(np.asarray(free) - before).max() < 1e3 * tight:
            return free, ended.free, question, per_drag
        before = np.asarray(free)
    raise InputError(f"{name}: the numbers and the noise do not settle; the forces do not fit one surface")


def _once(dragged: Dragged, drags: Drags) -> Float[Array, "P S 3"]:
    """What is unbalanced, weighed so that a drag counts once, however many times it has."""
    return unbalanced(dragged, drags) / math.sqrt(drags.wrench.shape[1])


def _whitened(free: Float[Array, " p"], question: _Question) -> Float[Array, " n"]:
    both = zip(question.recordings, question.variances, strict=True)
    dragged = question.at(free)
    return jnp.concatenate([(_once(dragged, r) * jax.lax.rsqrt(v)[None, None]).ravel() for r, v in both])


@eqx.filter_jit
def _sums(free: Float[Array, " p"], question: _Question, drags: Drags):
    """For each drag and channel (P, 3), over its times: residual^2, slopes * residual (p,), slopes * slopes (p, p)."""
    slope, r = jacobian(lambda free, _: _once(question.at(free), drags), free, None)
    return (
        jnp.sum(r * r, axis=1),
        jnp.einsum("psci,psc->pci", slope, r),
        jnp.einsum("psci,pscj->pcij", slope, slope),
    )


def _variance(mean_square: np.ndarray) -> np.ndarray:
    """The noise (N^2) of fx and fy, which is one, and of the moment."""
    force = mean_square[..., :2].mean(axis=-1)
    return np.maximum(np.stack([force, force, mean_square[..., 2]], axis=-1), _LEAST_NOISE)


def _jackknife(per_drag: list[list[np.ndarray]]) -> np.ndarray:
    """Standard errors of the transformed numbers."""
    left_out = np.concatenate([_without_one(i, per_drag) for i in range(len(per_drag))])
    count = len(left_out)
    return np.sqrt((count - 1) / count * np.sum((left_out - left_out.mean(axis=0)) ** 2, axis=0))


def _loose(per_drag: list[list[np.ndarray]]) -> np.ndarray:
    """Standard errors of the transformed numbers if each drag were one sample."""
    weights = np.stack([_pull([x.sum(axis=0) for x in s], len(s[0]))[1] for s in per_drag])
    weight = weights.sum(axis=0) + np.finfo(float).tiny * np.eye(weights.shape[-1])
    return np.sqrt(np.abs(np.diag(np.linalg.pinv(weight, rcond=0.0))))


def _without_one(i: int, per_drag: list[list[np.ndarray]]) -> np.ndarray:
    """How far the numbers move when each drag of recording i is left out, by one Gauss-Newton step."""
    others = [_pull([x.sum(axis=0) for x in s], len(s[0])) for j, s in enumerate(per_drag) if j != i]
    pull, weight = _pull([x.sum(axis=0) - x for x in per_drag[i]], len(per_drag[i][0]) - 1)
    pull, weight = pull + sum(p for p, _ in others), weight + sum(w for _, w in others)
    weight = weight + np.finfo(float).tiny * np.eye(weight.shape[-1])
    return -np.linalg.solve(weight, pull[..., None])[..., 0]


def _pull(totals: list[np.ndarray], count: int) -> tuple[np.ndarray, np.ndarray]:
    """The gradient and curvature of the whitened loss, from the sums over `count` drags."""
    square, slope_residual, slope_square = totals
    noise = _variance(square / max(count, 1))
    return (
        np.sum(slope_residual / noise[..., None], axis=-2),
        np.sum(slope_square / noise[..., None, None], axis=-3),
    )


def _estimate(parameter: Parameter, free: Array, error: float, wide: tuple[float, float]) -> Estimate:
    value = parameter.transform.value
    low, high, lowest, highest = (float(value(free + sign * w * error)) for w in wide for sign in (-1, 1))
    slope = abs(float(jax.grad(value)(free)))
    return Estimate(float(value(free)), slope * float(error), (low, high), True, interval99=(lowest, highest))
