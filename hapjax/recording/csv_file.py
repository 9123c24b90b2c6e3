"""Recordings as CSV: a column `t`, a column a number, and a row for each time that a channel has a sample of.

The header is `t, hip0_x, hip0_y, hip0_z, force0_x, ..., gimbal0, hip1_x, ..., pose_x, ..., pose_qz`, in any
order; several objects are `pose0_x, ..., pose1_x, ...`. Empty cells are samples not taken.
"""

import csv
import re
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..files import replacing
from .channels import CHANNELS

_COLUMN = re.compile(r"(hip|force|gimbal|pose)(\d{0,6})(_\w+)?")


def read(path: Path) -> tuple[dict[str, np.ndarray], Callable[[str, int], str]]:
    """The arrays of a CSV file by name, and how a row of a channel is called: by its line.

    **Raises:** `hapjax.InputError` for an unknown, missing or repeated column, a row of the wrong length, a
    cell that is no number, or a part of a sample; `OSError` if the file cannot be opened.
    """
    with open(path, encoding="utf-8-sig", newline="") as file:
        rows = _rows(path, csv.reader(file))
        head, header = next(rows, (0, []))
        layout = _layout(f"{path}, line {head}" if header else str(path), header)
        clock = header.index("t")
        lines, times, samples = ({name: [] for name in layout} for _ in range(3))
        for line, row in rows:
            if len(row) != len(header):
                raise InputError(f"{path}, line {line}: expected {len(header)} cells, found {len(row)}")
            time = _number(path, line, "t", row[clock])
            for name, columns in layout.items():
                filled = [i for i in columns if row[i]]
                if not filled:
                    continue
                if len(filled) < len(columns):
                    empty = next(header[i] for i in columns if not row[i])
                    problem = f"expected all of a sample of {name} or none of it, found {empty} empty"
                    raise InputError(f"{path}, line {line}: {problem}")
                lines[name].append(line)
                times[name].append(time)
                samples[name].append([_number(path, line, header[i], row[i]) for i in columns])
    arrays = {}
    for name in (name for name in layout if samples[name]):
        shape = (-1, len(CHANNELS[name].parts)) if CHANNELS[name].parts else (-1,)
        arrays[name] = np.array(samples[name]).reshape(len(samples[name]), *shape)
        arrays[f"{name}_t"] = np.array(times[name])
    return arrays, lambda channel, row: f"line {lines[channel][row]}"


def write(arrays: dict[str, np.ndarray], path: Path) -> None:
    """Write arrays as a CSV file, whole or not at all; every number reads back bit for bit."""
    present = [name for name in CHANNELS if name in arrays]
    times = np.unique(np.concatenate([arrays[f"{name}_t"] for name in present]))
    header, rows = ["t"], [[time] for time in times.tolist()]
    for name in present:
        columns = _columns(name, arrays[name].shape[1])
        numbers = arrays[name].reshape(-1, len(columns)).tolist()
        samples = dict(zip(arrays[f"{name}_t"].tolist(), numbers, strict=True))
        header += columns
        for row in rows:
            row += samples.get(row[0], [None] * len(columns))
    with replacing(path) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


def _columns(channel: str, count: int, numbered: bool = False) -> list[str]:
    """The columns of a channel of `count` fingers or objects; an object alone goes without a number."""
    plain = channel == "pose" and count == 1 and not numbered
    parts = [f"_{part}" for part in CHANNELS[channel].parts] or [""]
    return [f"{channel}{'' if plain else i}{part}" for i in range(count) for part in parts]


def _rows(path: Path, reader) -> Iterator[tuple[int, list[str]]]:
    """Line number (from 1) and cells, without the spaces around them, of each row that is not blank."""
    try:
        for row in reader:
            cells = [cell.strip() for cell in row]
            if any(cells):
                yield reader.line_num, cells
    except UnicodeDecodeError:
        raise InputError(f"{path}: expected UTF-8 text, found other bytes") from None
    except csv.Error as error:
        raise InputError(f"{path}, line {reader.line_num}: expected comma-separated cells: {error}") from None


def _layout(where: str, header: list[str]) -> dict[str, list[int]]:
    """At which places of a row the numbers of each channel are, in the order of its array."""
    if not header:
        raise InputError(f"{where}: expected a line of column names, found an empty file")
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
    expected = {channel: _columns(channel, count, numbered) for channel, count in counts.items()}
    known = {"t"}.union(*expected.values())
    if unknown := [name for name in header if name not in known]:
        examples = "t, hip0_x, force0_x, gimbal0, pose_x, pose_qw and the like"
        raise InputError(f"{where}: unknown column {unknown[0]!r}, expected {examples}")
    if missing := known.difference(header):
        first = next(name for names in expected.values() for name in names if name in missing)
        raise InputError(f"{where}: column {first!r} is missing, expected every part of each channel")
    place = {name: i for i, name in enumerate(header)}
    return {channel: [place[name] for name in names] for channel, names in expected.items()}


def _number(path: Path, line: int, column: str, cell: str) -> float:
    try:
        if (
            "_" in cell or not cell.isascii()
        ):  # Python reads 1_000 and other scripts' digits; no program writes them
            raise ValueError
        return float(cell)
    except ValueError:
        where = f"{path}, line {line}, column {column}"
        raise InputError(f"{where}: expected a number, found {cell[:40]!r}") from None
