"""Whether what moves is seen to move: encoders that are stuck, fingers that never slip."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d, uniform_filter1d

from hapjax import Finding

from .evidence import Evidence

_LONG = 0.05  # s and
_MANY = 51  # samples, odd: an axis that rests so long while the others move is looked at
_FEW = 20
_JITTER, _MOST_JITTER = (
    1e-5,
    1e-4,
)  # m: what stays within it rests; the step of a coarser encoder is allowed up to the second
_MOVES = 20.0  # jitters: what goes that far moves
_LEAP = 5.0  # times its quick steps: so far an axis jumps only if it was stuck
_SAME = 1e-3  # what normals of one face differ by
_ALWAYS = 0.9  # of a recording
_PULL = 8.0  # times what noise leaves of a normal force: so much more friction is a pull
_AXES = "xyz"


@dataclass(frozen=True)
class Stuck:
    """An axis that looks stuck: which moments of a finger that concerns, and what is said of it."""

    finger: int
    begin: float
    end: float
    finding: Finding


def stuck(evidence: Evidence) -> list[Stuck]:
    """Axes of fingers that stay at one number while the force says that they moved."""
    recording = evidence.recording
    assert recording.hip is not None and recording.hip_t is not None
    found = []
    for finger in range(recording.hip.shape[1]):
        for axis in range(3):
            path = recording.hip[:, finger, axis]
            jitter = _jitter(path)
            for first, last in _rests(path, recording.hip_t, jitter):
                begin, end = float(recording.hip_t[first]), float(recording.hip_t[last])
                said = _jump(path, recording.hip_t, last, jitter)
                if said is None and _moves(evidence, finger, axis, first, last, jitter):
                    said = _contradicted(evidence, finger, axis, begin, end)
                if said is not None:
                    sentence = (
                        f"{_AXES[axis]} of finger {finger} stays at {path[first]:.6g} m from "
                        f"{begin:.4g} to {end:.4g} s, {said}: its encoder looks stuck"
                    )
                    finding = Finding("hip", "stuck encoder", sentence, at=begin, count=last - first + 1)
                    found.append(Stuck(finger, begin, end, finding))
    return found


def unreached(evidence: Evidence) -> list[Finding]:
    """Axes that stay at one number all the time, outside of what is pressed on: stuck, or nothing was touched."""
    recording = evidence.recording
    assert recording.hip is not None and recording.hip_t is not None
    found = []
    for finger in range(recording.hip.shape[1] if evidence.force is not None else 0):
        strongest = float(evidence.strength[:, finger].max())
        if strongest <= 6 * evidence.noise:
            continue
        for axis in range(3):
            path = recording.hip[:, finger, axis]
            jitter = _jitter(path)
            rests = [r for r in _rests(path, recording.hip_t, jitter) if r[1] - r[0] > _ALWAYS * len(path)]
            facing = np.abs(evidence.normal[:, finger, axis]).mean() > 0.5
            if facing and any(_moves(evidence, finger, axis, *rest, jitter) for rest in rests):
                sentence = (
                    f"{_AXES[axis]} of finger {finger} stays at {path[0]:.6g} m all the time, outside of all surfaces, "
                    f"while its force reaches {strongest:.3g} N: its encoder looks stuck, if the scene is in its place"
                )
                found.append(Finding("hip", "stuck encoder", sentence, count=len(path)))
    return found


def _rests(path: np.ndarray, times: np.ndarray, jitter: float) -> Iterator[tuple[int, int]]:
    """The first and last samples of each long rest of one axis' path (T,): but for jitter, or an encoder's one step."""
    still = maximum_filter1d(path, _MANY) - minimum_filter1d(path, _MANY) <= jitter
    same = np.concatenate([[False], maximum_filter1d(still, _MANY), [False]])
    starts, ends = np.flatnonzero(~same[:-1] & same[1:]), np.flatnonzero(same[:-1] & ~same[1:]) - 1
    for first, last in zip(starts.tolist(), ends.tolist(), strict=True):
        if last - first >= _MANY and times[last] - times[first] >= _LONG:
            yield first, last


def _jitter(path: np.ndarray) -> float:
    steps = np.abs(np.diff(path))
    least = float(steps[steps > 0].min()) if steps.any() else 0.0
    return max(_JITTER, min(1.01 * least, _MOST_JITTER))


def _moves(evidence: Evidence, finger: int, axis: int, first: int, last: int, jitter: float) -> bool:
    """Whether the finger's other axes, or objects, move during a rest, so that it ought to as well."""
    recording = evidence.recording
    assert recording.hip is not None and recording.hip_t is not None
    far = _MOVES * jitter
    others = np.delete(recording.hip[first : last + 1, finger], axis, axis=1)
    if np.ptp(others, axis=0).max() > far:
        return True
    if recording.pose is None or recording.pose_t is None:
        return False
    during = (recording.pose_t >= recording.hip_t[first]) & (recording.pose_t <= recording.hip_t[last])
    place = recording.pose[during, :, :3]
    return during.sum() >= _FEW and bool(np.ptp(uniform_filter1d(place, _FEW, axis=0), axis=0).max() > far)


def _jump(path: np.ndarray, times: np.ndarray, last: int, jitter: float) -> str | None:
    """How far one axis jumps as a rest ends; None where it moves on as it always does."""
    if last + 1 >= len(path) or abs(path[last + 1] - path[last]) <= _MOVES * jitter:
        return None
    steps = np.abs(np.diff(path))
    speeds = steps / np.diff(times)
    others = np.delete(speeds, last)
    moves = others[others > 0]
    if len(moves) < _FEW or speeds[last] <= _LEAP * np.quantile(moves, 0.99):
        return None
    return f"then jumps by {1e3 * steps[last]:.3g} mm from one sample to the next"


def _contradicted(evidence: Evidence, finger: int, axis: int, begin: float, end: float) -> str | None:
    """What the force says against a rest of an axis; None where it says nothing."""
    places = evidence.places
    assert evidence.force is not None
    touching = places.depth[:, finger] > 0
    during = (evidence.times >= begin) & (evidence.times <= end)
    world, along = evidence.normal[:, finger], evidence.along[:, finger]
    felt = during & touching
    # A finger that is frozen outside what it presses on is told by its force alone.
    strength = evidence.strength[:, finger]
    outside, idle = during & ~touching & evidence.pressed[:, finger], ~during & ~touching
    if (
        outside.sum() >= max(_FEW, 0.2 * during.sum())
        and np.abs(world[outside, axis]).mean() > 0.5
        and (idle.sum() < _FEW or strength[outside].max() > 5 * np.median(strength[idle]))
    ):
        return f"while it presses with up to {strength[outside].max():.3g} N on what it does not reach"
    if felt.sum() < _FEW:
        return None
    if np.abs(world[felt, axis]).mean() <= 0.5:
        return _pulled(evidence, finger, axis, felt)
    # On one face: at an edge it depends on the way which face it is, and with it the depth.
    normal = places.normal[:, finger]
    face = np.abs(normal - np.median(normal[felt], axis=0)).max(axis=-1) < _SAME
    felt, rest = felt & face, touching & ~during & face
    if felt.sum() < _FEW:
        return None
    depth = places.depth[:, finger]
    whole = rest.sum() < _FEW
    if whole and (touching & ~during).sum() >= _FEW:
        return None  # what there is to compare with is another face
    reference = felt if whole else rest
    stiffness = np.sum(along[reference]) / np.sum(depth[reference])
    off = along - stiffness * depth
    wrong, size, usual = (float(np.sqrt(np.mean(x**2))) for x in (off[felt], along[felt], off[reference]))
    if wrong > max(5 * evidence.blur, 0.15 * size) and (whole or wrong > 3 * usual):
        return f"while the force is off by {wrong:.3g} N from what its depth gives ({size:.3g} N)"
    return None


def _pulled(evidence: Evidence, finger: int, axis: int, felt: np.ndarray) -> str | None:
    """Friction that changes along an axis that rests, on what does not move, but to fade: for that it takes a motion."""
    assert evidence.force is not None
    places = evidence.places
    for first, last in _spells(felt, places.which[:, finger]):
        rows = slice(first, last)
        turn, normal = places.turn[rows, finger], places.normal[rows, finger]
        world = np.einsum("nij,nj->ni", turn, normal)
        if last - first < _FEW or not places.fixed[rows, finger].all() or np.abs(world[:, axis]).max() > 0.1:
            continue
        force = evidence.force[rows, finger]
        along = np.sum(force * world, axis=-1)
        pull = median_filter(force[:, axis] - along * world[:, axis], 5)
        usual = _PULL * _wander(along, places.depth[rows, finger])
        sign = -1.0 if pull[0] < 0 else 1.0
        grown = max(float(np.max(sign * pull - abs(pull[0]))), float(np.max(-sign * pull)))
        if grown > max(5 * evidence.noise, usual, 0.1 * float(np.mean(along))):
            return f"while friction pulls along it by {grown:.3g} N more, or the other way"
    return None


def _wander(along: np.ndarray, depth: np.ndarray) -> float:
    """How far a normal force strays slowly from what its depth gives, N: noise that is not white."""
    given = np.stack([depth, np.gradient(depth), np.ones_like(depth)], axis=-1)
    left = along - given @ np.linalg.lstsq(given, along, rcond=None)[0]
    return float(np.sqrt(np.mean(median_filter(left, 5) ** 2)))


def no_slip(evidence: Evidence) -> list[Finding]:
    """Nothing slid: all friction is that of springs that were stretched from where the fingers first touched."""
    force = evidence.force
    assert force is not None
    places, local = evidence.places, evidence.local()
    travel, pull, depth, along = [], [], [], []
    for finger in range(force.shape[1]):
        for first, last in _spells(places.depth[:, finger] > 0, places.which[:, finger]):
            rows = slice(first, last)
            normal = places.normal[rows, finger]
            way = places.point[rows, finger] - places.point[first, finger]
            push = np.sum(local[rows, finger] * normal, axis=-1)
            travel.append(way - np.sum(way * normal, axis=-1, keepdims=True) * normal)
            pull.append(local[rows, finger] - push[:, None] * normal)
            depth.append(places.depth[rows, finger])
            along.append(push)
    if sum(len(d) for d in depth) < _FEW:
        return []
    u, f, d, n = (np.concatenate(x) for x in (travel, pull, depth, along))
    far, deep = float(np.linalg.norm(u, axis=-1).max()), float(np.mean(d))
    stiffness = float(np.sum(n * d) / np.sum(d**2))
    spring = float(-np.sum(f * u) / max(np.sum(u**2), 1e-300))
    left, whole = (float(np.sqrt(np.mean(np.sum(x**2, axis=-1)))) for x in (f + spring * u, spring * u))
    if far < 0.01 * deep:
        how = f"fingers move along what they touch by no more than {1e3 * far:.3g} mm"
    elif spring > 0.5 * stiffness and left < max(3 * evidence.blur, 0.1 * whole):
        how = f"all {whole:.3g} N of friction are those of springs from where the fingers first touched, {left:.2g} N apart"
    else:
        return []
    sentence = f"nothing slides: {how}; no mu can be told from it but a lower bound"
    return [Finding("force", "no slip", sentence)]


def _spells(touching: np.ndarray, which: np.ndarray):
    """The first sample of each time of contact with one object, and the one after its last."""
    change = np.flatnonzero((touching[1:] != touching[:-1]) | (which[1:] != which[:-1])) + 1
    ends = np.concatenate([[0], change, [len(touching)]])
    for first, last in zip(ends[:-1].tolist(), ends[1:].tolist(), strict=True):
        if touching[first] and last - first > 1:
            yield first, last
