"""The triangle of a mesh that is nearest to a point, found through a tree of boxes."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ._cones import cones_of, is_hollow
from ._lanes import one_by_one
from ._planes import frozen
from ._table import rows, span
from ._topology import PIECE, SPARE, Topology
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
    `cones_of`; `None` where the surface is convex.
    """

    boxes: Float[Array, "N 8 5 3"]
    start: Float[Array, "L"]
    triangles: Float[Array, "T"]
    cones: Float[Array, "N 8 4"] | None


def tree_of(vertices: np.ndarray, triangles: np.ndarray, beside: Topology, dtype: Any) -> Tree:
    """The tree of a mesh: halves of equal number along the longest axis, and so on."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    middle = (a + b + c) / 3
    del a, b, c
    count, ranks = len(triangles), 1
    while _CHILDREN**ranks * _LEAF < count:
        ranks += 1
    order = np.arange(count)
    for halving in range(3 * ranks):
        start = _starts(count, 2**halving)
        group = np.repeat(np.arange(2**halving), np.diff(start))
        points = middle[order]
        size = np.maximum.reduceat(points, start[:-1]) - np.minimum.reduceat(points, start[:-1])
        key = points[np.arange(count), np.argmax(size, axis=1)[group]]
        order = order[np.lexsort((key, group))]
    first = [_starts(count, _CHILDREN**rank) for rank in range(1, ranks + 1)]
    boxes = [_boxes(vertices, triangles[order], start, dtype) for start in first]
    cones = None
    if is_hollow(vertices, triangles, beside):
        near = [(box, start[:-1]) for box, start in zip(boxes, first, strict=True)]
        every = [cones_of(vertices, triangles[order], beside, *group) for group in near]
        cones = jnp.asarray(np.concatenate(every).reshape(-1, _CHILDREN, 4), dtype)
    parts = (np.concatenate(boxes).reshape(-1, _CHILDREN, 5, 3), first[-1][:-1], np.pad(order, (0, SPARE)))
    boxes, start, numbers = (jnp.asarray(part, dtype) for part in parts)
    return Tree(boxes, start, numbers, cones)


def _starts(count: int, groups: int) -> np.ndarray:
    return np.arange(groups + 1) * count // groups


def _boxes(
    vertices: Float[np.ndarray, "V 3"],
    triangles: Int[np.ndarray, "T 3"],
    start: Int[np.ndarray, "G1"],
    dtype: Any,
) -> Float[np.ndarray, "G 5 3"]:
    """The axes and the ends of the box about each group of triangles, a few groups at a time."""
    boxes = np.empty((len(start) - 1, 5, 3), dtype)
    i, step = 0, max(1, len(boxes) * PIECE // len(triangles))
    while i < len(boxes):
        end = min(i + step, len(boxes))
        end += start[end] == start[end - 1]  # an empty group is told by the next one
        own = start[i : end + 1]
        boxes[i:end] = _boxes_about(vertices[triangles[own[0] : own[-1]]], own - own[0])
        i = end
    return boxes


def _boxes_about(
    corners: Float[np.ndarray, "T 3 3"], start: Int[np.ndarray, "G1"]
) -> Float[np.ndarray, "G 5 3"]:
    first, number = start[:-1], np.diff(start)

    def mean(x):
        return np.add.reduceat(x.mean(axis=1), first) / np.maximum(number, 1).reshape(-1, *[1] * (x.ndim - 2))

    seen = corners - np.repeat(mean(corners), number, axis=0)[:, None]
    axes = np.linalg.eigh(mean(seen[..., None] * seen[..., None, :]))[1].swapaxes(1, 2)
    along = np.einsum("tij,tcj->tci", np.repeat(axes, number, axis=0), corners)
    low = np.minimum.reduceat(along.min(axis=1), first)
    high = np.maximum.reduceat(along.max(axis=1), first)
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
