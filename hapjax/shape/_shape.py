"""What every shape can say of itself."""

from abc import abstractmethod
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from .. import safe


class Corner(eqx.Module):
    """The planes that hold a point in a concave corner at once (Zilles and Salisbury 1995).

    normal . depth of the surface point is the sum of `weights` times depth times `normals`; planes that do not take
    part have the weight 0. `faces` are their faces. `left_weights` and `left_faces` are of planes that have just let go:
    friction holds by at least as much as they would.
    """

    normals: Float[Array, "*n c 3"]
    weights: Float[Array, "*n c"]
    faces: Int[Array, "*n c"]
    left_weights: Float[Array, "*n c"]
    left_faces: Int[Array, "*n c"]


class SurfacePoint(eqx.Module):
    """A point of a surface and the query point that it belongs to, all in the shape's own frame.

    `depth` = normal . (point - query), in metres, is positive inside; `face` is the index of the face, for a mu of its
    own. `corner` is `None` on a shape that has no concave corners.
    """

    point: Float[Array, "*n 3"]
    normal: Float[Array, "*n 3"]
    depth: Float[Array, "*n"]
    face: Int[Array, "*n"]
    corner: Corner | None = None


class Track(eqx.Module):
    """Where a touching point was, on a shape whose faces meet at edges; in the shape's frame.

    `query` (m) is the touching point of the last step, `stretch` (m) goes from it to the surface point and is 0 out of
    contact, `face` is the face that holds it: an integer, kept as a float so that a state has numbers of one type.
    `planes` are the weights and faces of the planes that held it, and of those that had let go, see `Corner`; `None` on a
    shape that has no concave corners.
    """

    query: Float[Array, "*n 3"]
    stretch: Float[Array, "*n 3"]
    face: Float[Array, "*n"]
    planes: Float[Array, "*n 4 3"] | None = None


class Edges(eqx.Module):
    """Sharp edges: where each begins and ends (m), and the outward normals of its two faces, in the shape's frame."""

    start: Float[Array, "n 3"]
    end: Float[Array, "n 3"]
    normals: Float[Array, "n 2 3"]


class Axis(eqx.Module):
    """A segment (m, in the shape's frame) that stands for a round side: all points within `radius` of its inside.

    `flat`: the shape ends where the segment does, so that a way out may lead through an end.
    """

    start: Float[Array, "3"]
    end: Float[Array, "3"]
    radius: Float[Array, ""]
    flat: bool = eqx.field(static=True)


class Rims(eqx.Module):
    """Sharp circular edges: of each its `centre` (m) and two unit vectors in its plane, in the shape's frame, and their
    `radius` (m). `x` × `y` is the outward normal of the flat face beside it."""

    centre: Float[Array, "n 3"]
    x: Float[Array, "n 3"]
    y: Float[Array, "n 3"]
    radius: Float[Array, ""]


class Shape(eqx.Module):
    """A shape in its own frame. Its numbers are leaves, so that they can be differentiated and fitted."""

    @property
    @abstractmethod
    def faces(self) -> tuple[str, ...]:
        """Names of the faces that can have a mu of their own, in the order in which a list of mu is given."""

    @abstractmethod
    def closest(self, query: Float[Array, "3"]) -> SurfacePoint:
        """Closest surface point to `query` (m, in the shape's frame), inside and outside."""

    @abstractmethod
    def inertia_per_mass(self) -> Float[Array, "3"] | Float[Array, "3 3"] | None:
        """Inertia of the uniform solid about its centre of mass over its mass, m^2. None: it has no volume."""

    def volume(self) -> Float[Array, ""] | None:
        """The volume, m^3. `None`: it is unbounded."""
        return None

    def centre(self) -> Float[Array, "3"] | None:
        """The centre of mass of the uniform solid, m. `None`: the origin of the shape's frame."""
        return None

    def start(self, query: Float[Array, "3"]) -> Track | None:
        """What is remembered of a point that has just appeared at `query`. A smooth shape remembers nothing."""
        return None

    def follow(self, track: Track | None, query: Float[Array, "3"]) -> tuple[Track | None, SurfacePoint]:
        """The surface point that holds a touching point, which moved straight from `track.query` to `query`.

        In contact while its depth is above 0. On a smooth shape it is the closest point. Where faces meet at edges it
        depends on the way: a point stays with the face through which it came in until that face ends.
        """
        return None, self.closest(query)

    # What follows is how a shape touches other objects.

    def points(self, facing: Callable[[Float[Array, "3"]], Float[Array, "3"]]) -> Float[Array, "P 3"] | None:
        """The points (m) by which it can touch another object; `None`: it only is touched.

        `facing(p)` is the other object's outward normal near a point p of this shape, all in this shape's frame; (3, 3)
        of a mesh with hollows: those of up to three walls, the nearest first, and again for those that are not there.
        """
        return None

    def rounding(self) -> Float[Array, ""] | None:
        """The radius (m) of the balls about its points. `None`: they are sharp."""
        return None

    def goes_on(self, before: Float[Array, "P 3"], points: Float[Array, "P 3"]) -> Int[Array, "P"] | None:
        """Of sharp points that wander over the material: for each, which one of those `before` it is nearest to.

        `None`: the points are fixed in the material.
        """
        return None

    def edges(self) -> Edges | None:
        """Its sharp convex edges."""
        return None

    def rims(self) -> Rims | None:
        """Its sharp circular edges, which against a round side stand for its `edges`."""
        return None

    def axis(self) -> Axis | None:
        """Its round side."""
        return None

    def thickness(self) -> Float[Array, ""] | None:
        """Half the least width (m) of a shape with sharp edges: those of its far side are farther away."""
        return None


BORDER = 1e-3
"""By how much of its size a face goes on holding beyond its border: faces that lie flush do not lose each other."""


def begin(near: SurfacePoint, query: Float[Array, "3"]) -> Track:
    """The track of a point that has just appeared at `query`, with the closest surface point `near`."""
    stretch = jnp.where(near.depth > 0, near.depth * near.normal, 0)
    return Track(query, stretch, near.face.astype(query.dtype))


def ease(track: Track, query: Float[Array, "3"], near: SurfacePoint) -> tuple[Track, SurfacePoint]:
    """Go to the surface point `near` without a jump of the force.

    Within one face the stretch (query to surface point) never changes by more than the query moves. Where a face ends,
    at a convex edge, it would jump to that of the next face, or to 0 where there is none. So its change is limited to
    the way that the query has moved: the edge feels rounded, by as much as the point is deep.
    """
    target = jnp.where(near.depth > 0, near.depth * near.normal, 0)
    change = target - track.stretch
    size = safe.norm(change)
    reach = jax.lax.stop_gradient(jnp.max(jnp.abs(query)) + jnp.max(jnp.abs(track.query)))
    way = safe.norm(query - track.query) + 8 * jnp.finfo(query.dtype).eps * reach
    late = size > way
    stretch = jnp.where(late, track.stretch + change * safe.divide(way, size), target)
    normal = jnp.where(late, safe.normalise(stretch), near.normal)
    depth = jnp.where(late, safe.norm(stretch), near.depth)
    corner, planes = _let_go(near.corner, track.planes, late, normal, near.face, way, depth)
    point = SurfacePoint(jnp.where(late, query + stretch, near.point), normal, depth, near.face, corner)
    return Track(query, stretch, near.face.astype(query.dtype), planes), point


def _let_go(
    corner: Corner | None,
    before: Float[Array, "4 3"] | None,
    late: Bool[Array, ""],
    normal: Float[Array, "3"],
    face: Int[Array, ""],
    way: Float[Array, ""],
    depth: Float[Array, ""],
) -> tuple[Corner | None, Float[Array, "4 3"] | None]:
    """While the pull lags behind it is not yet that of the planes which the point has come to: its own plane holds.

    Friction would fall at once to what one plane holds. What several held goes with the way, at the depth's pace.
    """
    if corner is None or before is None:
        return None, before
    first = (jnp.arange(3, dtype=jnp.int32) == 0).astype(normal.dtype)
    weights = jnp.where(late, first, corner.weights)
    faces = jnp.where(late, face, corner.faces)
    held, held_faces, left, left_faces = before
    whole = jnp.sum(left)
    left = left * jnp.maximum(1 - safe.divide(way, depth * whole), 0)
    several = late & (jnp.sum(held) > jnp.maximum(jnp.sum(left), 1))
    left = jnp.where(depth > 0, jnp.where(several, held, left), 0)
    left_faces = jnp.where(several, held_faces, left_faces)
    planes = jnp.stack([jnp.where(depth > 0, weights, 0), faces.astype(normal.dtype), left, left_faces])
    kept = Corner(
        jnp.where(late, normal[None], corner.normals), weights, faces, left, left_faces.astype(jnp.int32)
    )
    return kept, planes
