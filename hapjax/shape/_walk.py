"""The god-object's way over a mesh: from triangle to triangle, to where the distance has a minimum."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ._table import rows, span
from ._topology import Topology
from ._triangle import area_normal, dot, nearest_part, nearest_point

CHUNK = 2  # triangles at a time: each is read by itself


def around(topology: Topology, vertex: Int[Array, ""], offset: Int[Array, ""]):
    """`CHUNK` of the triangles about a vertex, from the `offset`-th on (the first again past the end), and their number."""
    first, beyond = span(topology.fan_start, vertex, 2).astype(jnp.int32)
    number = beyond - first
    fan = span(topology.fan, first + offset, CHUNK).astype(jnp.int32)
    return jnp.where(offset + jnp.arange(CHUNK, dtype=jnp.int32) < number, fan, fan[0]), number


def beside(patch: Float[Array, "5 3"], part: Int[Array, ""]) -> tuple[Int[Array, ""], Int[Array, ""]]:
    """The neighbour across an edge, and the vertex at a corner; meaningless for the other parts."""
    neighbour = patch[3, jnp.clip(part - 1, 0, 2)]
    vertex = patch[4, jnp.clip(part - 4, 0, 2)]
    return neighbour.astype(jnp.int32), vertex.astype(jnp.int32)


def descend(
    topology: Topology, triangle: Int[Array, ""], query: Float[Array, "3"], wanted: Bool[Array, ""]
) -> tuple[Int[Array, ""], Float[Array, "5 3"], Int[Array, ""]]:
    """The triangle, its patch, and the part of it, of the locally closest surface point that is downhill from a triangle.

    From an edge the way goes on to the triangle across it, from a corner to the nearest about it, if the surface comes
    nearer there. In a concave corner that ends on the line or point where two or three planes meet: the frictionless
    god-object of Zilles and Salisbury (1995). Over a convex edge it goes on only when the query is beyond it.
    """

    def look(patch):
        corners = patch[:3] - query[None]
        part = nearest_part(corners)
        return nearest_point(corners, part), part

    eps = 8 * jnp.finfo(query.dtype).eps

    def one(carry):
        current, patch, point, part, offset, _ = carry
        across, vertex = beside(patch, part)
        fan, number = around(topology, vertex, offset)
        on_corner = part >= 4
        others = jnp.where(on_corner, fan, across)
        patches = rows(topology.patches, others)
        points, parts = jax.vmap(look)(patches)
        # |point|^2 - |points|^2, as a product, since the difference of the squares would be lost in rounding.
        change = point[None] - points
        gain = dot(change, point[None] + points)
        size = jnp.sqrt(dot(points, points)) + jnp.sqrt(dot(point, point))
        gain = gain - eps * jnp.sqrt(dot(change, change)) * size
        best = jnp.argmax(gain)
        better = gain[best] > 0
        more = on_corner & (offset + CHUNK < number)
        return (
            jnp.where(better, others[best], current),
            jnp.where(better, patches[best], patch),
            jnp.where(better, points[best], point),
            jnp.where(better, parts[best], part),
            jnp.where(better, 0, offset + CHUNK),
            jnp.where(better, parts[best] > 0, more),
        )

    patch = rows(topology.patches, triangle)
    point, part = look(patch)
    begin = (triangle, patch, point, part, jnp.zeros((), jnp.int32), wanted & (part > 0))
    triangle, patch, _, part, _, _ = jax.lax.while_loop(lambda carry: carry[-1], one, begin)
    return triangle, patch, part


def steepest(
    topology: Topology, vertex: Int[Array, ""], query: Float[Array, "3"], wanted: Bool[Array, ""]
) -> Int[Array, ""]:
    """Of the triangles about a vertex the one whose plane the query is deepest below."""

    def depth(patch):
        normal = area_normal(patch[:3])
        return dot(normal, patch[0] - query) / jnp.sqrt(dot(normal, normal))

    def one(carry):
        best, deepest, offset, _ = carry
        fan, number = around(topology, vertex, offset)
        depths = jax.vmap(depth)(rows(topology.patches, fan))
        i = jnp.argmax(depths)
        best = jnp.where(depths[i] > deepest, fan[i], best)
        return best, jnp.maximum(depths[i], deepest), offset + CHUNK, offset + CHUNK < number

    zero = jnp.zeros((), jnp.int32)
    begin = (zero, jnp.full((), -jnp.inf, query.dtype), zero, wanted)
    return jax.lax.while_loop(lambda carry: carry[-1], one, begin)[0]
