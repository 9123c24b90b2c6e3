"""The half-space below z = 0."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from ._shape import Shape, SurfacePoint


class Plane(Shape):
    """All points with z <= 0 in its own frame; the outward normal is +z."""

    faces: ClassVar[tuple[str, ...]] = ("plane",)

    def closest(self, query: Float[Array, "3"]) -> SurfacePoint:
        """Closest surface point to `query` (m, in the plane's frame)."""
        normal = jnp.array([0, 0, 1], query.dtype)
        depth = -query[2]
        return SurfacePoint(query + depth * normal, normal, depth, jnp.zeros((), jnp.int32))

    def inertia_per_mass(self) -> None:
        """A half-space has no finite inertia."""
        return None
