"""Shooting at moving objects: from far-off numbers to ones from which single shooting arrives.

A model with wrong numbers drops what was held, and what it then says of the rest of a recording means nothing. So the
recording is cut in windows, each of which begins where the objects were measured to be and as fast as they were; the
windows grow from one step until the recording is a single one. This is multiple shooting (Bock and Plitt 1984, A multiple
shooting algorithm for direct solution of optimal control problems) with the measured states in place of free ones where
windows begin. God-objects are not measured: they ride along from window to window.
"""

from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hapjax import Recording

from .course import Course, course_of, stacked, unseen
from .noise import lost, spread_of
from .parameters import size_at
from .problem import Problem, channels_of, stacked_residuals
from .sharding import gathered
from .solve import keep, tell

EXPLAINED = 2.0  # residuals up to so many times the noise: the model explains the recordings, and
ALONE = 1.2  # up to so many, if one end alone says so, though others were tried
_SHORT, _FEW = 0.05, 5  # s and samples in the shortest windows but those of one step
_GROWTH = 4  # how many times longer the next ones are
_LANES = 8  # rollouts side by side: as many as two cores still speed up
_CUT = 20.0  # residuals beyond so many standard deviations count by their logarithm
_PULL = 0.3  # standard deviations that all residuals must change by, for a change by one to be believed
_NEAR = 1e-3  # of a difference quotient
_FARTHEST = 1.5  # in one descent step
_DAMPING = 10.0 ** np.arange(-3, 5)
_STEPS, _WORTH = 12, 0.01
_ENOUGH = 3  # ends that agree
_APART = 0.1  # of how far off a number may well be: ends that are nearer are one
_FACTORS = np.log(10) * np.array([-1.2, -0.8, -0.4, 0.4, 0.8, 1.2])
_MOST_SCANS = 4


def shots(
    starts: Float[Array, "S p"], problem: Problem, recordings: Sequence[Recording]
) -> Float[Array, "s p"]:
    """Better starts for single shooting: one for each, until one of them explains the recordings or three agree.

    The starts themselves where no poses were measured, or the first of them explains the recordings already; and where the
    objects' first motions are free, because then the recordings are windows themselves.
    """
    windows = [] if problem.starts else _windows(problem, recordings)
    if not windows:
        return starts
    single, found, losses = _uncut(windows[0]), [], []
    for number, start in enumerate(np.asarray(starts, np.float64), 1):
        tell(f"start {number} of at most {len(starts)}, in windows")
        end = start
        if found or not _is_explained(start, problem, single):
            end = _better_of(_shot(number - 1, start, windows, single), start, single)
        found.append(end)
        losses.append(float(_loss(_residuals(end[None], single))[0]))
        if _agree(found, losses, single) or _is_explained(end, problem, single):
            break
    return jnp.asarray(np.array(found), starts.dtype)


def _agree(ends: Sequence[Float[np.ndarray, " p"]], losses: Sequence[float], problem: Problem) -> bool:
    """Whether the best ends are one place: Cauchy's loss alone is much the same wherever nothing is explained."""
    if len(ends) < _ENOUGH:
        return False
    first, *others = np.argsort(losses)[:_ENOUGH].tolist()
    apart = max(np.max(np.abs(ends[first] - ends[i]) / _units(ends[first], problem)) for i in others)
    return losses[others[-1]] < (1 + _WORTH) * losses[first] and bool(apart < _APART)


def _windows(problem: Problem, recordings: Sequence[Recording]) -> list[Problem]:
    """The problem with ever longer windows; none where no course was measured."""
    dt = float(problem.scene.integrator.dt)
    noise = np.repeat([float(problem.noise.position), float(problem.noise.angle)], 3)
    courses: list[list[Course | None]] = []
    for group in problem.groups:
        of_group = []
        for place in gathered(group.place).tolist():
            recording = recordings[place]
            assert recording.hip_t is not None
            times = recording.hip_t[0] + dt * np.arange(group.hips.shape[1])
            of_group.append(course_of(recording, times, noise, group.hips.dtype))
        courses.append(of_group)
    known = [course for of_group in courses for course in of_group if course is not None]
    if not problem.scene.moving() or not known:
        return []
    whole = [
        stacked(
            [
                c or unseen(group.hips.shape[1], len(problem.scene.moving()), group.hips.dtype)
                for c in of_group
            ]
        )
        for of_group, group in zip(courses, problem.groups, strict=True)
    ]
    between = max(float(np.median(np.diff(r.pose_t))) for r in recordings if r.pose_t is not None)
    lengths = [1, round(max(_SHORT, _FEW * between) / dt)]
    while _GROWTH * lengths[-1] < max(group.hips.shape[1] for group in problem.groups):
        lengths.append(_GROWTH * lengths[-1])
    return [_with(problem, [course.windows(n) for course in whole]) for n in lengths]


def _with(problem: Problem, courses: Sequence[Course]) -> Problem:
    groups = (replace(group, course=course) for group, course in zip(problem.groups, courses, strict=True))
    return replace(problem, groups=tuple(groups))


def _uncut(problem: Problem) -> Problem:
    """The same problem with one window a recording: single shooting."""
    return _with(problem, [group.course.uncut() for group in problem.groups if group.course is not None])


def _shot(
    number: int, free: Float[np.ndarray, " p"], windows: Sequence[Problem], single: Problem
) -> Float[np.ndarray, " p"]:
    """Down with short windows, looking about for what gradients do not lead to; then with longer and longer ones."""
    for problem in windows[:2]:
        for _ in range(_MOST_SCANS):
            free = _descended(free, problem, _PULL)
            better = _scanned(free, problem)
            if better is None:
                break
            free = better
        _kept(number, free, single)
    for problem in windows[2:]:
        free = _descended(free, problem, 0.0)
        _kept(number, free, single)
    return free


def _kept(number: int, free: Float[np.ndarray, " p"], single: Problem) -> None:
    """What a start has come to, should the search end here."""
    loss = 0.5 * float(np.sum(_residuals(free[None], single) ** 2))
    if np.isfinite(loss):
        keep(number, loss, np.asarray(free, single.noise.force.dtype))


def _descended(free: Float[np.ndarray, " p"], problem: Problem, pull: float) -> Float[np.ndarray, " p"]:
    """Levenberg-Marquardt on difference quotients, with Cauchy's loss, several dampings tried at once.

    A difference quotient over a thousandth sees through the chatter of contacts. The `pull` towards the beginning keeps
    numbers there that the windows hardly depend on; it is nothing to others.
    """
    unit, begin, damping = _units(free, problem), free, 1e-2
    for _ in range(_STEPS):
        found = _residuals(np.concatenate([free[None], free + _NEAR * np.diag(unit)]), problem)
        weight, slopes = 1 / (1 + (found[0] / _CUT) ** 2), (found[1:] - found[0]) / _NEAR
        strength = pull**2 * found.shape[1]
        away = (free - begin) / unit
        matrix = (slopes * weight) @ slopes.T + strength * np.eye(len(free))
        down = slopes @ (weight * found[0]) + strength * away
        diagonal = np.diag(matrix) + np.finfo(float).tiny
        steps = np.stack(
            [np.linalg.lstsq(matrix + np.diag(d * diagonal), -down)[0] for d in damping * _DAMPING]
        )
        trials = free + unit * np.clip(steps, -_FARTHEST, _FARTHEST)
        losses = _loss(_residuals(trials, problem))
        losses += strength / 2 * np.sum(((trials - begin) / unit) ** 2, axis=1)
        loss, best = _loss(found[:1])[0] + strength / 2 * np.sum(away**2), int(np.argmin(losses))
        if not losses[best] < loss:
            break
        free, damping = trials[best], float(np.clip(damping * _DAMPING[best], 1e-6, 1e3))
        if losses[best] > (1 - _WORTH) * loss:
            break
    return free


def _scanned(free: Float[np.ndarray, " p"], problem: Problem) -> Float[np.ndarray, " p"] | None:
    """One number moved by a factor, up to 16 either way, that makes the loss smaller; `None`: there is none."""
    moves = np.concatenate([[0 * free], *(np.outer(_FACTORS, row) for row in np.diag(_units(free, problem)))])
    losses = np.concatenate([_loss(_residuals(x, problem)) for x in _in_lanes(free + moves)])
    best = int(np.argmin(losses))
    return (free + moves)[best] if losses[best] < (1 - _WORTH) * losses[0] else None


def _units(free: Float[np.ndarray, " p"], problem: Problem) -> Float[np.ndarray, " p"]:
    """A unit for each number: how far off it may well be."""
    return np.array([size_at(p, float(x)) for p, x in zip(problem.parameters, free, strict=True)])


def _loss(residuals: Float[np.ndarray, "S n"]) -> Float[np.ndarray, " S"]:
    """Cauchy's loss; infinite where a residual is not a number."""
    loss = 0.5 * _CUT**2 * np.sum(np.log1p((residuals / _CUT) ** 2), axis=1)
    return np.where(np.isfinite(loss), loss, np.inf)


def _in_lanes(points: Float[np.ndarray, "S p"]) -> list[np.ndarray]:
    return [points[i : i + _LANES] for i in range(0, len(points), _LANES)]


def _residuals(points: Float[np.ndarray, "S p"], problem: Problem) -> Float[np.ndarray, "S n"]:
    """The whitened residuals at several points."""
    found = []
    for some in _in_lanes(points):
        full = np.concatenate([some, np.repeat(some[-1:], _LANES - len(some), axis=0)])
        lanes = _side_by_side(jnp.asarray(full, problem.noise.force.dtype), problem)
        found.append(gathered(lanes).astype(np.float64)[: len(some)])
    return np.concatenate(found)


@jax.jit
def _side_by_side(points: Float[Array, "L p"], problem: Problem) -> Float[Array, "L n"]:
    return jax.vmap(stacked_residuals, in_axes=(0, None))(points, problem)


def _better_of(one: np.ndarray, other: np.ndarray, problem: Problem) -> np.ndarray:
    losses = _loss(_residuals(np.stack([one, other]), problem))
    return one if losses[0] <= losses[1] else other


def _is_explained(free: np.ndarray, problem: Problem, single: Problem) -> bool:
    channels = channels_of(_residuals(free[None], single)[0], problem)
    size, _ = spread_of(channels, None, problem.fitted())
    return max(size.values()) < EXPLAINED and not any(lost(r).any() for _, r in channels)
