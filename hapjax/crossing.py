"""Where two edges, or an edge and a round side, or two round sides, lie across each other.

A cube on a thin beam has no vertex inside anything: it rests where its edges cross the beam's.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from . import rotation, safe
from .god_object import GodObject
from .shape import BORDER, Axis, Edges, Rims
from .surface import Surface

_PARALLEL = 0.02  # the sine of the angle below which two edges do not cross
_ROUNDS = 8  # of Newton's method; where a circle's two nearest points meet it is slow
_STRIDE = 0.5  # rad: no longer step
_FOUND = 1e-3  # rad: a place is found if it is no farther off
_FLAT = 1e-3  # of a square's bend over the radius: it counts as so much at least
_TILT = 0.2  # how far, as a cosine, the crossing's normal may lean over a face beside the edge
_SHALLOW = (
    0.25  # of the thickness: a crossing no deeper than that may begin without having been seen from outside
)


class Crossing(eqx.Module):
    """Pairs of edges, in the second object's frame: of each the `point` (m) on the first object's edge, the unit
    `normal` from the second to the first, and how `depth` (m) the first has sunk in.

    `admissible`: the edges really pass each other there; `lasting`: they do, or all but. `limit` (m): the depth up to
    which that alone is a contact.
    """

    point: Float[Array, "n 3"]
    normal: Float[Array, "n 3"]
    depth: Float[Array, "n"]
    admissible: Bool[Array, "n"]
    lasting: Bool[Array, "n"]
    limit: Float[Array, "n"]


def start(surface: Surface, first, second) -> GodObject:
    """The memory of pairs that have not crossed yet.

    Here a god-object's `point` is its offset (m), and a `depth` below 0 is that of a pair that lies apart.
    """
    found = find(first, second)
    sliding = jnp.zeros_like(found.depth) if surface.remembers() else None
    apart = jnp.where(found.admissible, jnp.minimum(found.depth, 0), 0)
    return GodObject(jnp.zeros_like(found.point), apart, sliding)


def is_active(found: Crossing, before: Float[Array, "n"]) -> Bool[Array, "n"]:
    """Which pairs push, given the depths that were remembered.

    All edges of two overlapping solids overlap in some way; a contact is a pair that has come from outside.
    """
    came = (before != 0) | (found.depth <= found.limit)
    return (found.depth > 0) & ((found.admissible & came) | (found.lasting & (before > 0)))


def find(first, second) -> Crossing:
    """Every pair of edges or round sides of two placed shapes, in the second one's frame."""
    ours, our_axis = _edges_in(first, second), _axis_in(first, second)
    theirs, their_axis = second.shape.edges(), second.shape.axis()
    parts = []
    if ours is not None and theirs is not None:
        shallow = _SHALLOW * jnp.minimum(first.shape.thickness(), second.shape.thickness())
        parts.append(_sharp(ours, theirs, shallow))
    our_rims, their_rims = _rims_in(first, second), second.shape.rims()
    if ours is not None and their_axis is not None:
        parts.append(_on_side(ours, their_axis) if our_rims is None else _rims_on_side(our_rims, their_axis))
    if our_axis is not None and theirs is not None:
        turned = _on_side(theirs, our_axis) if their_rims is None else _rims_on_side(their_rims, our_axis)
        # The point is to be the first object's, the normal is to lead from the second to the first.
        moved = turned.point + turned.depth[:, None] * turned.normal
        kept = turned.admissible, turned.lasting, turned.limit
        parts.append(Crossing(moved, -turned.normal, turned.depth, *kept))
    if our_axis is not None and their_axis is not None:
        parts.append(_sides(our_axis, their_axis))
    return jax.tree.map(lambda *fields: jnp.concatenate(fields), *parts)


def _edges_in(first, second) -> Edges | None:
    edges = first.shape.edges()
    if edges is None:
        return None
    start, end = (second.to_local(first.to_world(x)) for x in (edges.start, edges.end))
    normals = rotation.turn_back(second.matrix, rotation.turn(first.matrix, edges.normals))
    return Edges(start, end, normals)


def _axis_in(first, second) -> Axis | None:
    axis = first.shape.axis()
    if axis is None:
        return None
    start, end = (second.to_local(first.to_world(x)) for x in (axis.start, axis.end))
    return Axis(start, end, axis.radius, axis.flat)


def _rims_in(first, second) -> Rims | None:
    rims = first.shape.rims()
    if rims is None:
        return None
    centre = second.to_local(first.to_world(rims.centre))
    x, y = (rotation.turn_back(second.matrix, rotation.turn(first.matrix, v)) for v in (rims.x, rims.y))
    return Rims(centre, x, y, rims.radius)


def _nearest(a: Float[Array, "*n 3"], u, b: Float[Array, "*n 3"], v):
    """The points of the lines a + s u and b + t v that are closest to each other, their common normal, and whether both
    lie within 0 <= s, t <= 1 of lines that are not parallel; and whether they do but for a little. And s and t.
    """
    across = jnp.cross(u, v)
    square = jnp.sum(across**2, axis=-1)
    crosses = square > _PARALLEL**2 * jnp.sum(u**2, axis=-1) * jnp.sum(v**2, axis=-1)
    scaled = across / jnp.where(crosses, square, 1)[..., None]
    s = jnp.sum(jnp.cross(b - a, v) * scaled, axis=-1)
    t = jnp.sum(jnp.cross(b - a, u) * scaled, axis=-1)
    beyond = jnp.maximum(jnp.maximum(-s, s - 1), jnp.maximum(-t, t - 1))
    within, nearly = crosses & (beyond <= 0), crosses & (beyond <= BORDER)
    return a + s[..., None] * u, b + t[..., None] * v, safe.normalise(across), within, nearly, s, t


def _sharp(ours: Edges, theirs: Edges, shallow: Float[Array, ""]) -> Crossing:
    """Edge against edge: the normal is that of both, and leans over none of the four faces."""
    shape = (ours.start.shape[0], theirs.start.shape[0], 3)
    a, u = (jnp.broadcast_to(x[:, None], shape) for x in (ours.start, ours.end - ours.start))
    b, v = (jnp.broadcast_to(x[None], shape) for x in (theirs.start, theirs.end - theirs.start))
    point, other, normal, within, nearly, _, _ = _nearest(a, u, b, v)
    outward = jnp.sum(normal * jnp.sum(theirs.normals, axis=1)[None], axis=-1)
    normal = normal * jnp.where(outward < 0, -1, 1).astype(normal.dtype)[..., None]
    fits = jnp.all(jnp.sum(normal[:, :, None] * theirs.normals[None], axis=-1) >= -_TILT, axis=-1)
    fits &= jnp.all(jnp.sum(normal[:, :, None] * ours.normals[:, None], axis=-1) <= _TILT, axis=-1)
    depth = jnp.sum(normal * (other - point), axis=-1)
    return Crossing(
        point.reshape(-1, 3),
        normal.reshape(-1, 3),
        depth.ravel(),
        (within & fits).ravel(),
        (nearly & fits).ravel(),
        jnp.broadcast_to(shallow, (depth.size,)),
    )


def _on_side(edges: Edges, axis: Axis) -> Crossing:
    """Edges against a round side: the normal leads from the axis to the edge."""
    shape = edges.start.shape
    b, v = (jnp.broadcast_to(x[None], shape) for x in (axis.start, axis.end - axis.start))
    point, other, _, within, nearly, _, t = _nearest(edges.start, edges.end - edges.start, b, v)
    distance = safe.norm(point - other)
    normal = safe.normalise(point - other)
    fits = jnp.all(jnp.sum(normal[:, None] * edges.normals, axis=-1) <= _TILT, axis=-1)
    fits &= distance > 0
    return Crossing(point, normal, axis.radius - distance, within & fits, nearly & fits, _limit(axis, t))


def _limit(axis: Axis, t: Float[Array, "n"]) -> Float[Array, "n"]:
    """No deeper than that is what lies `t` along the axis on its side: else the way out through an end is shorter."""
    if not axis.flat:
        return jnp.broadcast_to(axis.radius, t.shape)
    return jnp.minimum(axis.radius, jnp.minimum(t, 1 - t) * safe.norm(axis.end - axis.start))


def _rims_on_side(rims: Rims, axis: Axis) -> Crossing:
    """Rims against a round side: each at the two places where it comes nearest to the axis."""
    found = jax.vmap(lambda centre, x, y: _rim_on_side(centre, x, y, rims.radius, axis))(
        rims.centre, rims.x, rims.y
    )
    return jax.tree.map(lambda field: field.reshape(-1, *field.shape[2:]), found)


class _Circle(eqx.Module):
    """A circle of a `radius` (m) in the plane of two unit vectors, its `centre` (m) seen from a line along `u`."""

    centre: Float[Array, "3"]
    x: Float[Array, "3"]
    y: Float[Array, "3"]
    radius: Float[Array, ""]
    u: Float[Array, "3"]

    def across(self, v: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """What of vectors is across the line."""
        return v - jnp.sum(v * self.u[None], axis=-1)[:, None] * self.u[None]

    def outward(self, angle: Float[Array, "n"]) -> Float[Array, "n 3"]:
        """From the centre, at angles from x."""
        return jnp.cos(angle)[:, None] * self.x[None] + jnp.sin(angle)[:, None] * self.y[None]

    def point(self, angle: Float[Array, "n"]) -> Float[Array, "n 3"]:
        """The point (m) there, from the line's start."""
        return self.centre[None] + self.radius * self.outward(angle)

    def change(self, angle: Float[Array, "n"]) -> tuple[Float[Array, "n"], Float[Array, "n"]]:
        """The first and the second derivative of half the square of the distance to the line, over the radius."""
        outward, onward = self.outward(angle), self.outward(angle + jnp.pi / 2)
        gap = self.across(self.point(angle))
        slope = jnp.sum(gap * onward, axis=-1)
        bend = self.radius * jnp.sum(self.across(onward) ** 2, axis=-1) - jnp.sum(gap * outward, axis=-1)
        return slope, bend

    def nearer(self, angle: Float[Array, "n"]) -> Float[Array, "n"]:
        """A step of Newton's method downhill to where the distance is least."""
        slope, bend = self.change(angle)
        steep = jnp.maximum(jnp.abs(jax.lax.stop_gradient(bend)), _FLAT * self.radius)
        return angle - jnp.clip(slope / steep, -_STRIDE, _STRIDE)


def _rim_on_side(centre, x, y, radius, axis: Axis) -> Crossing:
    """A circle has up to two points that are locally nearest to a line; where they have become one, each is half of it."""
    along = axis.end - axis.start
    length = safe.norm(along)
    circle = _Circle(centre - axis.start, x, y, radius, along / length)
    still = jax.lax.stop_gradient(circle)
    ahead = jnp.arctan2(jnp.sum(still.u * still.y), jnp.sum(still.u * still.x))
    start = jnp.stack([ahead, ahead + jnp.pi])
    angle = jax.lax.fori_loop(0, _ROUNDS, lambda _, a: still.nearer(a), start)
    # From close to where it is farthest a start does not arrive; the other one then has.
    slope, bend = still.change(angle)
    lost = (bend <= 0) | (jnp.abs(slope) > _FOUND * jnp.maximum(bend, _FLAT * still.radius))
    angle = jnp.where(lost & ~lost[::-1], angle[::-1], angle)
    angle = circle.nearer(angle)  # whose derivative is that of the place

    point = circle.point(angle)
    gap = circle.across(point)
    distance, normal = safe.norm(gap), safe.normalise(gap)
    # Between them the circle is farther off; as they come together it no longer is.
    half = jnp.arctan2(jnp.sin(angle[1] - angle[0]), jnp.cos(angle[1] - angle[0])) / 2
    between = axis.radius - safe.norm(circle.across(circle.point(angle[:1] + half)))
    depth = axis.radius - distance - jnp.maximum(between, 0) / 2

    t = jnp.sum(point * circle.u[None], axis=-1) / length
    fits = jnp.sum(normal * circle.outward(angle), axis=-1) <= _TILT
    fits &= jnp.sum(normal * jnp.cross(x, y)[None], axis=-1) <= _TILT
    fits &= (distance > 0) & (circle.change(angle)[1] > 0)
    beyond = jnp.maximum(-t, t - 1)
    limit = _limit(axis, t)
    return Crossing(
        point + axis.start[None], normal, depth, fits & (beyond <= 0), fits & (beyond <= BORDER), limit
    )


def _sides(ours: Axis, theirs: Axis) -> Crossing:
    """A round side against a round side."""
    first, second = ours.end - ours.start, theirs.end - theirs.start
    point, other, _, within, nearly, s, t = _nearest(
        ours.start[None], first[None], theirs.start[None], second[None]
    )
    distance = safe.norm(point - other)
    normal = safe.normalise(point - other)
    depth = ours.radius + theirs.radius - distance
    surface = point - ours.radius * normal
    limit = jnp.minimum(_limit(ours, s), _limit(theirs, t))
    return Crossing(surface, normal, depth, within & (distance > 0), nearly & (distance > 0), limit)
