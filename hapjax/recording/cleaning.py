"""Cleaning: what is wrong with the samples of a recording, channel by channel, is repaired or reported, and always said.

Only what cannot be a measurement is dropped. What could be one, and what cannot be put right, is reported.
"""

from array import array
from bisect import bisect_left
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ..errors import InputError
from .channels import CHANNELS, longest_pause
from .content import Content
from .finding import Finding

_DROPPED = "dropped"
_MOST_LATE = 0.1  # of all samples: beyond it the clock itself is in doubt
_FEW = 20  # samples: with fewer there is no usual interval
_REACH = 10.0  # m/s: no finger and nothing held in one goes there and back faster
_GAP = 5.0  # times the usual interval
_JUMP = 1.0  # s
_SLOW = 0.2  # s: no recorder samples fingertips this seldom


def cleaned(path: Path, content: Content) -> Content:
    """What a file holds, cleaned, with a finding for each thing that was noticed.

    **Raises:** `hapjax.InputError` where a channel has no numbers, and where the times go back so often, or jump so far
    ahead, that the clock is in doubt.
    """
    arrays, kept, findings = dict(content.arrays), {}, list(content.findings)
    for channel in CHANNELS:
        if channel not in arrays or f"{channel}_t" not in arrays:
            continue
        values, times = arrays[channel], arrays[f"{channel}_t"]
        if not _is_channel(values, times):
            continue  # to be refused by Recording, which says why
        rows = np.arange(len(times))
        for step in (_numbers, _clock, _held, _lone):
            keep, found = step(channel, _at(values, rows), _at(times, rows))
            findings += found
            if step is _clock and len(rows) - len(keep) > _MOST_LATE * len(rows):
                late = np.ones(len(rows), bool)
                late[keep] = False
                lost = int(rows[np.argmax(late)])
                problem = f"{len(rows) - len(keep)} of {len(rows)} samples are not after those before them"
                raise InputError(
                    f"{path}, {channel}, {content.place(channel, lost)}: expected times that increase; {problem}"
                )
            rows = rows[keep]
            if not len(rows):
                said = ", and ".join(finding.sentence for finding in found)
                raise InputError(f"{path}, {channel}: expected numbers, found none: {said}")
        keep, found = _together(channel, times[rows])
        if len(rows) - len(keep) > _MOST_LATE * len(rows):
            gaps = np.diff(times[rows])
            last = int(np.argmax(gaps))
            problem = (
                f"expected a clock that goes on, found that it jumps ahead by {gaps[last]:.4g} s after it"
            )
            raise InputError(f"{path}, {channel}, {content.place(channel, int(rows[last]))}: {problem}")
        rows, findings = rows[keep], findings + found
        findings += _gaps(channel, times[rows])
        arrays[channel], arrays[f"{channel}_t"], kept[channel] = _at(values, rows), _at(times, rows), rows

    def place(channel: str, row: int) -> str:
        return content.place(channel, int(kept[channel][row]) if channel in kept else row)

    return Content(arrays, place, tuple(findings))


def _at(array: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Some rows, in order; no copy where those are all."""
    return array if len(rows) == len(array) else array[rows]


def _is_channel(values: np.ndarray, times: np.ndarray) -> bool:
    numbers = values.dtype.kind in "fiu" and times.dtype.kind in "fiu"
    return numbers and times.ndim == 1 and values.ndim > 1 and len(values) == len(times) > 0


def _numbers(channel: str, values: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, list[Finding]]:
    """Which samples are numbers, and of poses have an orientation."""
    flat = values.reshape(len(values), -1)
    fine = np.isfinite(times) & np.isfinite(flat).all(axis=1)
    findings = _dropped(channel, "not a number", "are NaN or infinite", times, ~fine)
    if channel == "pose" and values.shape[-1] == 7:
        turned = (values[..., 3:] != 0).any(axis=-1).reshape(len(values), -1).all(axis=1)
        findings += _dropped(
            channel,
            "no orientation",
            "have the quaternion 0, as of what was not tracked",
            times,
            fine & ~turned,
        )
        fine &= turned
    return np.flatnonzero(fine), findings


def _clock(channel: str, values: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, list[Finding]]:
    """The most samples whose times increase."""
    if (times[1:] > times[:-1]).all():
        return np.arange(len(times)), []
    same = np.zeros(len(times), bool)
    flat = values.reshape(len(values), -1)
    same[1:] = (times[1:] == times[:-1]) & (flat[1:] == flat[:-1]).all(axis=1)
    once = np.flatnonzero(~same)
    keep = once[_longest_increase(_at(times, once))]
    late = ~same
    late[keep] = False
    findings = _dropped(
        channel, "repeated sample", "are the sample before once more, at the same time", times, same
    )
    back = "have times that do not follow those before"
    return keep, findings + _dropped(channel, "time goes back", back, times, late)


def _together(channel: str, times: np.ndarray) -> tuple[np.ndarray, list[Finding]]:
    """The most samples between which the clock never jumps ahead far beyond what was recorded."""
    if len(times) < _FEW:
        return np.arange(len(times)), []
    pause = longest_pause(times)  # before there are other arrays as large as those that it makes
    with np.errstate(over="ignore"):
        far = np.flatnonzero(np.diff(times) > pause)
    everything = np.arange(len(times))
    if not len(far):
        return everything, []
    ends = np.concatenate([[0], far + 1, [len(times)]])
    longest = int(np.argmax(np.diff(ends)))
    keep = everything[ends[longest] : ends[longest + 1]]
    lost = np.ones(len(times), bool)
    lost[keep] = False
    what = f"are more than {pause:.4g} s from all others, far longer than was recorded"
    return keep, _dropped(channel, "time jump", what, times, lost)


def _longest_increase(times: np.ndarray) -> np.ndarray:
    """The indices of a longest strictly increasing subsequence (Fredman 1975): to keep them drops the fewest."""
    times = times.astype(np.float64, copy=False)
    # Not lists, which take four times the room. Of each length the place of the least end so far.
    places, before = array("q"), array("q", bytes(8 * len(times)))
    for i, time in enumerate(times.data):
        goes_on = not places or time > times[places[-1]]
        k = len(places) if goes_on else bisect_left(places, time, key=times.item)
        before[i] = places[k - 1] if k else -1
        places[k : k + 1] = array("q", [i])
    i = places[-1] if places else -1
    for k in range(len(places) - 1, -1, -1):
        places[k], i = i, before[i]
    return np.asarray(places)


def _held(channel: str, values: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, list[Finding]]:
    """The samples that a slower sensor made, where a recorder repeated each until the next one came."""
    everything = np.arange(len(times))
    flat = values.reshape(len(values), -1)
    new = np.append(True, (flat[1:] != flat[:-1]).any(axis=1))[: len(flat)]
    if np.count_nonzero(new[1:] & new[:-1]) > np.count_nonzero(new) / 2 + 1:
        return everything, []  # most come once: told without more arrays
    begins = np.flatnonzero(new)
    lengths = np.diff(np.append(begins, len(flat)))
    inner = lengths[1:-1]
    if len(inner) < _FEW:
        return everything, []
    usual = int(np.median(inner))
    if usual < 2 or np.mean(np.abs(inner - usual) <= 1) < 0.8:
        return everything, []
    within = everything - np.repeat(begins, lengths)
    length = np.repeat(lengths, lengths)
    keep = np.flatnonzero((within == 0) | ((length > 1.5 * usual) & (within % usual == 0)))
    rate = 1 / np.median(np.diff(times[keep]))
    sentence = f"each value of {channel} comes about {usual} times in a row: it was measured at {rate:.3g} Hz and held"
    dropped = len(everything) - len(keep)
    return keep, [Finding(channel, "held samples", sentence, "the repetitions were dropped", None, dropped)]


def _lone(channel: str, values: np.ndarray, times: np.ndarray) -> tuple[np.ndarray, list[Finding]]:
    """All samples but those far off both neighbours, where the neighbours agree with each other."""
    everything = np.arange(len(times))
    if channel not in ("hip", "pose") or len(times) < _FEW:
        return everything, []
    flat = values[..., :3].reshape(len(values), -1)
    with np.errstate(over="ignore", invalid="ignore"):
        step, across = _farthest(flat, 1), _farthest(flat, 2)
        off = np.minimum(step[1:], step[:-1])
        far = (off > _REACH * np.diff(times)[1:]) & (off > 20 * np.median(step)) & (across < 0.2 * off)
    lone = np.concatenate([[False], far, [False]])
    what = f"jump away and back faster than {_REACH:g} m/s"
    return np.flatnonzero(~lone), _dropped(channel, "outlier", what, times, lone)


def _farthest(flat: np.ndarray, apart: int) -> np.ndarray:
    """How far samples (T, n) are from those `apart` before, at most; column by column, as that takes little room."""
    far = np.zeros(len(flat) - apart)
    for column in flat.T:
        np.fmax(far, np.abs(column[apart:] - column[:-apart]), out=far)
    return far


def _gaps(channel: str, times: np.ndarray) -> Iterator[Finding]:
    """What the times say that is only reported: where samples are missing, and that the unit is another."""
    if len(times) < _FEW:
        return
    with np.errstate(over="ignore"):
        gaps = np.diff(times)
    usual = float(np.quantile(gaps, 0.9))
    done = "the path between is interpolated" if channel in ("hip", "gimbal") else "only reported"
    long = gaps > _GAP * usual
    jump = long & (gaps > max(_JUMP, 100 * usual))
    for kind, where, what in (
        ("dropout", long & ~jump, "no samples came in {} places, the longest of {:.4g} s"),
        ("time jump", jump, "the clock jumps ahead in {} places, the farthest by {:.4g} s"),
    ):
        if where.any():
            sentence = what.format(int(where.sum()), float(gaps[where].max()))
            at = float(times[:-1][where][0])
            full = (
                f"{channel}: {sentence}, the first at {at:.6g} s; usually {usual:.3g} s lie between samples"
            )
            yield Finding(channel, kind, full, done, at, int(where.sum()))
    middle = float(np.median(gaps))
    if channel == "hip" and middle >= _SLOW:
        unit = "milliseconds" if middle < 200 else "microseconds" if middle < 2e5 else "nanoseconds"
        sentence = f"samples of hip are {middle:.4g} s apart: the times look like {unit}, expected seconds"
        yield Finding(channel, "time unit", sentence)


def _dropped(channel: str, kind: str, what: str, times: np.ndarray, bad: np.ndarray) -> list[Finding]:
    rows = np.flatnonzero(bad)
    if not len(rows):
        return []
    at = float(times[rows[0]])
    sentence = f"{len(rows)} of {len(times)} samples of {channel} {what}, the first at {at:.6g} s"
    return [Finding(channel, kind, sentence, _DROPPED, at, len(rows))]
