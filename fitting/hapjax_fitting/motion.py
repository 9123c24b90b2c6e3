"""Whether what moves is seen to move: encoders that are stuck, fingers that never slip."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d, uniform_filter1d

from hapjax import Finding, Recording

from .evidence import Evidence

_LONG = 0.05  # s and
_MANY = 51  # samples, odd: an axis that rests so long while the others move is looked at
FEW = 20
_JITTER, _MOST_JITTER = (
    1e-5,
    1e-4,
)  # m: what stays within it rests; the step of a coarser encoder is allowed up to the second
_MOVES = 20.0  # jitters: what goes that far moves
_LEAP = 5.0  # times its quick steps: so far an axis jumps only if it was stuck
_SAME = 1e-3  # what normals of one face differ by
_ALWAYS = 0.9  # of a recording
_PULL = 8.0  # times what noise leaves of a normal force: so much more friction is a pull
_MOST_STEP = 1e-3  # m, of an encoder
AXES, ALL = "xyz", (0, 1, 2)


@dataclass(frozen=True)
class Stuck:
    """Axes of a finger that look stuck: which moments that concerns, and what is said of it."""

    finger: int
    axes: tuple[int, ...]
    begin: float
    end: float
    finding: Finding

    def covers(self, finger: int, begin: float, end: float) -> bool:
        """Whether it is the whole finger, in all but the ends of a time."""
        within = min(end, self.end) - max(begin, self.begin)
        return finger == self.finger and self.axes == ALL and within > _ALWAYS * (end - begin)


def stuck(evidence: Evidence) -> list[Stuck]:
    """Fingers, or axes of theirs, that stay at one number while the force says that they moved."""
    recording = evidence.recording
    assert recording.hip is not None
    felt = [_Felt(evidence, finger) for finger in range(recording.hip.shape[1])]
    return stuck_by(recording, lambda finger, axes, begin, end: felt[finger].against(axes, begin, end))


def stuck_by(
    recording: Recording, against: Callable[[int, tuple[int, ...], float, float], str | None]
) -> list[Stuck]:
    """Fingers, or axes of theirs, that rest and then jump, or of which a force says something `against` it.

    **Arguments:** `against`, of a finger's axes that rest from one time to another, s: what is said against it.
    """
    assert recording.hip is not None and recording.hip_t is not None
    times, found = recording.hip_t, []
    for finger, axes in product(range(recording.hip.shape[1]), (ALL, (0,), (1,), (2,))):
        path = recording.hip[:, finger, axes]
        jitter = np.array([jitter_of(along) for along in path.T])
        for first, last in rests(path, times, jitter):
            begin, end = float(times[first]), float(times[last])
            if any(each.covers(finger, begin, end) for each in found):
                continue
            jumps = (jump(along, times, last, j) for along, j in zip(path.T, jitter, strict=True))
            said = next(filter(None, jumps), None)
            if said is None and (axes == ALL or moves(recording, finger, axes[0], first, last, jitter[0])):
                said = against(finger, axes, begin, end)
            if said is not None:
                sentence = f"{_stays(finger, axes, path[first])} from {begin:.4g} to {end:.4g} s, {said}: {_looks(axes)}"
                finding = Finding("hip", "stuck encoder", sentence, at=begin, count=last - first + 1)
                found.append(Stuck(finger, axes, begin, end, finding))
    return found


def _stays(finger: int, axes: tuple[int, ...], place: np.ndarray) -> str:
    if axes == ALL:
        return f"all of finger {finger} stays at {', '.join(f'{x:.6g}' for x in place)} m"
    return f"{AXES[axes[0]]} of finger {finger} stays at {place[0]:.6g} m"


def _looks(axes: tuple[int, ...]) -> str:
    return "its encoders look stuck" if axes == ALL else "its encoder looks stuck"


def unreached(evidence: Evidence) -> list[Finding]:
    """Fingers, or axes, that rest all the time outside of what is pressed on: stuck, or nothing was touched."""
    recording = evidence.recording
    assert recording.hip is not None and recording.hip_t is not None
    found = []
    for finger in range(recording.hip.shape[1] if evidence.force is not None else 0):
        strongest = float(evidence.strength[:, finger].max())
        if strongest <= 6 * evidence.noise:
            continue
        for axes in (ALL, (0,), (1,), (2,)):
            path = recording.hip[:, finger, axes]
            jitter = np.array([jitter_of(along) for along in path.T])
            resting = [r for r in rests(path, recording.hip_t, jitter) if r[1] - r[0] > _ALWAYS * len(path)]
            facing = axes != ALL and np.abs(evidence.normal[:, finger, axes[0]]).mean() > 0.5
            moving = any(moves(recording, finger, axes[0], *rest, jitter[0]) for rest in resting)
            if resting and (axes == ALL or (facing and moving)):
                sentence = (
                    f"{_stays(finger, axes, path[0])} all the time, outside of all surfaces, while its force reaches "
                    f"{strongest:.3g} N: {_looks(axes)}, if the scene is in its place"
                )
                found.append(Finding("hip", "stuck encoder", sentence, count=len(path)))
                break
    return found


def rests(path: np.ndarray, times: np.ndarray, jitter: np.ndarray) -> Iterator[tuple[int, int]]:
    """The first and last samples of each long rest of a path (T, n) along all its axes at once: but for jitter (n,), or an
    encoder's one step."""
    spread = maximum_filter1d(path, _MANY, axis=0) - minimum_filter1d(path, _MANY, axis=0)
    still = (spread <= jitter).all(axis=1)
    same = np.concatenate([[False], maximum_filter1d(still, _MANY), [False]])
    starts, ends = np.flatnonzero(~same[:-1] & same[1:]), np.flatnonzero(same[:-1] & ~same[1:]) - 1
    for first, last in zip(starts.tolist(), ends.tolist(), strict=True):
        if last - first >= _MANY and times[last] - times[first] >= _LONG:
            yield first, last


def jitter_of(path: np.ndarray) -> float:
    """Within how many metres an axis (T,) rests."""
    return max(_JITTER, min(1.01 * _step(path), _MOST_JITTER))


def _step(path: np.ndarray) -> float:
    """The least by which an axis (T,) ever moves, m."""
    steps = np.abs(np.diff(path))
    return float(steps[steps > 0].min()) if steps.any() else 0.0


def moves(recording: Recording, finger: int, axis: int, first: int, last: int, jitter: float) -> bool:
    """Whether the finger's other axes, or objects, move during a rest, so that it ought to as well."""
    assert recording.hip is not None and recording.hip_t is not None
    far = _MOVES * jitter
    spans = np.ptp(recording.hip[first : last + 1, finger], axis=0)
    if max(spans[axis - 1], spans[axis - 2]) > far:
        return True
    if recording.pose is None or recording.pose_t is None:
        return False
    during = (recording.pose_t >= recording.hip_t[first]) & (recording.pose_t <= recording.hip_t[last])
    place = recording.pose[during, :, :3]
    return during.sum() >= FEW and bool(np.ptp(uniform_filter1d(place, FEW, axis=0), axis=0).max() > far)


def jump(path: np.ndarray, times: np.ndarray, last: int, jitter: float) -> str | None:
    """How far one axis jumps as a rest ends; None where it moves on as it always does."""
    if last + 1 >= len(path) or abs(path[last + 1] - path[last]) <= _MOVES * jitter:
        return None
    steps = np.abs(np.diff(path))
    speeds = steps / np.diff(times)
    others = np.delete(speeds, last)
    moves = others[others > 0]
    if len(moves) < FEW or speeds[last] <= _LEAP * np.quantile(moves, 0.99):
        return None
    return f"then jumps by {1e3 * steps[last]:.3g} mm from one sample to the next"


class _Felt:
    """What a finger feels, as it can be held against many rests of its path."""

    def __init__(self, evidence: Evidence, finger: int):
        places = evidence.places
        self.evidence, self.finger = evidence, finger
        self.depth, self.normal = places.depth[:, finger], places.normal[:, finger]
        self.touching, self.which = self.depth > 0, places.which[:, finger]
        self.world, self.along = evidence.normal[:, finger], evidence.along[:, finger]
        self.strength, self.pressed = evidence.strength[:, finger], evidence.pressed[:, finger]
        self.face: tuple[np.ndarray, np.ndarray] | None = None

    def against(self, axes: tuple[int, ...], begin: float, end: float) -> str | None:
        """What the force says against a rest of axes; None where it says nothing."""
        times = self.evidence.times
        rows = slice(int(np.searchsorted(times, begin)), int(np.searchsorted(times, end, "right")))
        return self._changed(rows) if axes == ALL else self._against(axes[0], rows)

    def _changed(self, rows: slice) -> str | None:
        """A force that changes, on what does not move, by more than it can within a finger's jitter or an encoder's step.

        It may fade to half: what is pressed on may yield.
        """
        evidence, places, finger = self.evidence, self.evidence.places, self.finger
        path = evidence.recording.hip
        assert evidence.force is not None and path is not None
        if len(self.depth[rows]) < FEW or not places.fixed[rows, finger].all() or not self.pressed.any():
            return None
        steps = [min(_step(along), _MOST_STEP) for along in path[:, finger].T]
        reach = float(np.linalg.norm(np.ptp(places.point[rows, finger], axis=0)) + np.linalg.norm(steps))
        force = median_filter(evidence.force[rows, finger], (5, 1))
        first = force[0]
        faded = np.clip(force @ first / max(float(first @ first), 1e-300), 0.5, 1.0)
        change = float(np.linalg.norm(force - faded[:, None] * first, axis=-1).max())
        typical = float(np.median(self.strength[self.pressed]))
        if change <= max(_PULL * evidence.noise, 2 * self._stiffness() * reach, 0.2 * typical):
            return None
        return f"while its force changes by {change:.3g} N"

    def _stiffness(self) -> float:
        """What the finger's force is over its depth, N/m; where it touches nothing, the scene's."""
        inside = np.where(self.touching, self.depth, 0)
        if not inside.any():
            surfaces = [o.surface for o in self.evidence.scene.object.values() if o.surface is not None]
            return max(float(surface.stiffness) for surface in surfaces)
        return float(np.sum(self.strength * inside) / np.sum(inside**2))

    def _against(self, axis: int, rows: slice) -> str | None:
        """What the force says against a rest of one axis."""
        if (said := self._beyond(axis, rows)) is not None:
            return said
        felt = self.touching[rows]
        if np.count_nonzero(felt) < FEW:
            return None
        facing = np.abs(self.world[rows, axis][felt]).mean() > 0.5
        return self._off(rows) if facing else self._pulled(axis, rows)

    def _beyond(self, axis: int, rows: slice) -> str | None:
        """A finger that is frozen outside what it presses on: its force alone tells."""
        outside = ~self.touching[rows] & self.pressed[rows]
        count = np.count_nonzero(outside)
        if count < max(FEW, 0.2 * len(outside)) or np.abs(self.world[rows, axis][outside]).mean() <= 0.5:
            return None
        idle = ~self.touching
        idle[rows] = False
        most = self.strength[rows][outside].max()
        if idle.sum() >= FEW and most <= 5 * np.median(self.strength[idle]):
            return None
        return f"while it presses with up to {most:.3g} N on what it does not reach"

    def _off(self, rows: slice) -> str | None:
        """A force that is not the one that the depth gives, as it does outside of the rest, or else on average."""
        felt = self.normal[rows][self.touching[rows]]
        # On one face: at an edge it depends on the way which face it is, and with it the depth.
        sums = self._sums(felt[0] if (felt == felt[0]).all() else np.median(felt, axis=0))
        during = sums[rows.stop] - sums[rows.start]
        beside = sums[-1] - during
        if during[0] < FEW:
            return None
        whole = beside[0] < FEW
        if whole and np.count_nonzero(self.touching) - len(felt) >= FEW:
            return None  # what there is to compare with is another face
        reference = during if whole else beside
        stiffness = reference[1] / reference[2]

        def size(sums: np.ndarray, stiffness: float) -> float:
            square = sums[3:] @ (1.0, -2 * stiffness, stiffness**2)
            return float(np.sqrt(max(square, 0.0) / sums[0]))

        wrong, typical = size(during, stiffness), size(during, 0.0)
        far = wrong > max(5 * self.evidence.blur, 0.15 * typical)
        if far and (whole or wrong > 3 * size(reference, stiffness)):
            return f"while the force is off by {wrong:.3g} N from what its depth gives ({typical:.3g} N)"
        return None

    def _sums(self, normal: np.ndarray) -> np.ndarray:
        """Of touches of the face with a normal, up to each moment (N + 1, 6): how many, force along it, depth, and the
        squares and the product of these two."""
        if self.face is None or (self.face[0] != normal).any():
            on = self.touching & (np.abs(self.normal - normal).max(axis=-1) < _SAME)
            force, depth = self.along, self.depth
            rows = np.stack([np.ones_like(depth), force, depth, force**2, force * depth, depth**2], axis=-1)
            self.face = normal, np.cumsum(np.concatenate([np.zeros((1, 6)), rows * on[:, None]]), axis=0)
        return self.face[1]

    def _pulled(self, axis: int, rows: slice) -> str | None:
        """Friction that changes along an axis that rests, on what does not move, but to fade: for that it takes a motion."""
        force, places = self.evidence.force, self.evidence.places
        assert force is not None
        for begin, end in _spells(self.touching[rows], self.which[rows]):
            some = slice(rows.start + begin, rows.start + end)
            world = self.world[some]
            if (
                end - begin < FEW
                or not places.fixed[some, self.finger].all()
                or np.abs(world[:, axis]).max() > 0.1
            ):
                continue
            along = self.along[some]
            pull = median_filter(force[some, self.finger, axis] - along * world[:, axis], 5)
            usual = _PULL * _wander(along, self.depth[some])
            sign = -1.0 if pull[0] < 0 else 1.0
            grown = max(float(np.max(sign * pull - abs(pull[0]))), float(np.max(-sign * pull)))
            if grown > max(5 * self.evidence.noise, usual, 0.1 * float(np.mean(along))):
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
    if sum(len(d) for d in depth) < FEW:
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
