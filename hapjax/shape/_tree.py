"""The triangle of a mesh that is nearest to a point, found through a tree of boxes."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from .._memory import empty
from ._cones import fill_cones, is_hollow, some_groups, spread_of
from ._lanes import one_by_one
from ._planes import frozen
from ._table import rows, span
from ._topology import SPARE, Topology, pieces
from ._triangle import dot, nearest_part, nearest_point
from ._walk import descend

_CHILDREN, _LEAF = 8, 4  # of a box; triangles in a leaf, at most
MOST = 128
"""So many boxes and leaves are opened at most, and from the nearest triangle so far it goes downhill. It is the nearest of
all, unless the point is all but equally far from many that lie apart, as in the middle of a ball."""


class Tree(eqx.Module):
    """A box has 8 smaller ones, and those of the last rank have triangles.

    `boxes`: each one's 8; those of box n are numbered from 8 n + 1 on. Of each three rows of axes, then how far along these
    the triangles reach at least and at most (m). The axes are the principal ones: where triangles lie about in a plane, a
    box along the axes of the mesh would stand far out of it. `start`: where the triangles of each leaf begin in
    `triangles`, which some zeros follow. Whole numbers are kept as floats. `cones`: of each box the cone of normals of
    `fill_cones`; `None` where the surface is convex.
    """

    boxes: Float[Array, "N 8 5 3"]
    start: Float[Array, "L"]
    triangles: Float[Array, "T"]
    cones: Float[Array, "N 8 4"] | None


def tree_of(
    vertices: np.ndarray, triangles: np.ndarray, across: np.ndarray, normals: Float[Array, "V 3"]
) -> Tree:
    """The tree of a mesh: halves of equal number along the longest axis, and so on.

    **Arguments:** `across` and `normals`: see `topology`.
    """
    count, ranks, dtype = len(triangles), _ranks(len(triangles)), normals.dtype
    order = _halved(_middles(vertices, triangles), 3 * ranks)
    first = [_starts(count, _CHILDREN**rank) for rank in range(1, ranks + 1)]
    boxes, known = empty((boxes_for(count), 5, 3), dtype), np.asarray(normals)
    cones = empty((len(boxes), 4), dtype) if is_hollow(vertices, triangles, across) else None
    spread = None if cones is None else spread_of(vertices, triangles, known)
    triangles, below = triangles[order], 0
    for start in first:
        rank = slice(below, below := below + len(start) - 1)
        _fill_boxes(boxes[rank], vertices, triangles, start)
        if cones is not None and spread is not None:
            fill_cones(cones[rank], boxes[rank], vertices, triangles, start, known, spread)
    del triangles
    every = np.concatenate([order, np.zeros(SPARE, np.int32)])
    parts = (boxes.reshape(-1, _CHILDREN, 5, 3), first[-1][:-1], every)
    boxes, start, numbers = (jnp.asarray(part, dtype) for part in parts)
    return Tree(
        boxes, start, numbers, None if cones is None else jnp.asarray(cones.reshape(-1, _CHILDREN, 4), dtype)
    )


def boxes_for(count: int) -> int:
    """How many boxes, one in the other, the tree of so many triangles has."""
    return sum(_CHILDREN**rank for rank in range(1, _ranks(count) + 1))


def _ranks(count: int) -> int:
    ranks = 1
    while _CHILDREN**ranks * _LEAF < count:
        ranks += 1
    return ranks


def _middles(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """The middles of the triangles (T, 3)."""
    middle = np.empty(triangles.shape)
    for piece in pieces(len(triangles)):
        a, b, c = (vertices[triangles[piece, i]] for i in range(3))
        middle[piece] = (a + b + c) / 3
    return middle


def _halved(points: np.ndarray, times: int) -> np.ndarray:
    """The order of points in which each group lies together, after all groups are halved some times."""
    count = len(points)
    order = np.arange(count, dtype=np.int32)
    for halving in range(times):
        start = _starts(count, 2**halving)
        size = np.empty((len(start) - 1, 3))
        for axis in range(3):
            along = points[order, axis]
            size[:, axis] = np.maximum.reduceat(along, start[:-1]) - np.minimum.reduceat(along, start[:-1])
        group = np.repeat(np.arange(2**halving, dtype=np.int32), np.diff(start))
        along = points[order, np.argmax(size, axis=1).astype(np.int8)[group]]
        order = order[np.lexsort((along, group))]
    return order


def _starts(count: int, groups: int) -> np.ndarray:
    return np.arange(groups + 1) * count // groups


def _fill_boxes(
    boxes: Float[np.ndarray, "G 5 3"],
    vertices: Float[np.ndarray, "V 3"],
    triangles: Int[np.ndarray, "T 3"],
    start: Int[np.ndarray, "G1"],
) -> None:
    """Fill in the axes and the ends of the box about each group of triangles, a few groups at a time."""
    for groups in some_groups(start):
        own = start[groups.start : groups.stop + 1]
        boxes[groups] = _boxes_about(vertices, triangles[own[0] : own[-1]], own - own[0])


def _boxes_about(
    vertices: Float[np.ndarray, "V 3"], triangles: Int[np.ndarray, "T 3"], start: Int[np.ndarray, "G1"]
) -> Float[np.ndarray, "G 5 3"]:
    first, number = start[:-1], np.diff(start)
    owner = np.repeat(np.arange(len(number)), number)

    def mean(x):
        return np.add.reduceat(x, first) / np.maximum(number, 1).reshape(-1, *[1] * (x.ndim - 1))

    middle, square = np.empty((len(triangles), 3)), np.empty((len(triangles), 3, 3))
    for piece in pieces(len(triangles)):
        middle[piece] = vertices[triangles[piece]].mean(axis=1)
    middle = mean(middle)
    for piece in pieces(len(triangles)):
        seen = vertices[triangles[piece]] - middle[owner[piece]][:, None]
        square[piece] = (seen[..., None] * seen[..., None, :]).mean(axis=1)
    axes = np.ascontiguousarray(np.linalg.eigh(mean(square))[1].swapaxes(1, 2))
    del square
    low, high = np.empty((2, len(triangles), 3))
    for piece in pieces(len(triangles)):
        along = np.einsum("tij,tcj->tci", axes[owner[piece]], vertices[triangles[piece]])
        low[piece], high[piece] = along.min(axis=1), along.max(axis=1)
    low, high = np.minimum.reduceat(low, first), np.maximum.reduceat(high, first)
    return np.concatenate([axes, low[:, None], high[:, None]], axis=1)


def nearest(
    tree: Tree,
    topology: Topology,
    query: Float[Array, "3"],
    reach: Float[Array, ""],
    wanted: Bool[Array, ""],
) -> Int[Array, ""]:
    """The triangle nearest to `query`; -1 if none is within `reach` (m), or the search is not `wanted`."""
    square = jnp.min(square_to(tree.boxes[0], query))
    wanted = wanted & (square <= reach**2)
    found = _nearest(frozen((tree, topology)), wanted, *frozen((query, reach)))
    return jnp.where(wanted, found, -1)


def square_to(boxes: Float[Array, "n 5 3"], query: Float[Array, "3"]) -> Float[Array, "n"]:
    """The square of the distance to boxes."""
    along = dot(boxes[:, :3], query[None, None])
    beyond = jnp.maximum(jnp.maximum(boxes[:, 3] - along, along - boxes[:, 4]), 0)
    return dot(beyond, beyond)


@one_by_one
def _nearest(tables, wanted, query, reach):
    tree, topology = tables

    def seen(node):
        return square_to(rows(tree.boxes, node), query)

    def look(some, best, square):
        corners = rows(topology.patches, some)[:, :3] - query[None, None]
        points = jax.vmap(lambda c: nearest_point(c, nearest_part(c)))(corners)
        each = dot(points, points)
        i = jnp.argmin(each)
        return jnp.where(each[i] < square, some[i], best), jnp.minimum(square, each[i])

    best = search(tree, wanted, reach, seen, look, jnp.full((), -1, jnp.int32))
    found = best >= 0
    return jnp.where(found, descend(topology, jnp.maximum(best, 0), query, found)[0], -1)


def search(
    tree: Tree,
    wanted: Bool[Array, ""],
    reach: Float[Array, ""],
    seen: Callable[[Int[Array, ""]], Float[Array, "8"]],
    look: Callable[[Int[Array, "4"], Any, Float[Array, ""]], tuple[Any, Float[Array, ""]]],
    best: Any,
) -> Any:
    """The best of all triangles within `reach` (m), or `best` where there is none.

    Depth first, the nearest box first. What is still to open is a stack of boxes, with their distances
    and the height `below` those out of the same box.

    **Arguments:** `seen(node)`: the squares of the distances to the boxes in a box; `look(some, best, square)`: the
    best of some triangles and the best so far, of which `square` is the squared distance, and the new square.
    """
    inner = tree.boxes.shape[0]
    ranks = 1
    while inner > (_CHILDREN**ranks - 1) // (_CHILDREN - 1):
        ranks += 1
    slots = jnp.arange(_CHILDREN, dtype=jnp.int32)

    def give_up(node, top, below, boxes, squares, best, square):
        # The others out of the same box are farther still.
        return below[top], below, boxes, squares, best, square

    def expand(node, top, below, boxes, squares, best, square):
        each = seen(node)
        number = jnp.sum(each < square).astype(jnp.int32)
        far_to_near, child = lax.sort((-each, _CHILDREN * node + 1 + slots), num_keys=1)
        # Those that are near enough come last: put them first.
        far_to_near, child = (jnp.roll(x, number) for x in (far_to_near, child))
        below = lax.dynamic_update_slice_in_dim(below, jnp.full(_CHILDREN, top), top, 0)
        boxes = lax.dynamic_update_slice_in_dim(boxes, child, top, 0)
        squares = lax.dynamic_update_slice_in_dim(squares, -far_to_near, top, 0)
        return top + number, below, boxes, squares, best, square

    def open_leaf(node, top, below, boxes, squares, best, square):
        first = rows(tree.start, node - inner).astype(jnp.int32)
        some = span(tree.triangles, first, _LEAF).astype(jnp.int32)
        return top, below, boxes, squares, *look(some, best, square)

    def one(carry):
        top, below, boxes, squares, best, square, count = carry
        top = top - 1
        node = boxes[top]
        kind = jnp.where(squares[top] >= square, 0, jnp.where(node < inner, 1, 2))
        ways = (give_up, expand, open_leaf)
        return *lax.switch(kind, ways, node, top, below, boxes, squares, best, square), count + 1

    def goes_on(carry):
        return (carry[0] > 0) & (carry[-1] < MOST)

    depth = _CHILDREN * (ranks + 1)
    top = wanted.astype(jnp.int32)
    # Just beyond the reach, so that what is as far as that is within.
    square = reach**2 * (1 + 4 * jnp.finfo(reach.dtype).eps)
    none, zero = jnp.zeros(depth, jnp.int32), jnp.zeros((), jnp.int32)
    start = (top, none, none, jnp.zeros(depth, reach.dtype), best, square, zero)
    return lax.while_loop(goes_on, one, start)[4]
