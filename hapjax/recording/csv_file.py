"""Recordings as CSV: one time column, one column a number, a row for each time at which any channel has a sample.

The header is `t, hip0_x, hip0_y, hip0_z, force0_x, ..., gimbal0, ..., hip1_x, ..., pose_x, ..., pose_qz`, in any order; several
objects are `pose0_x, ..., pose1_x, ...`. Empty cells are samples not taken.
"""

import csv
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..files import replacing
from .channels import CHANNELS

_COLUMN = re.compile(
    r"(?P<position>hip|force)(?P<finger>0|[1-9]\d?)_[xyz]"
    r"|(?P<angle>gimbal)(?P<joint>0|[1-9]\d?)"
    r"|(?P<pose>pose)(?P<object>0|[1-9]\d?|)_(x|y|z|qw|qx|qy|qz)"
)


def read(path: Path) -> tuple[dict[str, np.ndarray], Callable[[str, int], str]]:
    """The arrays of a CSV file by name, and how a row of one of its channels is called: by its line.

    **Raises:** `hapjax.InputError` for an unknown, missing or repeated column, a row of the wrong length, a cell that is no
    number, or a sample of which only a part is there; `OSError` if the file cannot be opened.
    """
    with open(path, encoding="utf-8-sig", newline="") as file:
        rows = _rows(path, csv.reader(file))
        _, header = next(rows, (0, []))
        if not header:
            raise InputError(f"{path}: expected a header line, found an empty file")
        header = [name.strip() for name in header]
        layout = _layout(path, header)
        samples = {name: [] for name in layout}
        times = {name: [] for name in layout}
        lines = {name: [] for name in layout}
        for line, row in rows:
            if len(row) != len(header):
                raise InputError(
                    f"{path}, line {line}: expected {len(header)} cells as in the header, found {len(row)}"
                )
            time = _number(path, line, "t", row[header.index("t")])
            for name, columns in layout.items():
                cells = [row[i].strip() for i in columns]
                if not any(cells):
                    continue
                samples[name].append([_number(path, line, header[i], row[i]) for i in columns])
                times[name].append(time)
                lines[name].append(line)
    arrays = {}
    for name in (name for name in layout if samples[name]):
        parts = len(CHANNELS[name].parts)
        flat = np.array(samples[name])
        arrays[name] = flat.reshape(len(flat), -1, parts) if parts else flat
        arrays[f"{name}_t"] = np.array(times[name])
    return arrays, lambda channel, row: f"line {lines[channel][row]}"


def write(arrays: dict[str, np.ndarray], path: Path) -> None:
    """Write arrays as a CSV file, whole or not at all; every number reads back bit for bit."""
    present = [name for name in CHANNELS if name in arrays]
    times = np.unique(np.concatenate([arrays[f"{name}_t"] for name in present]))
    header, rows = ["t"], [[time] for time in times.tolist()]
    for name in present:
        columns = _columns(name, arrays[name].shape[1])
        samples = dict(
            zip(arrays[f"{name}_t"].tolist(), arrays[name].reshape(-1, len(columns)).tolist(), strict=True)
        )
        absent = [None] * len(columns)
        header += columns
        for row in rows:
            row += samples.get(row[0], absent)
    with replacing(path) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows(rows)


def _columns(channel: str, count: int, numbered: bool = False) -> list[str]:
    """The columns of a channel of `count` fingers or objects; one object alone goes without a number."""
    plain = channel == "pose" and count == 1 and not numbered
    parts = [f"_{part}" for part in CHANNELS[channel].parts] or [""]
    return [f"{channel}{'' if plain else i}{part}" for i in range(count) for part in parts]


def _rows(path: Path, reader) -> Iterator[tuple[int, list[str]]]:
    """Line number (of the row's last line, from 1) and cells of each row that is not blank."""
    try:
        for row in reader:
            if any(cell.strip() for cell in row):
                yield reader.line_num, row
    except UnicodeDecodeError:
        raise InputError(
            f"{path}, after line {reader.line_num}: expected UTF-8 text, found other bytes"
        ) from None
    except csv.Error as error:
        raise InputError(
            f"{path}, line {reader.line_num}: expected comma-separated cells, found an error: {error}"
        ) from None


def _layout(path: Path, header: list[str]) -> dict[str, list[int]]:
    """Where in a row the numbers of each channel are, in the order of its array."""
    if repeated := [name for name in header if header.count(name) > 1]:
        raise InputError(f"{path}, line 1: expected each column once, found {repeated[0]!r} more than once")
    if "t" not in header:
        raise InputError(f"{path}, line 1: expected a column 't' (seconds), found none")
    counts: dict[str, int] = {}
    for name in header:
        match = _COLUMN.fullmatch(name)
        if name != "t" and match is None:
            raise InputError(
                f"{path}, line 1: unknown column {name!r}, expected t, hip0_x, force0_x, gimbal0, pose_x, pose_qw and their like"
            )
        if match:
            channel = match["position"] or match["angle"] or match["pose"]
            index = int(match["finger"] or match["joint"] or match["object"] or 0)
            counts[channel] = max(counts.get(channel, 0), index + 1)
    layout = {}
    for channel, count in counts.items():
        columns = _columns(channel, count, numbered="pose_x" not in header)
        if missing := [name for name in columns if name not in header]:
            raise InputError(
                f"{path}, line 1: column {missing[0]} is missing, expected all of {', '.join(columns)}"
            )
        layout[channel] = [header.index(name) for name in columns]
    return layout


def _number(path: Path, line: int, column: str, cell: str) -> float:
    try:
        if "_" in cell:  # Python reads 1_000 as a number; no other program writes one so
            raise ValueError
        return float(cell)
    except ValueError:
        found = f"found {cell.strip()[:40]!r}" if cell.strip() else "found an empty cell"
        raise InputError(f"{path}, line {line}, column {column}: expected a number, {found}") from None
