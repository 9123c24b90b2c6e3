"""Which triangle of a mesh holds a touching point that moved straight from one place to another."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ._grid import Grid, first_entered, meets, rounding
from ._lanes import one_by_one
from ._table import rows
from ._topology import Topology
from ._triangle import area_normal, dot, nearest_point
from ._walk import beside, descend


def unit_normal(corners: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """The outward normal of a triangle, which has an area."""
    normal = area_normal(corners)
    return normal / jnp.sqrt(dot(normal, normal))


def pseudonormal(topology: Topology, patch: Float[Array, "5 3"], part: Int[Array, ""]) -> Float[Array, "3"]:
    """The unit vector whose product with (point - query) is above 0 where the query is inside, `point` being the closest
    surface point and lying in this part of this triangle (Baerentzen and Aanaes 2005)."""
    across, vertex = beside(patch, part)
    own = unit_normal(patch[:3])
    both = own + unit_normal(rows(topology.patches, across)[:3])
    size = jnp.sqrt(dot(both, both))
    folded = size < 1e-6
    on_edge = jnp.where(folded, own, both / jnp.where(folded, 1, size))
    return jnp.where(part == 0, own, jnp.where(part < 4, on_edge, rows(topology.vertex_normals, vertex)))


def hold(
    grid: Grid,
    topology: Topology,
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
    found, held = _held((grid, topology), wanted, start, end, triangle, in_contact)
    return jnp.where(wanted, found, triangle), wanted & held


@one_by_one
def _held(tables, wanted, start, end, triangle, in_contact):
    grid, topology = tables
    slack = rounding(start, end, grid)

    def one(carry):
        triangle, place, left, sliding, _, _ = carry
        entered, _ = first_entered(grid, topology.patches, place, end, left, wanted & ~sliding)
        touching = sliding | (entered >= 0)
        triangle, patch, part = descend(topology, jnp.where(entered >= 0, entered, triangle), end, touching)
        outward = nearest_point(patch[:3] - end[None], part)
        inside = dot(outward, pseudonormal(topology, patch, part)) > 0
        leaves = touching & ~inside
        place = jnp.where(leaves, end + outward, place)
        return triangle, place, jnp.where(leaves, 4 * slack, left), sliding & False, touching & inside, leaves

    no = jnp.zeros((), bool)
    begin = (triangle, start, jnp.zeros_like(slack), wanted & in_contact, no, wanted)
    triangle, _, _, _, held, _ = jax.lax.while_loop(lambda carry: carry[-1], one, begin)
    return triangle, held
