"""The planes of a mesh that hold the god-object at once in a concave corner (Zilles and Salisbury 1995)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .. import safe
from ._hold import unit_normal
from ._lanes import one_by_one
from ._shape import Corner
from ._table import rows
from ._topology import Topology
from ._triangle import dot
from ._walk import beside, steepest

_FLAT = 1e-3  # sine of the angle from which on two planes count as one


def holding(
    topology: Topology,
    triangle: Int[Array, ""],
    patch: Float[Array, "5 3"],
    part: Int[Array, ""],
    query: Float[Array, "3"],
    held: Bool[Array, ""],
) -> Int[Array, "3"]:
    """Up to three triangles whose planes hold the god-object of `query`; `triangle` again where they are fewer.

    At an edge the two beside it. At a vertex the plane that the query is deepest below, then the one that the point
    so constrained is deepest below, then the one that the point constrained by both is. Nothing is differentiated.
    """
    across, vertex = beside(patch, part)
    at_vertex = held & (part >= 4)
    peak = patch[jnp.clip(part - 4, 0, 2)]
    on_edge = jnp.stack([triangle, jnp.where(part > 0, across, triangle), triangle])
    return jnp.where(at_vertex, _at_vertex(topology, at_vertex, vertex, peak, query), on_edge)


@one_by_one
def _at_vertex(topology, wanted, vertex, peak, query):
    def normal_of(triangle):
        return unit_normal(rows(topology.patches, triangle)[:3])

    first = steepest(topology, vertex, query, wanted)
    one = normal_of(first)
    place = query + dot(one, peak - query) * one
    second = steepest(topology, vertex, place, wanted)
    along = safe.normalise(jnp.cross(one, normal_of(second)))
    place = jnp.where(jnp.any(along != 0), peak + dot(along, query - peak) * along, place)
    third = steepest(topology, vertex, place, wanted)
    return jnp.stack([first, second, third])


def corner_of(
    normals: Float[Array, "3 3"],
    faces: Int[Array, "3"],
    count: Int[Array, ""],
    normal: Float[Array, "3"],
    face: Int[Array, ""],
) -> Corner:
    """The shares of `count` planes in a unit `normal`, which is the sum of weights times normals.

    Where planes are nearly the same, or one would have to pull, fewer hold: two, or the surface point's own.
    """
    a, b, c = normals[0], normals[1], normals[2]
    bc, ca, ab = jnp.cross(b, c), jnp.cross(c, a), jnp.cross(a, b)
    det = dot(a, bc)
    det = jnp.where(jnp.abs(det) > _FLAT, det, 0)
    three = safe.divide(jnp.stack([dot(normal, bc), dot(normal, ca), dot(normal, ab)]), jnp.full((3,), det))

    cosine, square = dot(a, b), dot(ab, ab)
    square = jnp.where(square > _FLAT**2, square, 0)
    pushed = jnp.stack([dot(normal, a) - cosine * dot(normal, b), dot(normal, b) - cosine * dot(normal, a)])
    two = safe.divide(pushed, jnp.full((2,), square))

    eps = 64 * jnp.finfo(normal.dtype).eps
    by_three = (count == 3) & (det != 0) & jnp.all(three >= -eps)
    by_two = (count >= 2) & (square != 0) & jnp.all(two >= -eps)
    only = jnp.array([1, 0, 0], normal.dtype)
    share = jnp.where(by_three, three, jnp.where(by_two, jnp.pad(two, (0, 1)), only))
    own = jnp.arange(3, dtype=jnp.int32) == 0
    alone = own & ~(by_three | by_two)
    return Corner(
        jnp.where(alone[:, None], normal[None], normals),
        jnp.maximum(share, 0),
        jnp.where(alone, face, faces),
        jnp.zeros_like(share),
        faces,
    )


def frozen(tree):
    """The same numbers, of which no derivative is taken: what is found with them is an integer."""
    return jax.tree.map(jax.lax.stop_gradient, tree)
