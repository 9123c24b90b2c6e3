"""One triangle, seen from the origin: which part of it is nearest, and where.

A part is an integer: 0 the inside, 1 to 3 the edges from corners 0, 1, 2, and 4 to 6 the corners.
"""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from .. import safe


def dot(a: Float[Array, "*#n 3"], b: Float[Array, "*#n 3"]) -> Float[Array, "*_"]:
    """Scalar product along the last axis."""
    return jnp.sum(a * b, axis=-1)


def area_normal(corners: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """The normal, counter-clockwise seen from its tip, as long as twice the area."""
    return jnp.cross(corners[1] - corners[0], corners[2] - corners[0])


def nearest_part(corners: Float[Array, "3 3"]) -> Int[Array, ""]:
    """The part of the triangle nearest to the origin (Ericson, Real-Time Collision Detection, 5.1.5)."""
    a, b, c = corners[0], corners[1], corners[2]
    ab, ac = b - a, c - a
    d1, d2, d3, d4, d5, d6 = (-dot(e, v) for v in (a, b, c) for e in (ab, ac))
    in_edges = (
        (d1 * d4 - d3 * d2 <= 0) & (d1 >= 0) & (d3 <= 0),
        (d3 * d6 - d5 * d4 <= 0) & (d4 >= d3) & (d5 >= d6),
        (d5 * d2 - d1 * d6 <= 0) & (d2 >= 0) & (d6 <= 0),
    )
    in_corners = ((d1 <= 0) & (d2 <= 0), (d3 >= 0) & (d4 <= d3), (d6 >= 0) & (d5 <= d6))
    part = jnp.zeros((), jnp.int32)
    for i in (2, 1, 0):
        part = jnp.where(in_edges[i], i + 1, part)
    for i in (2, 1, 0):
        part = jnp.where(in_corners[i], i + 4, part)
    return part


def weights(corners: Float[Array, "3 3"], part: Int[Array, ""]) -> Float[Array, "3"]:
    """The barycentric coordinates of the point of this part that is nearest to the origin."""
    normal = area_normal(corners)
    following, last = jnp.roll(corners, -1, axis=0), jnp.roll(corners, -2, axis=0)
    inside = dot(jnp.cross(following, last), normal[None]) * safe.divide(
        jnp.ones_like(normal[0]), dot(normal, normal)
    )
    along = following - corners
    t = jnp.clip(safe.divide(-dot(corners, along), dot(along, along)), 0, 1)
    index = jnp.arange(3, dtype=jnp.int32)
    edge, corner = part - 1, part - 4
    t = jnp.sum(jnp.where(index == edge, t, 0))
    on_edge = jnp.where(index == edge, 1 - t, jnp.where(index == (edge + 1) % 3, t, 0))
    on_corner = (index == corner).astype(corners.dtype)
    return jnp.where(part == 0, inside, jnp.where(part < 4, on_edge, on_corner))


def nearest_point(corners: Float[Array, "3 3"], part: Int[Array, ""]) -> Float[Array, "3"]:
    """The point of this part that is nearest to the origin."""
    normal = area_normal(corners)
    inside = normal * safe.divide(dot(normal, corners[0]), dot(normal, normal))
    blend = weights(corners, part)
    # In the plane's own terms, since three large numbers would cancel in the sum.
    return jnp.where(part == 0, inside, jnp.sum(blend[:, None] * corners, axis=0))
