"""Recordings as Parquet: see `columns`. Nulls are samples not taken."""

from pathlib import Path

import numpy as np

from ..errors import InputError
from ..extras import need
from ..files import replacing
from . import columns
from .content import Content, check_unpacked


def read(path: Path) -> Content:
    """What a Parquet file holds. A row of a channel is called by its row in the table, counted from 0.

    **Raises:** `hapjax.InputError` for what is no Parquet file or a damaged one, an unknown, missing or repeated column, a
    column without numbers, a part of a sample, a file that would unpack to far more than its size, and where pyarrow is
    not installed; `OSError` if the file cannot be opened.
    """
    parquet = need("pyarrow.parquet", "recording")
    with open(path, "rb") as source:
        header, table = _table(path, parquet, source)
    layout = columns.layout(str(path), header)
    times, clocked = table[header.index("t")]
    rows, arrays = {}, {}
    for name, places in layout.items():
        there = np.stack([table[i][1] for i in places])
        part = np.flatnonzero(there.any(axis=0) & ~there.all(axis=0))
        if len(part):
            empty = next(header[i] for i in places if not table[i][1][part[0]])
            problem = f"expected all of a sample of {name} or none of it, found {empty} empty"
            raise InputError(f"{path}, row {part[0]}: {problem}")
        rows[name] = np.flatnonzero(there[0])
        timeless = rows[name][~clocked[rows[name]]]
        if len(timeless):
            raise InputError(f"{path}, row {timeless[0]}, column t: expected a number, found none")
        if len(rows[name]):
            arrays[f"{name}_t"] = times[rows[name]]
            numbers = np.stack([table[i][0][rows[name]] for i in places], axis=-1)
            arrays[name] = columns.shaped(name, numbers)
    return Content(arrays, lambda channel, row: f"row {rows[channel][row]}")


def write(arrays: dict[str, np.ndarray], path: Path) -> None:
    """Write arrays as a Parquet file, whole or not at all; every number reads back bit for bit."""
    parquet, arrow = need("pyarrow.parquet", "recording"), need("pyarrow", "recording")
    table = {name: arrow.array(numbers, mask=~taken) for name, numbers, taken in columns.merged(arrays)}
    with replacing(path, "wb") as file:
        parquet.write_table(arrow.table(table), file)


def _table(path: Path, parquet, source) -> tuple[list[str], list[tuple[np.ndarray, np.ndarray]]]:
    """The columns' names, and of each the numbers and in which rows there is one."""
    size = path.stat().st_size
    if size == 0:
        raise InputError(f"{path}: expected a Parquet file, found an empty one")
    try:
        file = parquet.ParquetFile(source)
        schema, about = file.schema_arrow, file.metadata
        _check_columns(path, schema)
        said = sum(about.row_group(g).total_byte_size for g in range(about.num_row_groups))
        check_unpacked(path, size, max(said, 8 * about.num_rows * len(schema)))
        found = []
        for name in schema.names:
            column = file.read([name], use_threads=False).column(0)
            there = ~column.is_null().to_numpy()
            if len(there) != about.num_rows:
                raise ValueError(f"{len(there)} rows of {name}")
            found.append((column.fill_null(0).to_numpy().astype(np.float64), there))
        return list(schema.names), found
    except InputError:
        raise
    except Exception as error:  # pyarrow raises a dozen kinds for a damaged file
        problem = (
            "expected a whole Parquet file, found another format, a damaged one or one that was cut short"
        )
        raise InputError(f"{path}: {problem}") from error


def _check_columns(path: Path, schema) -> None:
    types = need("pyarrow.types", "recording")
    columns.layout(str(path), schema.names)
    for field in schema:
        if not (types.is_floating(field.type) or types.is_integer(field.type)):
            raise InputError(f"{path}, column {field.name}: expected numbers, found {field.type}")
