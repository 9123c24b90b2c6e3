"""Recordings as Parquet: see `columns`. Nulls are samples not taken."""

import mmap
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..extras import need
from ..files import replacing
from . import columns
from .content import Content, check_unpacked
from .parquet_pages import unpacked

_DAMAGED = "expected a whole Parquet file, found another format, a damaged one or one that was cut short"


def read(path: Path) -> Content:
    """What a Parquet file holds. A row of a channel is called by its row in the table, counted from 0.

    **Raises:** `hapjax.InputError` for what is no Parquet file or a damaged one, an unknown, missing or repeated column, a
    column without numbers, a part of a sample, a file that would unpack to far more than its size, and where pyarrow is
    not installed; `OSError` if the file cannot be opened.
    """
    parquet = need("pyarrow.parquet", "recording")
    with open(path, "rb") as source:
        header, column = _table(path, parquet, source)
        layout = columns.layout(str(path), header)
        times, clocked = column("t")
        rows, arrays = {}, {}
        for name, places in layout.items():
            numbers, there = _channel(path, name, [header[i] for i in places], column)
            rows[name] = np.flatnonzero(there)
            timeless = rows[name][~clocked[rows[name]]]
            if len(timeless):
                raise InputError(f"{path}, row {timeless[0]}, column t: expected a number, found none")
            if len(rows[name]):
                arrays[f"{name}_t"] = times[rows[name]]
                arrays[name] = numbers
    return Content(arrays, lambda channel, row: f"row {rows[channel][row]}")


def _channel(path: Path, name: str, header: list[str], column) -> tuple[np.ndarray, np.ndarray]:
    """The array of a channel, column by column as they are read, and in which rows there is a sample."""
    values, there = column(header[0])
    numbers = np.empty((int(there.sum()), len(header)))
    for i, part in enumerate(header):
        values, filled = (values, there) if i == 0 else column(part)
        odd = np.flatnonzero(filled != there)
        if len(odd):
            empty = part if there[odd[0]] else header[0]
            problem = f"expected all of a sample of {name} or none of it, found {empty} empty"
            raise InputError(f"{path}, row {odd[0]}: {problem}")
        numbers[:, i] = values[there]
    numbers.shape = columns.shaped(name, numbers).shape  # in place: no copy is made of what owns its numbers
    return numbers, there


def write(arrays: dict[str, np.ndarray], path: Path) -> None:
    """Write arrays as a Parquet file, whole or not at all; every number reads back bit for bit."""
    parquet, arrow = need("pyarrow.parquet", "recording"), need("pyarrow", "recording")
    table = {name: arrow.array(numbers, mask=~taken) for name, numbers, taken in columns.merged(arrays)}
    with replacing(path, "wb") as file:
        # Plain, so that what hardly changes does not shrink to less than may be read.
        parquet.write_table(arrow.table(table), file, compression="none", use_dictionary=False)


def _table(path: Path, parquet, source) -> tuple[list[str], Callable[[str], tuple[np.ndarray, np.ndarray]]]:
    """The columns' names, and how to read one: the numbers, and in which rows there is one."""
    size = path.stat().st_size
    if size == 0:
        raise InputError(f"{path}: expected a Parquet file, found an empty one")
    try:
        _check_end(path, source, size)
        file = parquet.ParquetFile(source)
        schema, about = file.schema_arrow, file.metadata
        _check_columns(path, schema)
        check_unpacked(path, size, max(_unpacked(source, about), 8 * about.num_rows * len(schema)))
        return list(schema.names), partial(_column, path, file)
    except InputError:
        raise
    except Exception as error:  # pyarrow raises a dozen kinds for a damaged file
        raise InputError(f"{path}: {_DAMAGED}") from error


def _check_end(path: Path, source, size: int) -> None:
    """Refuse a table that says far more of itself than it holds: pyarrow makes up to 200 times as many bytes of that."""
    source.seek(-8, os.SEEK_END)
    length, most = int.from_bytes(source.read(4), "little"), size // 32 + 2**16
    if most < length <= size:
        problem = f"expected at most {most} bytes at its end that describe columns and groups of rows, found {length}"
        raise InputError(f"{path}: {problem}; save it in fewer groups")


def _unpacked(source, about) -> int:
    """The bytes that all pages of a file unpack to."""
    total = 0
    with mmap.mmap(source.fileno(), 0, access=mmap.ACCESS_READ) as data:
        for group in (about.row_group(g) for g in range(about.num_row_groups)):
            for chunk in (group.column(c) for c in range(group.num_columns)):
                start = min(chunk.data_page_offset, chunk.dictionary_page_offset or chunk.data_page_offset)
                total += unpacked(data, start, chunk.total_compressed_size)
    return total


def _column(path: Path, file, name: str) -> tuple[np.ndarray, np.ndarray]:
    try:
        column = file.read([name], use_threads=False).column(0)
        there = ~column.is_null().to_numpy()
        if len(there) != file.metadata.num_rows:
            raise ValueError(f"{len(there)} rows of {name}")
        return column.fill_null(0).to_numpy().astype(np.float64, copy=False), there
    except Exception as error:
        raise InputError(f"{path}: {_DAMAGED}") from error


def _check_columns(path: Path, schema) -> None:
    types = need("pyarrow.types", "recording")
    columns.layout(str(path), schema.names)
    for field in schema:
        if not (types.is_floating(field.type) or types.is_integer(field.type)):
            raise InputError(f"{path}, column {field.name}: expected numbers, found {field.type}")
