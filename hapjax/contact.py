"""Object against object (MHS 4 and 6): points of one that enter the other, and edges that cross.

Each contact point has a god-object of its own, with the friction and the damping of the pair.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from . import body as rigid
from . import crossing, god_object, rotation, walls
from .body import Motion
from .errors import InputError
from .god_object import GodObject, Meeting
from .link import Link
from .shape import Capsule, Plane, Shape, Sphere, SurfacePoint
from .surface import Surface


class Contact(Surface):
    """A pair of objects that can collide, with the friction, stiffness and loss of the pair.

    **Arguments:** `between`, the names of the two objects, at least one of which has a body; the others as for
    `Surface`, mu being one number. The stiffness is that of each contact point.
    """

    between: tuple[str, str] = eqx.field(static=True, kw_only=True, converter=lambda names: _pair(names))


def _pair(names) -> tuple[str, str]:
    if isinstance(names, (list, tuple)) and len(names) == 2 and all(isinstance(n, str) for n in names):
        return (names[0], names[1])
    raise InputError(f"between is {names!r}; allowed: the names of two objects")


class Placed(eqx.Module):
    """A shape at a place: position (m) of its origin and rotation matrix, world frame."""

    shape: Shape
    position: Float[Array, "3"]
    matrix: Float[Array, "3 3"]

    def to_local(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """World points (m) in the shape's frame."""
        return rotation.turn_back(self.matrix, points - jnp.broadcast_to(self.position, points.shape))

    def to_world(self, points: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """The shape's points (m) in the world frame."""
        return jnp.broadcast_to(self.position, points.shape) + rotation.turn(self.matrix, points)


class Mover(eqx.Module):
    """A placed shape, and how it moves: `motion` and centre of mass (m), both `None` where it is fixed."""

    placed: Placed
    motion: Motion | None
    centre: Float[Array, "3"] | None

    def velocity_at(self, points: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """Velocity (m/s) of its material at world points (m)."""
        if self.motion is None or self.centre is None:
            return jnp.zeros_like(points)
        return rigid.velocity_at(self.motion, points - self.centre[None])


def check_shapes(first: Shape, second: Shape) -> None:
    """Refuse two shapes of which none has points to touch the other with."""
    if isinstance(first, Plane) and isinstance(second, Plane):
        raise InputError("between pairs a plane and a plane; allowed: at most one plane")


def start(contact: Contact, first: Mover, second: Mover) -> tuple[GodObject, ...]:
    """God-objects of two objects that have not touched yet: one entry for each way in which they can."""
    pair, memory = (first, second), []
    for a, b in _point_ways(first.placed.shape, second.placed.shape):
        local = _points_in(pair[a], pair[b])
        if pair[a].placed.shape.rounding() is None:
            memory.append(god_object.start(pair[b].placed.shape, contact, local))
            own = _points_of(pair[a], pair[b])
            if pair[a].placed.shape.goes_on(own, own) is not None:
                memory[-1] = dataclasses.replace(memory[-1], own=own)
        else:
            sliding = jnp.zeros_like(local[:, 0]) if contact.remembers() else None
            memory.append(GodObject(jnp.zeros_like(local), jnp.zeros_like(local[:, 0]), sliding))
            if walls.are_many(pair[b].placed.shape):
                memory[-1] = walls.start(memory[-1])
    if _edges_cross(first.placed.shape, second.placed.shape):
        memory.append(crossing.start(contact, first.placed, second.placed))
    return tuple(memory)


def meet(
    contact: Contact,
    memory: tuple[GodObject, ...],
    first: Mover,
    second: Mover,
    dt: Float[Array, ""],
    apart: bool = False,
) -> list[Link]:
    """Where two objects touch, or may: one entry for each way in which they can.

    **Arguments:** `apart`: how far points are from each other is wanted too.
    """
    pair, links = (first, second), []
    ways = _point_ways(first.placed.shape, second.placed.shape)
    for way, gods in zip(ways, memory, strict=False):
        links.append(_points_on(contact, gods, pair, way, dt, apart))
    if _edges_cross(first.placed.shape, second.placed.shape):
        links.append(_edges_on(contact, memory[-1], first, second, dt))
    return links


def _point_ways(first: Shape, second: Shape) -> list[tuple[int, int]]:
    """Whose points touch whom: (of, on), 0 the first and 1 the second. A ball's centre alone says all of a ball."""
    for of, shape in enumerate((first, second)):
        if isinstance(shape, Sphere):
            return [(of, 1 - of)]
    pair = (first, second)
    has = [type(shape).points is not Shape.points for shape in pair]
    # A capsule is round all over: the circles of a cylinder's rims meet it, see `crossing`.
    return [
        (of, 1 - of)
        for of in (0, 1)
        if has[of] and not (_has_rims(pair[of]) and isinstance(pair[1 - of], Capsule))
    ]


def _has_rims(shape: Shape) -> bool:
    return type(shape).rims is not Shape.rims


def _edges_cross(first: Shape, second: Shape) -> bool:
    """Whether both have edges or a round side, by which they can touch without a point of one in the other."""

    def has(shape):
        return bool(jax.tree.leaves(jax.eval_shape(lambda: (shape.edges(), shape.axis()))))

    return has(first) and has(second)


def _points_of(a: Mover, b: Mover) -> Float[Array, "P 3"]:
    """The points of `a` towards `b`, in the frame of `a`."""

    def facing(point):
        point, shape = b.placed.to_local(a.placed.to_world(point)), b.placed.shape
        if walls.are_many(shape) and (side := a.placed.shape.axis()) is not None:
            near = walls.about(shape, point, side.radius)
        else:
            near = shape.closest(point)
        return rotation.turn_back(a.placed.matrix, rotation.turn(b.placed.matrix, near.normal))

    points = a.placed.shape.points(facing)
    assert points is not None
    return points


def _points_in(a: Mover, b: Mover) -> Float[Array, "P 3"]:
    """The points of `a` towards `b`, in the frame of `b`."""
    return b.placed.to_local(a.placed.to_world(_points_of(a, b)))


def _points_on(
    contact: Contact, gods: GodObject, pair: tuple[Mover, Mover], way: tuple[int, int], dt, apart: bool
) -> Link:
    """The points of one against the surface of the other."""
    a, b = (pair[i] for i in way)
    shape, radius = b.placed.shape, a.placed.shape.rounding()
    own, faces = _points_of(a, b), None
    places = a.placed.to_world(own)
    points = b.placed.to_local(places)
    if radius is None and gods.own is not None:
        gods = _gone_on(gods, own, a, b)
    if radius is None:
        track, near = jax.vmap(shape.follow)(gods.track, points)
        if apart:
            near, faces = god_object.or_apart(shape, near, points)
    elif walls.are_many(shape):
        near, faces = walls.find(shape, points, radius, apart)
        gods, near, faces = walls.match(gods, near, faces, radius)
        track, own = None, -radius * near.normal
        points = jnp.repeat(points, walls.MOST, axis=0) + own
    else:
        track, near = None, jax.vmap(shape.closest)(points)
        points = points - radius * near.normal
        near = eqx.tree_at(lambda n: n.depth, near, near.depth + radius)
    if isinstance(shape, Capsule) and not (way[0] == 0 and isinstance(a.placed.shape, Capsule)):
        faces = jax.vmap(shape.has_side)(points)  # the balls at its ends touch by their own points
        near = eqx.tree_at(lambda n: n.depth, near, jnp.where(faces, near.depth, 0))
    if _has_rims(a.placed.shape) and _has_rims(shape):
        flat = near.face != 0  # the side is met by the circles
        near = eqx.tree_at(lambda n: n.depth, near, jnp.where(flat, near.depth, 0))
        faces = flat if faces is None else faces & flat
    if radius is not None:
        places = b.placed.to_world(points)
    names = contact.between[way[0]], contact.between[way[1]]
    slip = rotation.turn_back(b.placed.matrix, a.velocity_at(places) - b.velocity_at(places))
    meeting = god_object.meet(contact, gods, near, points, slip if contact.needs_velocity() else None)
    kept, matrix = None if gods.own is None else own, b.placed.matrix
    if radius is None:
        return Link(meeting, points, places, matrix, track, gods.depth, None, None, faces, *names, own=kept)
    # A ball touches now here, now there, on itself and on what it rolls over; what friction stretches is held by the
    # material.
    passed = dt * slip
    offset = jnp.where((gods.depth > 0)[:, None], gods.point - passed, 0)
    meeting = dataclasses.replace(meeting, offset=offset)
    return Link(
        meeting, points, places, matrix, None, gods.depth, None, passed, faces, *names, wanders=True, own=kept
    )


def _gone_on(gods: GodObject, own: Float[Array, "P 3"], a: Mover, b: Mover) -> GodObject:
    """The god-objects of points that wander over the material of `a`: these hold the material, so they go along."""
    assert gods.own is not None
    many = walls.are_many(b.placed.shape)
    which = walls.goes_on(gods.own, own) if many else a.placed.shape.goes_on(gods.own, own)
    moved = own - gods.own[which]
    gods = jax.tree.map(lambda x: x[which], gods)
    way = rotation.turn_back(b.placed.matrix, rotation.turn(a.placed.matrix, moved))
    return dataclasses.replace(gods, point=gods.point + way)


def _edges_on(contact: Contact, gods: GodObject, a: Mover, b: Mover, dt: Float[Array, ""]) -> Link:
    """Where edges and round sides of `a` cross those of `b`."""
    found = crossing.find(a.placed, b.placed)
    active = crossing.is_active(found, gods.depth)
    places = b.placed.to_world(found.point)
    slip = rotation.turn_back(b.placed.matrix, a.velocity_at(places) - b.velocity_at(places))
    apart = jnp.where(found.admissible, jnp.minimum(found.depth, 0), 0)
    depth = jnp.where(active, found.depth, apart)
    # The crossing wanders along both edges; what friction stretches is held by the material.
    offset = jnp.where((gods.depth > 0)[:, None], gods.point - dt * slip, 0)
    surface = found.point + jnp.where(active, found.depth, 0)[:, None] * found.normal
    near = SurfacePoint(surface, found.normal, depth, jnp.zeros(depth.shape, jnp.int32))
    rounding = 8 * jnp.finfo(slip.dtype).eps * jnp.max(jnp.abs(surface), axis=-1)
    speed = slip if contact.needs_velocity() else None
    meeting = Meeting(contact, near, offset, gods.sliding, rounding, speed)
    matrix, names = b.placed.matrix, contact.between
    faces = active | (found.admissible & (found.depth <= 0))
    return Link(
        meeting, found.point, places, matrix, None, gods.depth, None, dt * slip, faces, *names, wanders=True
    )
