"""The capsule: a cylinder with a half ball on each end."""

from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .. import safe
from .._validate import as_float, check_positive
from ._shape import Axis, Shape, SurfacePoint


class Capsule(Shape):
    """All points within a radius of a segment, which lies on the z axis of its own frame, about the origin.

    **Arguments:** `radius` in m and `length` in m of the segment, so without the half balls, each above 0.
    """

    radius: Float[Array, ""] = eqx.field(converter=as_float)
    length: Float[Array, ""] = eqx.field(converter=as_float)
    faces: ClassVar[tuple[str, ...]] = ("capsule",)

    def __check_init__(self):
        check_positive("radius", self.radius, unit="m")
        check_positive("length", self.length, unit="m")

    def closest(self, query: Float[Array, "3"]) -> SurfacePoint:
        """Closest surface point to `query` (m, in the capsule's frame). From the segment itself, that towards +x."""
        half = self.length / 2
        axis = jnp.array([0, 0, 1], query.dtype)
        outward = query - jnp.clip(query[2], -half, half) * axis
        distance = safe.norm(outward)
        normal = jnp.where(distance == 0, jnp.array([1, 0, 0], query.dtype), safe.normalise(outward))
        depth = self.radius - distance
        return SurfacePoint(query + depth * normal, normal, depth, jnp.zeros((), jnp.int32))

    def volume(self) -> Float[Array, ""]:
        """pi r^2 (length + 4/3 r), m^3."""
        return jnp.pi * self.radius**2 * (self.length + 4 / 3 * self.radius)

    def inertia_per_mass(self) -> Float[Array, "3"]:
        """A solid cylinder between two half balls, whose centres of mass lie 3/8 r beyond its ends."""
        r, h = self.radius, self.length
        cylinder, ball = h, 4 / 3 * r  # volumes over pi r^2
        along = cylinder * r**2 / 2 + ball * 0.4 * r**2
        across = cylinder * (r**2 / 4 + h**2 / 12) + ball * (0.4 * r**2 + h**2 / 4 + 3 / 8 * h * r)
        return jnp.stack([across, across, along]) / (cylinder + ball)

    def rounding(self) -> Float[Array, ""]:
        """The radius."""
        return self.radius

    def points(self, facing=None) -> Float[Array, "2 3"]:
        """The ends of the segment."""
        axis = jnp.array([0, 0, 1], self.radius.dtype)
        return jnp.stack([axis, -axis]) * self.length / 2

    def axis(self) -> Axis:
        """The segment."""
        first, last = self.points()
        return Axis(first, last, self.radius, flat=False)

    def has_side(self, query: Float[Array, "3"]) -> Bool[Array, ""]:
        """Whether the closest point of the segment is none of its ends."""
        return jnp.abs(query[2]) < self.length / 2
