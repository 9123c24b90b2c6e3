"""Where two edges, or an edge and a round side, or two round sides, lie across each other.

A cube on a thin beam has no vertex inside anything: it rests where its edges cross the beam's.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from . import rotation, safe
from .god_object import GodObject
from .shape import BORDER, Axis, Edges
from .surface import Surface

_PARALLEL = 0.02  # the sine of the angle below which two edges do not cross
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
    if ours is not None and their_axis is not None:
        parts.append(_on_side(ours, their_axis))
    if our_axis is not None and theirs is not None:
        turned = _on_side(theirs, our_axis)
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
    return Axis(start, end, axis.radius)


def _nearest(a: Float[Array, "*n 3"], u, b: Float[Array, "*n 3"], v):
    """The points of the lines a + s u and b + t v that are closest to each other, their common normal, and whether both
    lie within 0 <= s, t <= 1 of lines that are not parallel; and whether they do but for a little.
    """
    across = jnp.cross(u, v)
    square = jnp.sum(across**2, axis=-1)
    crosses = square > _PARALLEL**2 * jnp.sum(u**2, axis=-1) * jnp.sum(v**2, axis=-1)
    scaled = across / jnp.where(crosses, square, 1)[..., None]
    s = jnp.sum(jnp.cross(b - a, v) * scaled, axis=-1)
    t = jnp.sum(jnp.cross(b - a, u) * scaled, axis=-1)
    beyond = jnp.maximum(jnp.maximum(-s, s - 1), jnp.maximum(-t, t - 1))
    within, nearly = crosses & (beyond <= 0), crosses & (beyond <= BORDER)
    return a + s[..., None] * u, b + t[..., None] * v, safe.normalise(across), within, nearly


def _sharp(ours: Edges, theirs: Edges, shallow: Float[Array, ""]) -> Crossing:
    """Edge against edge: the normal is that of both, and leans over none of the four faces."""
    shape = (ours.start.shape[0], theirs.start.shape[0], 3)
    a, u = (jnp.broadcast_to(x[:, None], shape) for x in (ours.start, ours.end - ours.start))
    b, v = (jnp.broadcast_to(x[None], shape) for x in (theirs.start, theirs.end - theirs.start))
    point, other, normal, within, nearly = _nearest(a, u, b, v)
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
    point, other, _, within, nearly = _nearest(edges.start, edges.end - edges.start, b, v)
    distance = safe.norm(point - other)
    normal = safe.normalise(point - other)
    fits = jnp.all(jnp.sum(normal[:, None] * edges.normals, axis=-1) <= _TILT, axis=-1)
    fits &= distance > 0
    limit = jnp.broadcast_to(axis.radius, distance.shape)
    return Crossing(point, normal, axis.radius - distance, within & fits, nearly & fits, limit)


def _sides(ours: Axis, theirs: Axis) -> Crossing:
    """A round side against a round side."""
    first, second = ours.end - ours.start, theirs.end - theirs.start
    point, other, _, within, nearly = _nearest(
        ours.start[None], first[None], theirs.start[None], second[None]
    )
    distance = safe.norm(point - other)
    normal = safe.normalise(point - other)
    depth = ours.radius + theirs.radius - distance
    surface = point - ours.radius * normal
    limit = jnp.broadcast_to(ours.radius + theirs.radius, depth.shape)
    return Crossing(surface, normal, depth, within & (distance > 0), nearly & (distance > 0), limit)
