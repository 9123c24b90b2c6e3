"""Profile likelihood: how much worse the data are explained, the further one number is from its estimate."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hapjax import InputError
from hapjax.progress import following

from .problem import loss_at, stacked_residuals
from .reduced import reduced
from .report import digits
from .result import FitResult
from .section import Images, Section
from .solve import solve
from .transform import Transform
from .whole_body import NAME as WHOLE
from .whole_body import is_whole

CHI95, CHI99 = 3.841459, 6.634897  # of chi-squared with one degree of freedom
_STEPS = (0.5, 1.0, 1.5, 2.0, 2.5, 3.0)  # standard errors
_FURTHER, _FARTHEST = 1.5, 7.0  # times the last step, up to a factor of 1000 for logarithms
_BISECTIONS = 8
_MOST_STEPS = 30
_OF_A_SIDE = len(_STEPS) + 2 * _BISECTIONS  # fits of one side, where the walk need not go further


@dataclass(frozen=True)
class Profile:
    """The profile of one number: `deviance`, twice what the loss grows by over the residuals' variance, at each of
    `values`, all other free numbers being fitted anew.

    `interval95` and `interval99` are where it is below 3.84 and 6.63 (Wilks 1938); `None` at an end: it stays below
    as far as was looked, a factor of 1000. `local95`, the interval of the fit, by its covariance. `better`: the largest drop
    of twice the loss below the fit's own that was met on the way, over the variance; above 0 the fit was not the best one.
    """

    name: str
    values: np.ndarray
    deviance: np.ndarray
    estimate: float
    interval95: tuple[float | None, float | None]
    interval99: tuple[float | None, float | None]
    local95: tuple[float | None, float | None]
    better: float

    def to_dict(self) -> dict[str, Any]:
        """The figures, ready for JSON."""
        return {
            "values": self.values.tolist(),
            "deviance": self.deviance.tolist(),
            "estimate": self.estimate,
            "interval95": list(self.interval95),
            "interval99": list(self.interval99),
            "better": self.better,
        }

    def section(self) -> Section:
        """The intervals as a table, and the plot."""
        size = max(abs(self.estimate - end) for end in (*self.interval95, self.values[0]) if end is not None)
        rows = (
            ("95 %, profile", *_ends(self.interval95, size / 2)),
            ("99 %, profile", *_ends(self.interval99, size / 2)),
            ("95 %, covariance", *_ends(self.local95, size / 2)),
        )
        words = ()
        if self.better > 0.1:
            words = (f"Twice the loss was met {self.better:.3g} lower than in the fit: use more starts.",)
        return Section(f"Profile of {self.name}", words, ("interval", "from", "to"), rows, self._draw)

    def _draw(self) -> Images:
        from .plots_of_fit import of_profile  # matplotlib takes long to import

        return [of_profile(self)]


def check_names(names: Sequence[str], free: Sequence[str], each: Sequence[str] = ()) -> None:
    """Refuse names that the free paths do not give, before a fit has been waited for. **Raises:** `InputError`."""
    paths = [path.split("[")[0] for path in free if not is_whole(path)]
    for name in names:
        if name in each:
            raise InputError(
                f"profile names {name}, which each recording has for itself; allowed: {name} @ RECORDING"
            )
        if re.split(r"\[| @ ", name)[0] not in paths:
            raise _refusal(name, paths, len(paths) < len(free))


def _refusal(name: str, allowed: Sequence[str], whole: bool) -> InputError:
    """What is said of a name without a profile; `whole`: some numbers are free together only."""
    instead = f"; of {WHOLE} there is none: free mass, centre and inertia in its place" if whole else ""
    return InputError(
        f"profile names {name}, which is not free; allowed: {', '.join(allowed) or 'none'}{instead}"
    )


def profile(result: FitResult, name: str, *, progress: bool = False) -> Profile:
    """Walk away from a number's estimate on either side, and fit the others anew at each step.

    The interval so found needs no parabola: it may be lopsided, or open on one side, as that of a mu where nothing
    slips. It takes some 20 fits from near by.

    **Arguments:** `name`, one of `result.parameters`; `progress`: show on the terminal how far it is.

    **Raises:** `InputError` where `name` was not free, or only as a part of a `pseudo_inertia`.
    """
    problem, names = result.problem, [p.name for p in result.problem.parameters]
    if name not in names or name not in result.parameters:
        allowed = [n for n in names if n in result.parameters]
        raise _refusal(name, allowed, len(allowed) < len(names))
    i = names.index(name)
    transform = problem.parameters[i].transform
    centre, free = float(result.free[i]), jnp.asarray(result.free)
    deviation = float(np.sqrt(result.covariance[i, i]))
    step = deviation if 0 < deviation < transform.widest else min(0.25, transform.widest)
    refitted = partial(_refitted, problem=problem, i=i)
    least, variance = float(loss_at(free, problem)), result.variance * float(result.widened[i]) ** 2
    sides, edges = [], []
    with following(2.0 * _OF_A_SIDE, doing=f"profile of {name}", shown=progress) as advance:

        def lost(x: float, near: Array) -> Point:
            point = refitted(x, near)
            advance(f"profile of {name}", 1.0)
            return point

        for side in (-1.0, 1.0):
            walked = _walk(lost, free, centre, side * step, least, variance)
            sides.append(walked)
            edges.append([_edge(lost, walked, centre, least + chi * variance / 2) for chi in (CHI95, CHI99)])
    points = [(x, loss) for x, loss, _ in (*sides[0][::-1], (centre, least, free), *sides[1])]
    low, high = edges
    return Profile(
        name,
        np.array([_value(transform, x, free) for x, _ in points]),
        np.array([2 * (loss - least) / variance for _, loss in points]),
        _value(transform, centre, free),
        (_end(transform, low[0], free), _end(transform, high[0], free)),
        (_end(transform, low[1], free), _end(transform, high[1], free)),
        result.parameters[name].interval95,
        max(0.0, max(2 * (least - loss) / variance for _, loss in points)),
    )


Point = tuple[float, float, Array]  # the number, the least loss there, and all free numbers


def _refitted(x: float, near: Float[Array, " p"], *, problem: Any, i: int) -> Point:
    """The least loss with one number kept at x, from numbers near by."""
    place = jnp.asarray(x, near.dtype)
    if len(near) == 1:
        return x, float(loss_at(place[None], problem)), place[None]
    others = jnp.delete(near, i)
    tolerance = 1e-8 if near.dtype == jnp.float64 else 1e-5
    which = jnp.asarray(i, jnp.int32)
    end = solve(
        _others,
        others[None],
        jnp.zeros(1, int),
        (problem, place, which),
        tolerance,
        tolerance,
        _MOST_STEPS,
        _reduced,
    )
    return x, float(end.loss[0]), _inserted(end.free[0], place, which)


def _others(others: Float[Array, " q"], args: Any) -> Float[Array, " n"]:
    problem, place, which = args
    return stacked_residuals(_inserted(others, place, which), problem)


def _reduced(others: Float[Array, " q"], args: Any) -> tuple[Float[Array, "m q"], Float[Array, " m"]]:
    problem, place, which = args
    matrix, found = reduced(_inserted(others, place, which), problem)
    index = jnp.arange(len(others), dtype=which.dtype)
    return matrix[:, jnp.where(index < which, index, index + 1)], found


def _inserted(others: Float[Array, " q"], place: Array, which: Array) -> Float[Array, " p"]:
    index = jnp.arange(len(others) + 1, dtype=which.dtype)
    rest = others[jnp.minimum(jnp.where(index < which, index, index - 1), len(others) - 1)]
    return jnp.where(index == which, place, rest)


def _walk(
    lost: Callable[..., Point], free: Array, centre: float, step: float, least: float, variance: float
) -> list[Point]:
    """Points further and further out, until the data are explained clearly worse."""
    walked: list[Point] = []
    for far in _STEPS:
        walked.append(lost(centre + far * step, walked[-1][2] if walked else free))
    while walked[-1][1] < least + 1.2 * CHI99 * variance / 2:
        out = _FURTHER * (walked[-1][0] - centre)
        if abs(out) > max(_FARTHEST, 1e3 * abs(step)):
            break
        walked.append(lost(centre + out, walked[-1][2]))
    return walked


def _edge(lost: Callable[..., Point], walked: list[Point], centre: float, most: float) -> float | None:
    """Where the loss passes `most` for the first time, by bisection between two points; `None`: nowhere."""
    outside = next((k for k, (_, loss, _) in enumerate(walked) if loss > most), None)
    if outside is None:
        return None
    out, (low, near) = walked[outside][0], (centre, walked[0][2])
    if outside:
        low, near = walked[outside - 1][0], walked[outside - 1][2]
    for _ in range(_BISECTIONS):
        middle = (low + out) / 2
        _, loss, found = lost(middle, near)
        if loss > most:
            out = middle
        else:
            low, near = middle, found
    return (low + out) / 2


def _value(transform: Transform, x: float, like: Array) -> float:
    return float(transform.value(jnp.asarray(x, like.dtype)))


def _end(transform: Transform, x: float | None, like: Array) -> float | None:
    return None if x is None else _value(transform, x, like)


def _ends(interval: tuple[float | None, float | None], error: float) -> tuple[str, str]:
    low, high = ("open" if end is None else digits(end, error) for end in interval)
    return low, high
