"""The cylinder."""

from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .. import safe
from .._validate import as_float, check_positive
from ._shape import BORDER, Axis, Edges, Rims, Shape, SurfacePoint, Track, begin, ease

# Each rim as a polygon, where it crosses another object's straight edges; its chords lie up to 2 % of the radius inside.
_CHORDS = 16
_AROUND = (np.arange(_CHORDS) + 0.5) * 2 * np.pi / _CHORDS
_RIM = np.stack([np.cos(_AROUND), np.sin(_AROUND), np.zeros(_CHORDS)], axis=1)


class Cylinder(Shape):
    """A solid cylinder about the z axis of its own frame, centred on the origin.

    **Arguments:** `radius` in m and `length` in m along the axis, each above 0.
    """

    radius: Float[Array, ""] = eqx.field(converter=as_float)
    length: Float[Array, ""] = eqx.field(converter=as_float)
    faces: ClassVar[tuple[str, ...]] = ("side", "+z", "-z")

    def __check_init__(self):
        check_positive("radius", self.radius, unit="m")
        check_positive("length", self.length, unit="m")

    def closest(self, query: Float[Array, "3"]) -> SurfacePoint:
        """Closest surface point to `query` (m, in the cylinder's frame).

        Inside, the nearest face wins (of equals the side). Outside, the normal points from the surface point to the
        query, and the face is the one it stands off from most. From the axis the side's point is that towards +x.
        """
        half, radial, side = self.length / 2, _radial(query), _side(query)
        margin = jnp.stack([self.radius - radial, half - jnp.abs(query[2])])
        face = jnp.where(margin[0] <= margin[1], 0, _cap(query[2]))
        inside = jnp.all(margin >= 0)
        held = side * jnp.minimum(radial, self.radius)
        outward = query - held.at[2].set(jnp.clip(query[2], -half, half))
        normal = jnp.where(inside, self._normal(face, query), safe.normalise(outward))
        depth = jnp.where(inside, jnp.min(margin), -safe.norm(outward))
        return SurfacePoint(query + depth * normal, normal, depth, face)

    def start(self, query: Float[Array, "3"]) -> Track:
        """A point that appears inside is held by the nearest face."""
        return begin(self.closest(query), query)

    def follow(self, track: Track, query: Float[Array, "3"]) -> tuple[Track, SurfacePoint]:
        """The face through which the point came in, until the point is beside it; see `Shape.follow`."""
        half = self.length / 2
        old = track.face.astype(jnp.int32)
        face = jnp.where(jnp.any(track.stretch != 0), old, self._entered(track.query, query))
        on_side = face == 0
        normal = self._normal(face, query)
        depth = jnp.where(on_side, self.radius - _radial(query), half - query[2] * normal[2])
        wide = 1 + BORDER
        beside = jnp.where(on_side, jnp.abs(query[2]) > wide * half, _radial(query) > wide * self.radius)
        held = (face >= 0) & ~beside
        face = jnp.where(face >= 0, face, old)
        return ease(
            track, query, SurfacePoint(query + depth * normal, normal, jnp.where(held, depth, 0), face)
        )

    def volume(self) -> Float[Array, ""]:
        """pi r^2 length, m^3."""
        return jnp.pi * self.radius**2 * self.length

    def inertia_per_mass(self) -> Float[Array, "3"]:
        """Solid cylinder: r^2 / 2 about the axis, r^2 / 4 + h^2 / 12 across it."""
        along, across = self.radius**2 / 2, self.radius**2 / 4 + self.length**2 / 12
        return jnp.stack([across, across, along])

    def points(self, facing) -> Float[Array, "8 3"]:
        """Four points of each rim, the first of them where the rim is deepest in the other object. Of several walls of that
        the rim has such a point for each.

        They wander over the material while the cylinder rolls or wobbles.
        """
        axis = jnp.array([0, 0, 1], self.radius.dtype)
        if jax.eval_shape(facing, axis).ndim == 2:
            ends = jnp.stack([axis, -axis]) * self.length / 2
            ways = jax.vmap(lambda end: _towards(facing(end)))(ends)
            return (ends[:, None] + self.radius * ways).reshape(8, 3)
        rims = []
        for end in (axis * self.length / 2, -axis * self.length / 2):
            down = -facing(end) * jnp.array([1, 1, 0], self.radius.dtype)
            size = safe.norm(down)
            # The other's normal along the axis: no point of the rim is the deepest.
            flat = size <= 1e-6
            down = jnp.where(flat, jnp.array([1, 0, 0], size.dtype), down / jnp.where(flat, 1, size))
            side = jnp.cross(axis, down)
            rims += [end + self.radius * u for u in (down, side, -down, -side)]
        return jnp.stack(rims)

    def goes_on(self, before: Float[Array, "8 3"], points: Float[Array, "8 3"]) -> Int[Array, "8"]:
        """The four points of a rim, turned by the nearest quarter turns: as it rocks through level the deepest point jumps
        to the other side, but the four of them stay where they are."""
        rims = jnp.arange(8, dtype=jnp.int32).reshape(2, 4)
        first, now = before.reshape(2, 4, 3)[:, 0], points.reshape(2, 4, 3)[:, 0]
        along = first[:, 0] * now[:, 0] + first[:, 1] * now[:, 1]
        across = first[:, 0] * now[:, 1] - first[:, 1] * now[:, 0]
        quarters = jnp.round(jnp.arctan2(across, along) / (jnp.pi / 2)).astype(jnp.int32)
        return (4 * (rims // 4) + (rims + quarters[:, None]) % 4).reshape(8)

    def edges(self) -> Edges:
        """The chords of both rims."""
        dtype = self.radius.dtype
        ring = jnp.asarray(_RIM, dtype) * self.radius
        up = jnp.array([0, 0, 1], dtype)
        half = up * self.length / 2
        outward = jnp.asarray(_RIM + np.roll(_RIM, -1, axis=0), dtype)
        outward = outward / jnp.sqrt(jnp.sum(outward**2, axis=1))[:, None]
        starts, ends, normals = [], [], []
        for sign in (1, -1):
            starts.append(ring + (sign * half)[None])
            ends.append(jnp.roll(ring, -1, axis=0) + (sign * half)[None])
            normals.append(jnp.stack([outward, jnp.broadcast_to(sign * up, outward.shape)], axis=1))
        return Edges(jnp.concatenate(starts), jnp.concatenate(ends), jnp.concatenate(normals))

    def rims(self) -> Rims:
        """Both rims."""
        frame = jnp.eye(3, dtype=self.radius.dtype)
        half = frame[2] * self.length / 2
        x = jnp.stack([frame[0], frame[0]])
        return Rims(jnp.stack([half, -half]), x, jnp.stack([frame[1], -frame[1]]), self.radius)

    def axis(self) -> Axis:
        """The side."""
        half = jnp.array([0, 0, 1], self.radius.dtype) * self.length / 2
        return Axis(half, -half, self.radius, flat=True)

    def thickness(self) -> Float[Array, ""]:
        """Half the smaller of diameter and length."""
        return jnp.minimum(self.radius, self.length / 2)

    def _normal(self, face: Int[Array, ""], query: Float[Array, "3"]) -> Float[Array, "3"]:
        cap = jnp.array([0, 0, 1], query.dtype) * jnp.where(face == 1, 1, -1).astype(query.dtype)
        return jnp.where(face == 0, _side(query), cap)

    def _entered(self, start: Float[Array, "3"], end: Float[Array, "3"]) -> Int[Array, ""]:
        """The face through which the straight way enters the cylinder last, or -1 where it does not."""
        half, way = self.length / 2, end - start
        sign = jnp.where(start[2] < 0, -1, 1).astype(start.dtype)
        above = sign * start[2] - half  # how far beyond the nearer cap
        lowered = sign * (start[2] - end[2])
        by_cap = (above >= 0) & (lowered > above)
        cap_at = jnp.where(by_cap, above / jnp.where(by_cap, lowered, 1), -1)

        a, b = jnp.sum(way[:2] ** 2), -jnp.sum(start[:2] * way[:2])
        c = jnp.sum(start[:2] ** 2) - self.radius**2
        root = b**2 - a * c
        ends_inside = jnp.sum(end[:2] ** 2) < self.radius**2
        by_side = (c >= 0) & (b > 0) & (root > 0) & ((c < b + jnp.sqrt(jnp.maximum(root, 0))) | ends_inside)
        side_at = jnp.where(by_side, c / jnp.where(by_side, b + jnp.sqrt(jnp.where(by_side, root, 1)), 1), -1)

        when = jnp.stack([side_at, cap_at])
        nearest = jnp.stack([_radial(start) - self.radius, above])
        inside = (c < 0) & (above < 0)
        first = jnp.argmax(jnp.where(inside, nearest, when))
        there = start + jnp.maximum(when[first], 0) * way
        # Rounding must not let a way through that ends inside, nor one that meets the rim.
        in_side = by_side | ((c < 0) & ((jnp.sum(there[:2] ** 2) <= self.radius**2) | ends_inside))
        in_caps = by_cap | ((above < 0) & ((jnp.abs(there[2]) <= half) | (jnp.abs(end[2]) <= half)))
        return jnp.where(in_side & in_caps, jnp.where(first == 0, 0, _cap(start[2])), -1)


def _radial(query: Float[Array, "3"]) -> Float[Array, ""]:
    return safe.norm(query[:2])


def _side(query: Float[Array, "3"]) -> Float[Array, "3"]:
    """Outward from the axis; on it, along x."""
    unit = safe.normalise(query * jnp.array([1, 1, 0], query.dtype))
    return jnp.where(_radial(query) == 0, jnp.array([1, 0, 0], query.dtype), unit)


def _towards(normals: Float[Array, "3 3"]) -> Float[Array, "4 3"]:
    """Four directions from the axis, a quarter turn apart, but right into the walls that have these normals."""
    down = -normals * jnp.array([[1, 1, 0]], normals.dtype)
    size = safe.norm(down)
    leans = size > 1e-6
    down = down / jnp.where(leans, size, 1)[:, None]
    x, z = (jnp.array(axis, size.dtype) for axis in ([1, 0, 0], [0, 0, 1]))
    first = jnp.where(jnp.any(leans), down[jnp.argmax(leans)], x)
    side = jnp.cross(z, first)
    along, across = (jnp.sum(down * u[None], axis=1) for u in (first, side))
    quarters = (jnp.arctan2(across, along) * (2 / jnp.pi)) % 4
    more = leans & (along < 1 - 1e-6)
    low, high = jnp.argmin(jnp.where(more, quarters, 4)), jnp.argmax(jnp.where(more, quarters, 0))
    two, some = jnp.sum(more) > 1, jnp.any(more)
    place = jnp.clip(jnp.round(quarters[low]), 1, jnp.where(two, 2, 3))
    last = jnp.maximum(jnp.clip(jnp.round(quarters[high]), 2, 3), place + 1)
    ways = [first]
    for i, way in ((1, side), (2, -first), (3, -side)):
        way = jnp.where(some & (place == i), down[low], way)
        ways.append(jnp.where(two & (last == i), down[high], way))
    return jnp.stack(ways)


def _cap(height: Any) -> Int[Array, ""]:
    return jnp.where(height >= 0, 1, 2).astype(jnp.int32)
