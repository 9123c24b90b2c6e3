"""Recordings as a table: a column `t`, a column a number, a row for each time that a channel has a sample of.

The columns are `t, hip0_x, hip0_y, hip0_z, force0_x, ..., gimbal0, hip1_x, ..., pose_x, ..., pose_qz`, in any
order; several objects are `pose0_x, ..., pose1_x, ...`.
"""

import re
from collections import Counter

import numpy as np

from ..errors import InputError
from .channels import CHANNELS

_COLUMN = re.compile(rf"({'|'.join(CHANNELS)})(\d{{0,6}})(_\w+)?")


def layout(where: str, header: list[str]) -> dict[str, list[int]]:
    """At which places of a row the numbers of each channel are, in the order of its array.

    **Raises:** `hapjax.InputError` that begins with `where`, for an unknown, missing or repeated column.
    """
    for name, times in Counter(header).most_common(1):
        if times > 1:
            raise InputError(f"{where}: expected each column once, found {name!r} {times} times")
    if "t" not in header:
        raise InputError(f"{where}: expected a column 't' (seconds), found none")
    matches = [match for name in header if (match := _COLUMN.fullmatch(name))]
    counts: dict[str, int] = {}
    for channel, index, _ in (match.groups() for match in matches):
        last = min(int(index or 0), len(header))  # so that one wild number does not make a million columns
        counts[channel] = max(counts.get(channel, 0), last + 1)
    numbered = any(match[1] == "pose" and match[2] for match in matches)
    expected = {channel: _names(channel, count, numbered) for channel, count in counts.items()}
    known = {"t"}.union(*expected.values())
    if unknown := [name for name in header if name not in known]:
        examples = "t, hip0_x, force0_x, gimbal0, pose_x, pose_qw and the like"
        raise InputError(f"{where}: unknown column {unknown[0][:80]!r}, expected {examples}")
    if missing := known.difference(header):
        first = next(name for names in expected.values() for name in names if name in missing)
        raise InputError(f"{where}: column {first!r} is missing, expected every part of each channel")
    place = {name: i for i, name in enumerate(header)}
    return {channel: [place[name] for name in names] for channel, names in expected.items()}


def shaped(channel: str, numbers: np.ndarray) -> np.ndarray:
    """The rows of a channel's columns, (T, n), as its array."""
    parts = CHANNELS[channel].parts
    return numbers.reshape(len(numbers), -1, len(parts)) if parts else numbers


def merged(arrays: dict[str, np.ndarray]) -> list[tuple[str, np.ndarray, np.ndarray]]:
    """The columns of a recording's table: the name, the numbers (T,), and in which rows there is one (T,)."""
    present = [name for name in CHANNELS if name in arrays]
    times = np.unique(np.concatenate([arrays[f"{name}_t"] for name in present]))
    columns = [("t", times, np.ones(len(times), bool))]
    for channel in present:
        rows = np.searchsorted(times, arrays[f"{channel}_t"])
        taken = np.zeros(len(times), bool)
        taken[rows] = True
        numbers = arrays[channel].reshape(len(rows), -1)
        for i, name in enumerate(_names(channel, arrays[channel].shape[1])):
            column = np.zeros(len(times))
            column[rows] = numbers[:, i]
            columns.append((name, column, taken))
    return columns


def _names(channel: str, count: int, numbered: bool = False) -> list[str]:
    """The columns of a channel of `count` fingers or objects; an object alone goes without a number."""
    plain = channel == "pose" and count == 1 and not numbered
    parts = [f"_{part}" for part in CHANNELS[channel].parts] or [""]
    return [f"{channel}{'' if plain else i}{part}" for i in range(count) for part in parts]
