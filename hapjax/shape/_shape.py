"""What every shape can say of itself."""

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx
from jaxtyping import Array, Float, Int


class SurfacePoint(eqx.Module):
    """The point of a surface that is closest to a query point, all in the shape's own frame.

    `depth` = normal . (point - query), in metres, is positive inside; `face` indexes `Shape.faces`.
    """

    point: Float[Array, "3"]
    normal: Float[Array, "3"]
    depth: Float[Array, ""]
    face: Int[Array, ""]


class Shape(eqx.Module):
    """A shape in its own frame. Its numbers are leaves, so that they can be differentiated and fitted.

    `faces` names the faces that can have a mu of their own, in the order in which a list of mu is given.
    """

    faces: ClassVar[tuple[str, ...]]

    @abstractmethod
    def closest(self, query: Float[Array, "3"]) -> SurfacePoint:
        """Closest surface point to `query` (m, in the shape's frame), inside and outside."""

    @abstractmethod
    def inertia_per_mass(self) -> Float[Array, "3"] | None:
        """Principal inertia of the uniform solid about its centre over its mass, m^2. None: it has no volume."""
