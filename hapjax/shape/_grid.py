"""First touch: the first triangle of a mesh that a straight way enters, found through a grid of cells.

The cells are about as large as a triangle. Each has the list of the triangles that it may meet; cells share the rows
of a hash table (Teschner et al. 2003), and a row that serves two cells only has some triangles more to try. So memory
goes with the number of triangles, and a step's time with the cells on its way.
"""

from collections.abc import Iterator
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from .._memory import empty
from ..errors import InputError
from ._table import rows, span
from ._topology import LARGEST, PIECE, SPARE, area_normals, pieces
from ._triangle import area_normal, dot

CHUNK = 4  # triangles at a time
_SUMMED = 2**14  # areas that are summed before they meet the others: the last digit of a cell depends on it
_COLUMNS = 2 * PIECE  # of cells, that are looked at together
_ALLOWED = f"allowed: at most {LARGEST}, with triangles of less unequal sizes"
_PRIMES = (73856093, 19349663, 83492791)
_MARGIN = 0.01  # of a cell: by so much a triangle is taken larger than it is, so that rounding loses none


class Grid(eqx.Module):
    """`low`, `high` (m): corners of the box of all cells; `cell` (m): their edge length. `start`: where each row of the
    hash table begins in `triangles`, which some zeros follow. Whole numbers are kept as floats.
    """

    low: Float[Array, "3"]
    high: Float[Array, "3"]
    cell: Float[Array, ""]
    start: Float[Array, "H"]
    triangles: Float[Array, "E"]


def grid_of(vertices: np.ndarray, triangles: np.ndarray, dtype: Any) -> Grid:
    """The grid of a mesh. **Raises:** `InputError` where its lists are longer than a float32 counts."""
    low, size, cell = _box(vertices, triangles)
    entries, occupied = _filled(vertices, triangles, low, cell, size)
    rows = 1 << int(np.ceil(np.log2(2 * occupied)))
    entries &= rows * LARGEST - 1
    entries.sort()
    entries = entries[: _told_apart(entries)]  # a triangle once a row
    start = empty((rows + 1,), dtype)
    for piece in pieces(rows + 1):
        start[piece] = np.searchsorted(entries, LARGEST * np.arange(piece.start, piece.stop))
    entries &= LARGEST - 1
    owners = empty((len(entries) + SPARE,), dtype)
    owners[: len(entries)], owners[len(entries) :] = entries, 0
    parts = (low, low + size * cell, cell, start, owners)
    return Grid(*(jnp.asarray(part, dtype) for part in parts))


def cells_met(vertices: np.ndarray, triangles: np.ndarray) -> float:
    """About how many cells the triangles of a mesh meet, each counted for itself: so many are in memory while its grid
    is made. It is found in little room."""
    met = 0.0
    with np.errstate(all="ignore"):  # what is not finite or without an area is refused elsewhere
        low, _, cell = _box(vertices, triangles)
        for piece in pieces(len(triangles)):
            columns = _Columns((vertices[triangles[piece]] - low) / cell)
            met += float(np.nansum(columns.number * (1 + 2 * columns.reach)))
    return met


def _box(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """The lowest corner of the box of all cells, how many they are along each axis, and their edge length."""
    sizes = np.empty(len(triangles))
    for piece in pieces(len(triangles)):
        sizes[piece] = np.linalg.norm(area_normals(vertices, triangles[piece]), axis=1)
    area = sum(float(sizes[i : i + _SUMMED].sum()) for i in range(0, len(sizes), _SUMMED)) / 2
    cell = 1.5 * np.sqrt(area / len(triangles))
    low = vertices.min(axis=0) - cell
    return low, np.ceil((vertices.max(axis=0) + cell - low) / cell), cell


def _filled(
    vertices: np.ndarray, triangles: np.ndarray, low: np.ndarray, cell: float, size: np.ndarray
) -> tuple[np.ndarray, int]:
    """For each cell that a triangle may meet `LARGEST` times its hash plus that triangle, and how many cells there are."""
    entries, places, found = [], [], 0
    for piece in pieces(len(triangles)):
        for cells, owner in _cells_of((vertices[triangles[piece]] - low) / cell):
            found += len(owner)
            if found >= LARGEST:
                raise InputError(f"triangles meet {found} cells or more; {_ALLOWED}")
            row = _hash([cells[:, i].astype(np.uint32) for i in range(3)], 2**32)
            entries.append(row.astype(np.int64) * LARGEST + (piece.start + owner))
            # Where these run over, a few cells count as one.
            place = (cells[:, 0] * int(size[1]) + cells[:, 1]) * int(size[2]) + cells[:, 2]
            places.append(np.unique(place))
    every = np.concatenate(places)
    del places
    every.sort()
    occupied = _told_apart(every)
    del every
    return np.concatenate(entries), occupied


def _told_apart(numbers: np.ndarray) -> int:
    """Put the different ones of sorted numbers to the front: how many they are."""
    kept = 1
    for piece in pieces(len(numbers) - 1):
        here = numbers[piece.start + 1 : piece.stop + 1]
        new = here[here != numbers[piece]]
        numbers[kept : kept + len(new)] = new
        kept += len(new)
    return kept


def _hash(cell: list, rows: int) -> Any:
    x, y, z = (c * np.uint32(p) for c, p in zip(cell, _PRIMES, strict=True))
    return (x ^ y ^ z) & np.uint32(rows - 1)


class _Columns:
    """The columns of cells that triangles may meet, lengths in cells: those along the axis that a triangle faces most."""

    def __init__(self, corners: np.ndarray):
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        up = np.argmax(np.abs(normal), axis=1)
        self.axes = np.stack([(up + 1) % 3, (up + 2) % 3, up], axis=1)
        corners = np.take_along_axis(corners, self.axes[:, None], axis=2)
        normal = np.take_along_axis(normal, self.axes, axis=1)
        self.corner = corners[:, 0]
        self.first = np.floor(corners.min(axis=1) - _MARGIN)
        self.last = np.floor(corners.max(axis=1) + _MARGIN)
        self.wide = self.last - self.first + 1
        self.number = self.wide[:, 0] * self.wide[:, 1]
        self.slope = normal[:, :2] / normal[:, 2:]
        self.reach = (0.5 + _MARGIN) * np.abs(self.slope).sum(axis=1) + _MARGIN


def _cells_of(corners: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """All cells that a triangle may meet, each with the triangle, some at a time; lengths in cells.

    They are those of its columns, as far as its plane goes through them.
    """
    columns = _Columns(corners)
    total = columns.number.sum()
    if total >= 2 * LARGEST:
        raise InputError(f"triangles meet {total:.0f} cells; {_ALLOWED}")
    number, wide = columns.number.astype(np.int64), columns.wide.astype(np.int64)
    ends = np.cumsum(number)
    for i in range(0, int(total), _COLUMNS):
        here = np.arange(i, min(i + _COLUMNS, int(total)))
        owner = np.searchsorted(ends, here, "right")
        rank = here - (ends - number)[owner]
        column = columns.first[owner, :2] + np.stack([rank % wide[owner, 0], rank // wide[owner, 0]], axis=1)
        off = columns.slope[owner] * (column + 0.5 - columns.corner[owner, :2])
        height, reach = columns.corner[owner, 2] - np.sum(off, axis=1), columns.reach[owner]
        low = np.maximum(np.floor(height - reach), columns.first[owner, 2])
        high = np.minimum(np.floor(height + reach), columns.last[owner, 2])

        many = np.maximum(high - low + 1, 0).astype(np.int64)
        index = np.repeat(np.arange(len(many)), many)
        rank = np.arange(len(index)) - np.repeat(np.cumsum(many) - many, many)
        cell, owner = np.concatenate([column[index], (low[index] + rank)[:, None]], axis=1), owner[index]
        placed = np.empty_like(cell)
        np.put_along_axis(placed, columns.axes[owner], cell, axis=1)
        yield placed.astype(np.int64), owner


def first_entered(
    grid: Grid,
    patches: Float[Array, "T 5 3"],
    start: Float[Array, "3"],
    end: Float[Array, "3"],
    left: Float[Array, ""],
    wanted: Bool[Array, ""],
) -> tuple[Int[Array, ""], Float[Array, ""]]:
    """The triangle through which the straight way from `start` to `end` enters first, and where as a part of the way.

    The triangle is -1 where there is none, or the search is not `wanted`. Nothing is differentiated here: the caller
    has stopped all gradients.

    **Arguments:** `patches`: see `Topology`; `left` (m): a start on the surface counts where this is 0; else it
    has left the surface, and entries within this distance of the start do not count.
    """
    way = end - start
    walk = _Walk(grid, start, way)
    length = jnp.sqrt(dot(way, way))
    slack = rounding(start, end, grid)

    def enter(patch):
        return _enters(patch[:3], start, end, slack)

    def one(carry):
        cell, upcoming, offset, best, when, _ = carry
        row = _hash([cell[i].astype(jnp.uint32) for i in range(3)], grid.start.shape[0] - 1).astype(jnp.int32)
        first, beyond = span(grid.start, row, 2).astype(jnp.int32)
        number = beyond - first
        places = offset + jnp.arange(CHUNK, dtype=jnp.int32)
        triangles = span(grid.triangles, first + offset, CHUNK).astype(jnp.int32)
        hit, touching, t = jax.vmap(enter)(rows(patches, triangles))
        hit = (places < number) & jnp.where(left > 0, hit & (t * length > left), hit | touching)
        t = jnp.where(hit, t, jnp.inf)
        i = jnp.argmin(t)
        best, when = jnp.where(t[i] < when, triangles[i], best), jnp.minimum(t[i], when)

        more = offset + CHUNK < number
        axis = jnp.argmin(upcoming)
        going = more | ((upcoming[axis] <= walk.last) & (upcoming[axis] <= when))
        crossed = (jnp.arange(3) == axis) & ~more
        cell = jnp.where(crossed, cell + walk.direction, cell)
        upcoming = jnp.where(crossed, upcoming + walk.stride, upcoming)
        return cell, upcoming, jnp.where(more, offset + CHUNK, 0), best, when, going

    none = jnp.full((), -1, jnp.int32)
    zero = jnp.zeros((), jnp.int32)
    begin = (walk.cell, walk.upcoming, zero, none, jnp.full((), jnp.inf, way.dtype), wanted & walk.meets)
    _, _, _, best, when, _ = jax.lax.while_loop(lambda carry: carry[-1], one, begin)
    return best, when


def meets(grid: Grid, start: Float[Array, "3"], end: Float[Array, "3"]) -> Bool[Array, ""]:
    """Whether the straight way from `start` to `end` comes through the box of all cells."""
    return _Walk(grid, start, end - start).meets


def rounding(start: Float[Array, "3"], end: Float[Array, "3"], grid: Grid) -> Float[Array, ""]:
    """A length (m) that is rounding error where these points and the mesh are."""
    largest = jnp.max(jnp.abs(jnp.stack([start, end, grid.low, grid.high])))
    return 32 * jnp.finfo(start.dtype).eps * largest


class _Walk:
    """Amanatides and Woo 1987: the cells on a way, one after another."""

    def __init__(self, grid: Grid, start: Float[Array, "3"], way: Float[Array, "3"]):
        moves = way != 0
        inverse = jnp.where(moves, 1 / jnp.where(moves, way, 1), 0)
        to_low, to_high = (grid.low - start) * inverse, (grid.high - start) * inverse
        between = (grid.low <= start) & (start <= grid.high)
        enter = jnp.where(moves, jnp.minimum(to_low, to_high), jnp.where(between, -jnp.inf, jnp.inf))
        leave = jnp.where(moves, jnp.maximum(to_low, to_high), jnp.inf)
        first = jnp.maximum(jnp.max(enter), 0)
        self.last = jnp.minimum(jnp.min(leave), 1)
        self.meets = first <= self.last
        place = (start + jnp.where(self.meets, first, 0) * way - grid.low) / grid.cell
        size = jnp.round((grid.high - grid.low) / grid.cell)
        self.cell = jnp.clip(jnp.floor(jnp.where(self.meets, place, 0)), 0, size - 1).astype(jnp.int32)
        self.direction = jnp.sign(way).astype(jnp.int32)
        self.stride = grid.cell * jnp.abs(inverse)
        ahead = self.cell + (way > 0).astype(jnp.int32)
        border = grid.low + ahead.astype(way.dtype) * grid.cell
        self.upcoming = jnp.where(moves, (border - start) * inverse, jnp.inf)


def _enters(corners, start, end, slack) -> tuple[Bool[Array, ""], Bool[Array, ""], Float[Array, ""]]:
    """Whether a way enters a triangle from outside, whether it starts on the triangle and goes inside, and where.

    A line's side of an edge is computed from the same numbers for both triangles at the edge (Woop et al. 2013), with
    a tolerance for their rounding: no way gets through between two triangles.
    """
    normal = area_normal(corners)
    size = jnp.sqrt(dot(normal, normal))
    before, after = dot(normal, start - corners[0]), dot(normal, end - corners[0])
    seen, way = corners - start[None], end - start
    following = jnp.roll(seen, -1, axis=0)
    far = jnp.sqrt(dot(seen, seen))
    eps = 32 * jnp.finfo(way.dtype).eps
    wedge = jnp.cross(seen, following)
    beside = eps * jnp.sqrt(dot(way, way)) * far * jnp.roll(far, -1)
    pierced = jnp.all(dot(wedge, way[None]) <= beside)
    edge = jnp.sqrt(dot(following - seen, following - seen))
    above = jnp.all(dot(wedge, normal[None]) >= -slack * size * edge)
    near = slack * size
    inward = (after < 0) & (after < before)
    t = jnp.clip(before / jnp.where(inward, before - after, 1), 0, 1)
    return inward & (before >= -near) & pierced, (after < 0) & (jnp.abs(before) <= near) & above, t
