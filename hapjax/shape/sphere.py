"""The ball."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .. import safe
from .._validate import as_float, check_positive
from ._shape import Shape, SurfacePoint


class Sphere(Shape):
    """A ball about the origin of its own frame.

    **Arguments:** `radius` in m, above 0.
    """

    radius: Float[Array, ""] = eqx.field(converter=as_float)
    faces: ClassVar[tuple[str, ...]] = ("sphere",)

    def __check_init__(self):
        check_positive("radius", self.radius, unit="m")

    def closest(self, query: Float[Array, "3"]) -> SurfacePoint:
        """Closest surface point to `query` (m, in the ball's frame). From the very centre it is the north pole."""
        distance = safe.norm(query)
        pole = jnp.array([0, 0, 1], query.dtype)
        normal = jnp.where(distance == 0, pole, safe.normalise(query))
        return SurfacePoint(self.radius * normal, normal, self.radius - distance, jnp.zeros((), jnp.int32))

    def volume(self) -> Float[Array, ""]:
        """4/3 pi r^3, m^3."""
        return 4 / 3 * jnp.pi * self.radius**3

    def inertia_per_mass(self) -> Float[Array, "3"]:
        """Solid ball: 2/5 r^2 about every axis."""
        return jnp.broadcast_to(0.4 * self.radius**2, (3,))

    def points(self, facing) -> Float[Array, "1 3"]:
        """The centre."""
        return jnp.zeros((1, 3), self.radius.dtype)

    def rounding(self) -> Float[Array, ""]:
        """The radius."""
        return self.radius
