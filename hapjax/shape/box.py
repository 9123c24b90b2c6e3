"""The cuboid."""

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .. import safe
from .._segments import decided
from .._validate import as_float, check_positive
from ._shape import BORDER, Edges, Shape, SurfacePoint, Track, begin, ease

# One row a vertex, in units of half the edge length.
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])

# The pairs of vertices that differ along one axis only, and the faces that meet there.
_EDGES = np.array([(i, j) for i in range(8) for j in range(i) if np.sum(_CORNERS[i] != _CORNERS[j]) == 1])
_EDGE_NORMALS = np.array(
    [[_CORNERS[i][a] * np.eye(3)[a] for a in range(3) if _CORNERS[i][a] == _CORNERS[j][a]] for i, j in _EDGES]
)


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

    def start(self, query: Float[Array, "3"]) -> Track:
        """A point that appears inside is held by the nearest face."""
        return begin(self.closest(query), query)

    def follow(self, track: Track, query: Float[Array, "3"]) -> tuple[Track, SurfacePoint]:
        """The face through which the point came in, until the point is beside it; see `Shape.follow`."""
        half = self.size / 2
        old = track.face.astype(jnp.int32)
        face = decided(jnp.where(jnp.any(track.stretch != 0), old, _entered(half, track.query, query)))
        normal = _normal(face, query.dtype)
        depth = jnp.sum(half * jnp.abs(normal) - query * normal)
        beside = jnp.any((normal == 0) & (jnp.abs(query) > (1 + BORDER) * half))
        held = (face >= 0) & ~beside
        face = jnp.where(face >= 0, face, old)
        near = SurfacePoint(query + depth * normal, normal, jnp.where(held, depth, 0), face)
        return ease(track, query, near)

    def points(self, facing=None) -> Float[Array, "8 3"]:
        """The eight vertices."""
        return jnp.asarray(_CORNERS, self.size.dtype) * (self.size / 2)[None, :]

    def edges(self) -> Edges:
        """The twelve edges."""
        vertices, normals = self.points(), jnp.asarray(_EDGE_NORMALS, self.size.dtype)
        return Edges(vertices[_EDGES[:, 0]], vertices[_EDGES[:, 1]], normals)

    def thickness(self) -> Float[Array, ""]:
        """Half the shortest edge."""
        return jnp.min(self.size) / 2

    def volume(self) -> Float[Array, ""]:
        """The product of the edge lengths, m^3."""
        return jnp.prod(self.size)

    def inertia_per_mass(self) -> Float[Array, "3"]:
        """Solid cuboid: (b^2 + c^2) / 12 about the axis along edge a."""
        square = self.size**2
        return (jnp.sum(square) - square) / 12


def _normal(face: Int[Array, ""], dtype: Any) -> Float[Array, "3"]:
    sign = jnp.where(face % 2 == 0, 1, -1)
    return jnp.where(jnp.arange(3, dtype=jnp.int32) == face // 2, sign, 0).astype(dtype)


def _entered(half: Float[Array, "3"], start: Float[Array, "3"], end: Float[Array, "3"]) -> Int[Array, ""]:
    """The face through which the straight way from `start` to `end` enters the box last, or -1 where it does not."""
    sign = jnp.where(start < 0, -1, 1).astype(start.dtype)
    outside = sign * start - half  # how far beyond the nearer face of each axis
    inward = sign * (start - end)
    ahead = (outside >= 0) & (inward > outside)
    when = jnp.where(ahead, outside / jnp.where(ahead, inward, 1), -1)
    when = jnp.where(jnp.all(outside < 0), outside, when)  # it starts inside: the nearest face
    axis = jnp.argmax(when)
    there = start + jnp.maximum(jnp.max(when), 0) * (end - start)
    # Rounding must not let a way through that ends inside, nor one that meets an edge.
    between = (outside < 0) & ((jnp.abs(there) <= half) | (jnp.abs(end) <= half))
    hit = jnp.all(ahead | between)
    negative = jnp.any((jnp.arange(3) == axis) & (sign < 0))
    face = 2 * axis.astype(jnp.int32) + negative.astype(jnp.int32)
    return jnp.where(hit, face, -1)
