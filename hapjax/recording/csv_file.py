"""Recordings as CSV: see `columns`. Empty cells are samples not taken."""

import csv
from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import TextIO

import numpy as np

from ..errors import InputError
from ..files import replacing
from . import columns
from .content import Content

_LONGEST = 2**18  # characters: cells take up to 30 times their room


def read(path: Path) -> Content:
    """What a CSV file holds. A row of a channel is called by its line.

    **Raises:** `hapjax.InputError` for an unknown, missing or repeated column, a row of the wrong length or
    one of over 256 KiB, a cell that is no number, or a part of a sample; `OSError` if the file cannot be opened.
    """
    with open(path, encoding="utf-8-sig", newline="") as file:
        rows = _rows(path, file)
        head, header = next(rows, (0, []))
        if not header:
            raise InputError(f"{path}: expected a line of column names, found an empty file")
        layout = columns.layout(f"{path}, line {head}", header)
        clock = header.index("t")
        # Not lists: those take ten times the room.
        lines = {name: array("q") for name in layout}
        times, samples = ({name: array("d") for name in layout} for _ in range(2))
        for line, row in rows:
            if len(row) != len(header):
                raise InputError(f"{path}, line {line}: expected {len(header)} cells, found {len(row)}")
            time = _number(path, line, "t", row[clock])
            for name, places in layout.items():
                filled = [i for i in places if row[i]]
                if not filled:
                    continue
                if len(filled) < len(places):
                    empty = next(header[i] for i in places if not row[i])
                    problem = f"expected all of a sample of {name} or none of it, found {empty} empty"
                    raise InputError(f"{path}, line {line}: {problem}")
                lines[name].append(line)
                times[name].append(time)
                samples[name].extend(_number(path, line, header[i], row[i]) for i in places)
    arrays = {}
    for name in (name for name in layout if samples[name]):
        arrays[name] = columns.shaped(name, np.asarray(samples[name]).reshape(-1, len(layout[name])))
        arrays[f"{name}_t"] = np.asarray(times[name])
    return Content(arrays, lambda channel, row: f"line {lines[channel][row]}")


def write(arrays: dict[str, np.ndarray], path: Path) -> None:
    """Write arrays as a CSV file, whole or not at all; every number reads back bit for bit."""
    table = columns.merged(arrays)
    cells = [
        [number if there else None for number, there in zip(numbers.tolist(), taken.tolist(), strict=True)]
        for _, numbers, taken in table
    ]
    with replacing(path) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow([name for name, _, _ in table])
        writer.writerows(zip(*cells, strict=True))


def _rows(path: Path, file: TextIO) -> Iterator[tuple[int, list[str]]]:
    """Line number (from 1) and cells, without the spaces around them, of each row that is not blank."""
    length = 0

    def lines():
        nonlocal length
        while line := file.readline(_LONGEST + 1):
            length += len(line)
            if length > _LONGEST:
                problem = f"expected a row of at most {_LONGEST} characters, found a longer one"
                raise InputError(f"{path}, line {reader.line_num + 1}: {problem}")
            yield line

    reader = csv.reader(lines())
    try:
        for row in reader:
            length = 0
            cells = [cell.strip() for cell in row]
            if any(cells):
                yield reader.line_num, cells
    except UnicodeDecodeError:
        raise InputError(f"{path}: expected UTF-8 text, found other bytes") from None
    except csv.Error as error:
        raise InputError(f"{path}, line {reader.line_num}: expected comma-separated cells: {error}") from None


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
