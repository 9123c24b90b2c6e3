"""The cuboid."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .. import safe
from .._validate import as_float, check_positive
from ._shape import Shape, SurfacePoint

# One row a vertex, in units of half the edge length.
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])


class Box(Shape):
    """A cuboid centred on the origin of its own frame, edges along the axes.

    **Arguments:** `size`, the three full edge lengths in m, each above 0.
    """

    size: Float[Array, "3"] = eqx.field(converter=as_float)
    faces: ClassVar[tuple[str, ...]] = ("+x", "-x", "+y", "-y", "+z", "-z")

    def __check_init__(self):
        check_positive("size", self.size, shape=(3,), unit="m")

    def closest(self, query: Float[Array, "3"]) -> SurfacePoint:
        """Closest surface point to `query` (m, in the box's frame).

        Inside, the nearest face wins (the first of equals). Outside, the normal points from the surface point to
        the query and `face` is the face the query stands off from most.
        """
        half = self.size / 2
        margin = half - jnp.abs(query)  # distance to the face of each axis; negative: outside it
        axis = jnp.argmin(margin)
        sign = jnp.where(query >= 0, 1, -1).astype(query.dtype)
        is_axis = jnp.arange(3) == axis
        face_normal = jnp.where(is_axis, sign, 0)
        face = 2 * axis.astype(jnp.int32) + jnp.any(is_axis & (sign < 0)).astype(jnp.int32)

        inside = jnp.all(margin >= 0)
        outward = query - jnp.clip(query, -half, half)
        normal = jnp.where(inside, face_normal, safe.normalise(outward))
        depth = jnp.where(inside, jnp.min(margin), -safe.norm(outward))
        return SurfacePoint(query + depth * normal, normal, depth, face)

    def vertices(self) -> Float[Array, "8 3"]:
        """The eight corners, m, in the box's frame."""
        return jnp.asarray(_CORNERS, self.size.dtype) * (self.size / 2)[None, :]

    def inertia_per_mass(self) -> Float[Array, "3"]:
        """Solid cuboid: (b^2 + c^2) / 12 about the axis along edge a."""
        square = self.size**2
        return (jnp.sum(square) - square) / 12
