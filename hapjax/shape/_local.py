"""The places of a mesh that are locally nearest to a point: where a ball touches it (Johnson and Cohen 2001)."""

import jax
import jax.numpy as jnp
from jax import lax
from jaxtyping import Array, Float, Int

from ._cones import may_face
from ._hold import pseudonormal, unit_normal
from ._lanes import one_by_one
from ._planes import frozen
from ._table import rows
from ._topology import Topology
from ._tree import Tree, search, square_to
from ._triangle import dot, nearest_part, nearest_point
from ._walk import descend

_OVER = 2e-5  # of its distance: what lies less than that above a wall's plane is the wall


def others(
    tree: Tree,
    topology: Topology,
    query: Float[Array, "3"],
    reach: Float[Array, ""],
    outward: Float[Array, "3"],
    side: Float[Array, ""],
) -> Int[Array, "2"]:
    """The triangles of up to two more walls beside the nearest, which is `outward` from `query` (m); -1: there is none.

    A wall is a place that is locally nearest to the query, no farther off than `reach` (m), that the query is outside
    of, and that lies above the planes of the walls found so far: what a ball has below the plane of one belongs to it.

    **Arguments:** `side`: -1 where the query is inside the nearest wall, else 1.
    """
    wanted = dot(outward, outward) <= reach**2
    found = _others(frozen((tree, topology)), wanted, *frozen((query, reach, side * outward, side)))
    return jnp.where(wanted, found, -1)


@one_by_one
def _others(tables, wanted, query, reach, outward, side):
    tree, topology = tables
    # A place `way` from the query is below a wall's plane where way . first three >= the fourth.
    none = jnp.full((3,), -1, jnp.int32)
    first = jnp.append(outward, side * dot(outward, outward))
    second = jnp.array([0, 0, 0, jnp.inf], query.dtype)

    def one(carry):
        found, planes, i, _ = carry
        triangle, way = _nearest_above(tree, topology, query, reach, planes)
        planes = planes.at[1].set(jnp.append(way, dot(way, way)))
        return found.at[i].set(triangle), planes, i + 1, (i < 1) & (triangle >= 0)

    zero = jnp.zeros((), jnp.int32)
    return lax.while_loop(lambda c: c[-1], one, (none[:2], jnp.stack([first, second]), zero, wanted))[0]


def _nearest_above(
    tree: Tree,
    topology: Topology,
    query: Float[Array, "3"],
    reach: Float[Array, ""],
    planes: Float[Array, "2 4"],
) -> tuple[Int[Array, ""], Float[Array, "3"]]:
    """The triangle of the nearest wall above planes, and the way to it."""
    eps = 64 * jnp.finfo(query.dtype).eps
    sizes = jnp.sqrt(dot(planes[:, :3], planes[:, :3]))

    def seen(node):
        boxes = rows(tree.boxes, node)
        faces = may_face(boxes, rows(tree.cones, node), query)
        return jnp.where(faces, square_to(boxes, query), jnp.inf)

    def below(way, square):
        return jnp.any(dot(planes[:, :3], way[None]) >= planes[:, 3] - _OVER * sizes * jnp.sqrt(square))

    def look(some, best, square):
        patches = rows(topology.patches, some)
        corners = patches[:, :3] - query[None, None]
        parts = jax.vmap(nearest_part)(corners)
        ways = jax.vmap(nearest_point)(corners, parts)
        each = dot(ways, ways)
        # Of an edge or a corner the triangles beside it must not come nearer.
        edges = jnp.where(parts >= 4, parts - 4, jnp.maximum(parts - 1, 0))
        last = jnp.where(parts >= 4, (parts + 1) % 3, edges)
        lanes = jnp.arange(some.size, dtype=jnp.int32)
        across = jnp.stack([patches[lanes, 3, edges], patches[lanes, 3, last]]).astype(jnp.int32)
        others = rows(topology.patches, across)[:, :, :3] - query[None, None, None]
        least = jnp.min(jax.vmap(jax.vmap(_square))(others), axis=0)
        normals = jax.vmap(unit_normal)(corners)
        both = normals + jnp.mean(jax.vmap(jax.vmap(unit_normal))(others), axis=0)
        outside = dot(ways, jnp.where((parts == 0)[:, None], normals, both)) < 0
        local = (parts == 0) | (least >= each * (1 - eps))
        each = jnp.where(local & outside & ~jax.vmap(below)(ways, each), each, jnp.inf)
        i = jnp.argmin(each)
        return jnp.where(each[i] < square, some[i], best), jnp.minimum(square, each[i])

    best = search(tree, jnp.ones((), bool), reach, seen, look, jnp.full((), -1, jnp.int32))
    triangle, patch, part = descend(topology, jnp.maximum(best, 0), query, best >= 0)
    way = nearest_point(patch[:3] - query[None], part)
    inside = dot(way, pseudonormal(topology, patch, part)) >= 0
    return jnp.where((best < 0) | inside | below(way, dot(way, way)), -1, triangle), way


def _square(corners: Float[Array, "3 3"]) -> Float[Array, ""]:
    way = nearest_point(corners, nearest_part(corners))
    return dot(way, way)
