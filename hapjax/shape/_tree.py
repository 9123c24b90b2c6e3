"""The triangle of a mesh that is nearest to a point, found through a tree of boxes."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax
from jaxtyping import Array, Bool, Float, Int

from ._lanes import one_by_one
from ._planes import frozen
from ._table import rows, span
from ._topology import SPARE, Topology
from ._triangle import dot, nearest_part, nearest_point
from ._walk import descend

_CHILDREN, _LEAF = 8, 4  # of a box; triangles in a leaf, at most
MOST = 128
"""So many boxes and leaves are opened at most, and from the nearest triangle so far it goes downhill. It is the nearest of
all, unless the point is all but equally far from many that lie apart, as in the middle of a ball."""


class Tree(eqx.Module):
    """A box has 8 smaller ones, and those of the last rank have triangles.

    `boxes` (m): the low and the high corners of each one's 8; those of box n are numbered from 8 n + 1 on. `start`: where
    the triangles of each leaf begin in `triangles`, which some zeros follow. Whole numbers are kept as floats.
    """

    boxes: Float[Array, "N 2 8 3"]
    start: Float[Array, "L"]
    triangles: Float[Array, "T"]


def tree_of(vertices: np.ndarray, triangles: np.ndarray, dtype: Any) -> Tree:
    """The tree of a mesh: halves of equal number along the longest axis, and so on."""
    corners = vertices[triangles]
    middle, low, high = corners.mean(axis=1), corners.min(axis=1), corners.max(axis=1)
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
    boxes = []
    for rank in range(1, ranks + 1):
        start = _starts(count, _CHILDREN**rank)[:-1]
        ends = np.minimum.reduceat(low[order], start), np.maximum.reduceat(high[order], start)
        boxes.append(np.stack([end.reshape(-1, _CHILDREN, 3) for end in ends], axis=1))
    parts = (np.concatenate(boxes), _starts(count, _CHILDREN**ranks)[:-1], np.pad(order, (0, SPARE)))
    return Tree(*(jnp.asarray(part, dtype) for part in parts))


def _starts(count: int, groups: int) -> np.ndarray:
    return np.arange(groups + 1) * count // groups


def nearest(
    tree: Tree,
    topology: Topology,
    query: Float[Array, "3"],
    reach: Float[Array, ""],
    wanted: Bool[Array, ""],
) -> Int[Array, ""]:
    """The triangle nearest to `query`; -1 if none is within `reach` (m), or the search is not `wanted`."""
    first = tree.boxes[0]
    square = _square_to(jnp.min(first[0], axis=0), jnp.max(first[1], axis=0), query)
    wanted = wanted & (square <= reach**2)
    found = _nearest(frozen((tree, topology)), wanted, *frozen((query, reach)))
    return jnp.where(wanted, found, -1)


def _square_to(low: Float[Array, "*n 3"], high: Float[Array, "*n 3"], query: Float[Array, "*#n 3"]):
    """The square of the distance to boxes."""
    beyond = jnp.maximum(jnp.maximum(low - query, query - high), 0)
    return dot(beyond, beyond)


@one_by_one
def _nearest(tables, wanted, query, reach):
    """Depth first, the nearest box first. What is still to open is a stack of boxes with their distances."""
    tree, topology = tables
    inner = tree.boxes.shape[0]
    ranks = 1
    while inner > (_CHILDREN**ranks - 1) // (_CHILDREN - 1):
        ranks += 1
    slots = jnp.arange(_CHILDREN, dtype=jnp.int32)

    def expand(node, top, boxes, squares, best, square):
        box = rows(tree.boxes, node)
        each = _square_to(box[0], box[1], query[None])
        number = jnp.sum(each < square)
        far_to_near, child = lax.sort((-each, _CHILDREN * node + 1 + slots), num_keys=1)
        # Those that are near enough come last: put them first.
        far_to_near, child = (jnp.roll(x, number) for x in (far_to_near, child))
        boxes = lax.dynamic_update_slice_in_dim(boxes, child, top, 0)
        squares = lax.dynamic_update_slice_in_dim(squares, -far_to_near, top, 0)
        return top + number.astype(jnp.int32), boxes, squares, best, square

    def look(node, top, boxes, squares, best, square):
        first = rows(tree.start, node - inner).astype(jnp.int32)
        some = span(tree.triangles, first, _LEAF).astype(jnp.int32)
        corners = rows(topology.patches, some)[:, :3] - query[None, None]
        points = jax.vmap(lambda c: nearest_point(c, nearest_part(c)))(corners)
        each = dot(points, points)
        i = jnp.argmin(each)
        best = jnp.where(each[i] < square, some[i], best)
        return top, boxes, squares, best, jnp.minimum(square, each[i])

    def one(carry):
        top, boxes, squares, best, square, count = carry
        top = top - 1
        node = boxes[top]
        kind = jnp.where(squares[top] >= square, 0, jnp.where(node < inner, 1, 2))
        ways = (lambda _, *rest: rest, expand, look)
        return *lax.switch(kind, ways, node, top, boxes, squares, best, square), count + 1

    def goes_on(carry):
        return (carry[0] > 0) & (carry[-1] < MOST)

    depth = _CHILDREN * (ranks + 1)
    top = wanted.astype(jnp.int32)
    # Just beyond the reach, so that what is as far as that is within.
    square = reach**2 * (1 + 4 * jnp.finfo(query.dtype).eps)
    start = (
        top,
        jnp.zeros(depth, jnp.int32),
        jnp.zeros(depth, query.dtype),
        jnp.full((), -1, jnp.int32),
        square,
    )
    best = lax.while_loop(goes_on, one, (*start, jnp.zeros((), jnp.int32)))[3]
    found = best >= 0
    return jnp.where(found, descend(topology, jnp.maximum(best, 0), query, found)[0], -1)
