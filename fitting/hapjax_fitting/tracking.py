"""Whether an object's poses go on: a tracker that loses it may give the last one again and again."""

import numpy as np

from hapjax import Finding

from .evidence import Evidence
from .motion import ALL, Stuck, jitter_of, jump

_LONG, _MANY = (
    0.05,
    4,
)  # s, and how many steps: what does not change at all for so long, and then jumps, was not seen


def untracked(evidence: Evidence) -> list[Stuck]:
    """When an object's poses stayed the same to the last digit and then jumped: for all fingers, whose places on it are not
    known meanwhile."""
    recording, found = evidence.recording, []
    if recording.pose is None or recording.pose_t is None:
        return found
    for which, name in enumerate(evidence.scene.moving()[: recording.pose.shape[1]]):
        pose, times = recording.pose[:, which], recording.pose_t
        same = np.concatenate([[False], (pose[1:] == pose[:-1]).all(axis=1), [False]])
        for first, last in zip(
            *(np.flatnonzero(x) for x in (~same[:-1] & same[1:], same[:-1] & ~same[1:])), strict=True
        ):
            if last - first < _MANY or times[last] - times[first] < _LONG:
                continue
            leaps = (jump(along, times, int(last), jitter_of(along)) for along in pose[:, :3].T)
            said = next(filter(None, leaps), None)
            if said is not None:
                begin, end = float(times[first]), float(times[last + 1])
                sentence = (
                    f"the pose of {name} stays the same to the last digit from {begin:.4g} to {times[last]:.4g} s, {said}: "
                    "its tracker looks to have lost it"
                )
                finding = Finding("pose", "held poses", sentence, at=begin, count=int(last - first + 1))
                found += [
                    Stuck(finger, ALL, begin, end, finding) for finger in range(evidence.touching.shape[1])
                ]
    return found
