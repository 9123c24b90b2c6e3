"""Which triangle of a mesh holds a touching point that moved straight from one place to another."""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ._grid import Grid, first_entered, meets, rounding
from ._lanes import one_by_one
from ._table import rows
from ._topology import Topology
from ._triangle import area_normal, dot, nearest_point
from ._walk import beside, descend

CornersOf = Callable[[Int[Array, ""]], Float[Array, "3 3"]]


def unit_normal(corners: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """The outward normal of a triangle, which has an area."""
    normal = area_normal(corners)
    return normal / jnp.sqrt(dot(normal, normal))


def pseudonormal(
    topology: Topology, corners_of: CornersOf, triangle: Int[Array, ""], part: Int[Array, ""]
) -> Float[Array, "3"]:
    """The unit vector whose product with (point - query) is above 0 where the query is inside, `point` being the closest
    surface point and lying in this part of this triangle (Baerentzen and Aanaes 2005)."""
    across, vertex = beside(topology, triangle, part)
    own = unit_normal(corners_of(triangle))
    both = own + unit_normal(corners_of(across))
    size = jnp.sqrt(dot(both, both))
    folded = size < 1e-6
    on_edge = jnp.where(folded, own, both / jnp.where(folded, 1, size))
    return jnp.where(part == 0, own, jnp.where(part < 4, on_edge, rows(topology.vertex_normals, vertex)))


def in_tables(tables: tuple[Topology, Float[Array, "V 3"]]) -> CornersOf:
    """What finds the corners of a triangle."""
    topology, vertices = tables
    return lambda triangle: rows(vertices, rows(topology.triangles, triangle).astype(jnp.int32))


def hold(
    grid: Grid,
    tables: tuple[Topology, Float[Array, "V 3"]],
    start: Float[Array, "3"],
    end: Float[Array, "3"],
    triangle: Int[Array, ""],
    in_contact: Bool[Array, ""],
) -> tuple[Int[Array, ""], Bool[Array, ""]]:
    """The triangle that holds a point on its way from `start` to `end`, and whether one does.

    In contact the god-object slides downhill from `triangle` to where it is locally closest to `end`. Out of contact
    it goes the straight way to the first triangle that this enters, and slides from there. Where it ends with the
    point outside, it has left the surface there, and goes on straight to the point: it may meet another surface. So a
    point that nothing holds can be reached through free space, and is outside. Each round ends nearer to `end`.
    """
    wanted = in_contact | meets(grid, start, end)
    found, held = _held((grid, tables), wanted, start, end, triangle, in_contact)
    return jnp.where(wanted, found, triangle), wanted & held


@one_by_one
def _held(all_tables, wanted, start, end, triangle, in_contact):
    grid, tables = all_tables
    topology, corners_of = tables[0], in_tables(tables)
    slack = rounding(start, end, grid)

    def one(carry):
        triangle, place, left, sliding, _, _ = carry
        entered, _ = first_entered(grid, corners_of, place, end, left, wanted & ~sliding)
        touching = sliding | (entered >= 0)
        triangle, part = descend(
            topology, corners_of, jnp.where(entered >= 0, entered, triangle), end, touching
        )
        outward = nearest_point(corners_of(triangle) - end[None], part)
        inside = dot(outward, pseudonormal(topology, corners_of, triangle, part)) > 0
        leaves = touching & ~inside
        place = jnp.where(leaves, end + outward, place)
        return triangle, place, jnp.where(leaves, 4 * slack, left), sliding & False, touching & inside, leaves

    no = jnp.zeros((), bool)
    begin = (triangle, start, jnp.zeros_like(slack), wanted & in_contact, no, wanted)
    triangle, _, _, _, held, _ = jax.lax.while_loop(lambda carry: carry[-1], one, begin)
    return triangle, held
