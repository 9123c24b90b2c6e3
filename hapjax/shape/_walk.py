"""The god-object's way over a mesh: from triangle to triangle, to where the distance has a minimum."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ._table import rows, span
from ._topology import Topology
from ._triangle import area_normal, dot, nearest_part, nearest_point

CHUNK = 4  # triangles at a time


def around(topology: Topology, vertex: Int[Array, ""], offset: Int[Array, ""]):
    """`CHUNK` of the triangles about a vertex, from the `offset`-th on (the first again past the end), and their number."""
    first, beyond = span(topology.fan_start, vertex, 2).astype(jnp.int32)
    number = beyond - first
    fan = span(topology.fan, first + offset, CHUNK).astype(jnp.int32)
    return jnp.where(offset + jnp.arange(CHUNK, dtype=jnp.int32) < number, fan, fan[0]), number


def beside(
    topology: Topology, triangle: Int[Array, ""], part: Int[Array, ""]
) -> tuple[Int[Array, ""], Int[Array, ""]]:
    """The neighbour across an edge, and the vertex at a corner; meaningless for the other parts."""
    neighbour = rows(topology.neighbours, triangle).astype(jnp.int32)[jnp.clip(part - 1, 0, 2)]
    vertex = rows(topology.triangles, triangle).astype(jnp.int32)[jnp.clip(part - 4, 0, 2)]
    return neighbour, vertex


def descend(
    topology: Topology,
    corners_of: Callable[[Int[Array, ""]], Float[Array, "3 3"]],
    triangle: Int[Array, ""],
    query: Float[Array, "3"],
    wanted: Bool[Array, ""],
) -> tuple[Int[Array, ""], Int[Array, ""]]:
    """The triangle, and the part of it, of the locally closest surface point that is downhill from a triangle.

    From an edge the way goes on to the triangle across it, from a corner to the nearest about it, if the surface comes
    nearer there. In a concave corner that ends on the line or point where two or three planes meet: the frictionless
    god-object of Zilles and Salisbury (1995). Over a convex edge it goes on only when the query is beyond it.
    """

    def look(index):
        corners = corners_of(index) - query[None]
        part = nearest_part(corners)
        return nearest_point(corners, part), part

    eps = 8 * jnp.finfo(query.dtype).eps

    def one(carry):
        current, point, part, offset, _ = carry
        across, vertex = beside(topology, current, part)
        fan, number = around(topology, vertex, offset)
        on_corner = part >= 4
        others = jnp.where(on_corner, fan, across)
        points, parts = jax.vmap(look)(others)
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
            jnp.where(better, points[best], point),
            jnp.where(better, parts[best], part),
            jnp.where(better, 0, offset + CHUNK),
            jnp.where(better, parts[best] > 0, more),
        )

    point, part = look(triangle)
    begin = (triangle, point, part, jnp.zeros((), jnp.int32), wanted & (part > 0))
    triangle, _, part, _, _ = jax.lax.while_loop(lambda carry: carry[-1], one, begin)
    return triangle, part


def steepest(
    topology: Topology,
    corners_of: Callable[[Int[Array, ""]], Float[Array, "3 3"]],
    vertex: Int[Array, ""],
    query: Float[Array, "3"],
    wanted: Bool[Array, ""],
) -> Int[Array, ""]:
    """Of the triangles about a vertex the one whose plane the query is deepest below."""

    def depth(index):
        corners = corners_of(index)
        normal = area_normal(corners)
        return dot(normal, corners[0] - query) / jnp.sqrt(dot(normal, normal))

    def one(carry):
        best, deepest, offset, _ = carry
        fan, number = around(topology, vertex, offset)
        depths = jax.vmap(depth)(fan)
        i = jnp.argmax(depths)
        best = jnp.where(depths[i] > deepest, fan[i], best)
        return best, jnp.maximum(depths[i], deepest), offset + CHUNK, offset + CHUNK < number

    zero = jnp.zeros((), jnp.int32)
    begin = (zero, jnp.full((), -jnp.inf, query.dtype), zero, wanted)
    return jax.lax.while_loop(lambda carry: carry[-1], one, begin)[0]
