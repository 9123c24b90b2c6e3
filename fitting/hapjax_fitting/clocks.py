"""Whether the clocks of a recording's channels agree."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from jaxtyping import Float
from scipy.signal import savgol_coeffs, savgol_filter

from hapjax import Finding, Mesh, Recording

from .evidence import Evidence
from .motion import Stuck
from .noise import correlation_time

_MOSTLY = 0.2  # of a channel's samples: so many are compared, or it is said
_UNITS = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}
_FAR = 1.0  # s, the largest shift that is looked for, and
_FAR_ON_MESHES, _PART = 0.25, 0.65  # of a recording's length
_COARSE, _FINE = 0.01, 21  # s between the shifts that are tried first, and how many are tried near the best
_SAMPLES = 400  # moments that are looked at
# Of the squares beyond noise: what a shift must bring them down to, and to be told by its size, unless what is left is no
# more than so many times the noise.
_BETTER, _SURE, _CLOSE = 0.4, 0.15, 4.0
# Of a recording's length: a shift beyond it must bring them down to so much, as chance has many to choose from.
_WIDE, _WIDE_BETTER = 0.25, 0.08
# By how much a clock may run fast or slow, over how many s at the beginning that is looked at, and how much less of the
# squares it must leave than a shift.
_FASTEST, _EARLY, _THAN_SHIFTED = 0.06, 60.0, 0.5
_ENOUGH = 0.2  # of the moments
_SCATTER = 5.0  # times what chance makes of so many squares of noise, and of its size where that was estimated from them
_CHANCE = 40.0  # times what one shift saves by chance (its standard error, squared)
_HAZY = 1.5  # times what noise comes to where poses count: so well is that known
_LEAST, _LEAST_OF_POSES = 2e-3, 6e-3  # s, and where noisy poses count: rates are not well known there
_TICK, _LONG_TICK = 5e-4, 8e-3  # s before and after, over which rates are taken, and where noisy poses count
_SMOOTH = 0.015  # s, over which noisy poses are smoothed


def beside(recording: Recording) -> tuple[Recording, list[Finding]]:
    """The recording with times in seconds, and of which channels most samples were outside of the time of the fingers'
    path, so that they are not compared."""
    if recording.hip_t is None:
        return recording, []
    begin, end, found = float(recording.hip_t[0]), float(recording.hip_t[-1]), []
    for name, times in (("force", recording.force_t), ("pose", recording.pose_t)):
        if times is None:
            continue
        inside = int(np.sum((times >= begin) & (times <= end)))
        if inside >= _MOSTLY * len(times):
            continue
        longer = float(times[-1] - times[0]) / max(end - begin, 1e-300)
        factor = next((factor for factor in _UNITS if factor / 2 <= longer <= 2 * factor), None)
        looks = "" if factor is None else f": its times look like {_UNITS[factor]}, expected seconds"
        sentence = (
            f"only {inside} of {len(times)} samples of {name}, from {times[0]:.10g} to {times[-1]:.10g} s, are within the "
            f"time of hip, {begin:.10g} to {end:.10g} s, the others are left out{looks}"
        )
        kind = "clocks apart" if factor is None else "time unit"
        found.append(Finding(name, kind, sentence, count=len(times) - inside))
        recording = replace(recording, **{f"{name}_t": times / (factor or 1.0)})
    return recording, found


def clock_of(evidence: Evidence, suspects: Sequence[Stuck] = ()) -> tuple[Evidence, list[Finding]]:
    """The evidence with clocks that agree, and by how much one was shifted, or ran fast or slow; axes that look stuck say
    nothing of it.

    The forces are compared with those that the fingers' depths give, at all shifts of the channel's clock; the force of a
    surface is a combination of its depth and of depth times its rate (Hunt and Crossley 1975), with the best coefficients.
    """
    hip_t = evidence.recording.hip_t
    assert hip_t is not None
    thin = _thinned(evidence, np.inf)
    used = _free_of(thin, suspects)
    count, level = int(used.sum()), np.ones(1)
    now = _unexplained(thin, used, np.zeros(1), (1.0, 1.0), level)[0]
    before = float(np.sum(now**2))
    fixed = evidence.places.fixed.all()
    explained = (1 + _CHANCE / count if fixed else _HAZY) * count * thin.blur**2
    if before <= explained:
        return evidence, []  # there is nothing to explain
    length = float(hip_t[-1] - hip_t[0])
    mesh = any(isinstance(o.shape, Mesh) for o in evidence.scene.object.values())
    far = min(_FAR_ON_MESHES if mesh else _FAR, _PART * length)
    name, lag, cost = _best(thin, used, far, level)
    moved = _channels(evidence)[name]
    less = _unexplained(thin, used, np.array([lag]), moved, level)[0]
    least = max(_LEAST if fixed else _LEAST_OF_POSES, 2 * length / len(hip_t))
    how = how_shifted(lag, now, less, thin.blur, count, far, length) if abs(lag) >= least else None
    if cost > explained + _SCATTER * np.sqrt(count) * thin.blur**2:
        drifting = _drifting(evidence, suspects, least, 0.0 if how is None else lag, moved)
        if drifting is not None:
            return drifting
    if how is None:
        return evidence, []
    sentence = (
        f"{name} is {how}: with that undone, only {cost / before:.1%} "
        "of what the fingers' depths do not explain of the force is left"
    )
    finding = Finding(name, "shifted clock", sentence)
    return _put_right(evidence, np.full(len(evidence.times), lag), moved), [finding]


def _put_right(evidence: Evidence, lags: Float[np.ndarray, " N"], moved: tuple[float, float]) -> Evidence:
    """The evidence with a clock that was late by lags (s), and its moments by the clock of hip."""
    places = evidence.shifted(moved[0] * lags[None], moved[1] * lags[None])
    return replace(evidence, places=places, times=evidence.times - moved[0] * lags)


def _channels(evidence: Evidence) -> dict[str, tuple[float, float]]:
    """The channels of which a clock may be wrong, and how a shift of each moves hip and pose against the force."""
    channels = {"force": (1.0, 1.0)}
    return channels if evidence.places.fixed.all() else channels | {"hip": (-1.0, 0.0), "pose": (0.0, -1.0)}


def _best(
    evidence: Evidence, used: np.ndarray, far: float, course: Float[np.ndarray, " _"]
) -> tuple[str, float, float]:
    """The channel and the shift (s) that explain the forces best, and the squares (N^2) that are left."""
    found = {
        name: best_shift(partial(_unexplained, evidence, used, moved=moved, course=course), far)
        for name, moved in _channels(evidence).items()
    }
    name = min(found, key=lambda name: found[name][1])
    return name, *found[name]


def _drifting(
    evidence: Evidence, suspects: Sequence[Stuck], least: float, lag: float, how: tuple[float, float]
) -> tuple[Evidence, list[Finding]] | None:
    """The evidence with a clock that ran fast or slow put right, from the recording's beginning on, where it has to be.

    **Arguments:** `least`, the smallest shift at the end (s) that is told; the `lag` of the best shift of all (s), and `how`
    it moves hip and pose: what it leaves is to be beaten by far.
    """
    begin = float(evidence.times[0])
    thin = _thinned(evidence, begin + _EARLY)
    used, length = _free_of(thin, suspects), float(thin.times[-1]) - begin
    if length <= 0:
        return None
    course = (thin.times - begin) / length
    now, shifted = (_unexplained(thin, used, np.array([x]), how, np.ones(1))[0] for x in (0.0, lag))
    name, late, cost = _best(thin, used, _FASTEST * length, course)
    moved, count = _channels(evidence)[name], int(used.sum())
    less = _unexplained(thin, used, np.array([late]), moved, course)[0]
    told = how_shifted(late, now, less, thin.blur, count, _FASTEST * length, length)
    noise = min(thin.blur**2 * count, cost)
    if abs(late) < least or told is None or not told[0].isdigit():
        return None
    if cost - noise > _THAN_SHIFTED * (float(np.sum(shifted**2)) - noise):
        return None
    # Lags are told against the force's own time: one that is late by b t at t ran 1 / (1 - b) times as fast.
    rate = late / (length - late) if name == "force" else late / length
    sentence = (
        f"the clock of {name} runs about {abs(rate):.1%} {'fast' if rate > 0 else 'slow'} against the others: with that "
        f"undone, only {cost / float(np.sum(now**2)):.1%} of what the fingers' depths do not explain of the force is left"
    )
    put_right = _put_right(evidence, late / length * (evidence.times - begin), moved)
    return put_right, [Finding(name, "clock rate", sentence)]


def _thinned(evidence: Evidence, until: float) -> Evidence:
    """A few moments up to a time, with poses of which rates can be told."""
    assert evidence.force is not None
    early = np.flatnonzero(evidence.times <= until)
    few = early[:: -(-len(early) // _SAMPLES)]
    return replace(_smoothed(evidence), times=evidence.times[few], force=evidence.force[few])


def how_shifted(
    lag: float,
    now: Float[np.ndarray, " n"],
    less: Float[np.ndarray, " n"],
    noise: float,
    count: int,
    far: float,
    length: float,
) -> str | None:
    """What a shift (s) is called that leaves `less` (N) of what is not explained `now`; `None`: it may be chance.

    **Arguments:** `noise` (N) of each of `count` numbers, how `far` (s) was looked, and the `length` (s) of the recording.
    """
    before, cost = float(np.sum(now**2)), float(np.sum(less**2))
    of_noise = min(noise**2 * count, cost)
    chance = cost / count * max(correlation_time([less[None, :, None]]), 1)
    part = (cost - of_noise) / max(before - of_noise, 1e-300)
    better = _BETTER if abs(lag) <= _WIDE * length else _WIDE_BETTER
    if before - cost <= _CHANCE * chance or part > better:
        return None
    if part > _SURE and cost > _CLOSE * of_noise:
        return "shifted, by how much is not sure"
    if abs(lag) > far - _COARSE:
        return f"shifted by more than {far - _COARSE:.2g} s, late or early"
    return f"{1e3 * abs(lag):.1f} ms {'late' if lag > 0 else 'early'}"


def _free_of(evidence: Evidence, suspects: Sequence[Stuck]) -> np.ndarray:
    """Of which moments and fingers (N, F) the positions are believed; of all, where there would be few."""
    assert evidence.force is not None
    used = np.ones(evidence.force.shape[:2], bool)
    for each in suspects:
        used[(evidence.times >= each.begin) & (evidence.times <= each.end), each.finger] = False
    return used if used.mean() > _ENOUGH else np.ones_like(used)


def _smoothed(evidence: Evidence) -> Evidence:
    """With poses whose noise is less, so that rates can be told from them."""
    recording = evidence.recording
    if recording.pose is None or recording.pose_t is None or len(recording.pose_t) < 2:
        return evidence
    window = int(_SMOOTH / float(np.median(np.diff(recording.pose_t)))) // 2 * 2 + 1
    if not 5 <= window <= len(recording.pose_t):
        return evidence
    pose = recording.pose.copy()
    turned = np.sum(pose[1:, :, 3:] * pose[:-1, :, 3:], axis=-1) < 0
    pose[1:, :, 3:] *= np.where(np.cumsum(turned, axis=0) % 2 == 1, -1.0, 1.0)[..., None]
    pose = np.asarray(savgol_filter(pose, window, 2, axis=0))
    pose[..., 3:] /= np.linalg.norm(pose[..., 3:], axis=-1, keepdims=True)
    # Of white noise a filter leaves the squares of its coefficients.
    left = np.sum(savgol_coeffs(window, 2) ** 2)
    blur = float(np.sqrt(evidence.noise**2 + left * (evidence.blur**2 - evidence.noise**2)))
    return replace(evidence, recording=replace(recording, pose=pose), blur=blur)


def best_shift(
    left: Callable[[Float[np.ndarray, " L"]], Float[np.ndarray, "L n"]], far: float
) -> tuple[float, float]:
    """The shift (s), up to so `far`, that explains the forces best, the least of those that are about as good, and the
    squares (N^2) of what is `left` with it."""

    def costs(lags: np.ndarray) -> np.ndarray:
        return np.sum(left(lags) ** 2, axis=-1)

    lags = np.linspace(-far, far, 2 * int(np.ceil(far / _COARSE)) + 1)
    found = costs(lags)
    good = lags[found <= 1.1 * found.min()]
    first = good[np.argmin(np.abs(good))]
    step = lags[1] - lags[0]
    for _ in range(2):
        lags = first + np.linspace(-step, step, _FINE)
        found = costs(lags)
        first, step = lags[np.argmin(found)], lags[1] - lags[0]
    return float(first), float(found.min())


def _unexplained(
    evidence: Evidence,
    used: np.ndarray,
    lags: np.ndarray,
    moved: tuple[float, float],
    course: Float[np.ndarray, " _"],
) -> np.ndarray:
    """The parts (L, N F) N of the normal forces that are not explained at each shift (L,) s, which takes a course (N,): 1
    where it is always the same."""
    tick = _TICK if evidence.places.fixed.all() else _LONG_TICK
    assert evidence.force is not None
    whole = lags[:, None] * np.broadcast_to(course, len(evidence.force))
    places = evidence.shifted(moved[0] * whole, moved[1] * whole, tick)
    shape = (len(lags), *evidence.force.shape)
    touching = (places.depth > 0).reshape(shape[:3])
    depth, rate = (np.where(touching, x.reshape(shape[:3]), 0) for x in (places.depth, places.rate))
    normal = np.einsum("nfij,nfj->nfi", places.turn, places.normal).reshape(shape)
    along = np.sum(evidence.force * normal, axis=-1)
    # Out of contact all of a force is unexplained: but for noise, of which it has three parts, and a normal force one.
    whole = np.sqrt(np.maximum(np.sum(evidence.force**2, axis=-1) - 2 * evidence.noise**2, 0))
    wanted = used * np.where(touching, along, whole)
    wanted, depth = wanted.reshape(len(lags), -1), used * depth
    basis = np.stack([depth, depth * rate], axis=-1).reshape(len(lags), -1, 2)
    square = np.einsum("lni,lnj->lij", basis, basis)
    factors = np.einsum(
        "lij,ln,lnj->li", np.linalg.pinv(square, hermitian=True), wanted, basis, optimize=True
    )
    return wanted - np.einsum("lni,li->ln", basis, factors)
