"""Object against object (MHS 4 and 6): points of one that enter the other, and edges that cross.

Each contact point has a god-object of its own, with the friction and the damping of the pair.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from . import body as rigid
from . import crossing, god_object, grasp, rotation
from .body import Motion, Wrench
from .errors import InputError
from .god_object import GodObject, Touch
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

    def spin(self) -> Float[Array, "3"] | None:
        """Its angular velocity (rad/s), world frame; `None`: it does not turn."""
        return None if self.motion is None else self.motion.spin

    def wrench(self, points: Float[Array, "n 3"], forces: Float[Array, "n 3"]) -> Wrench | None:
        """The wrench of forces (N) at world points (m); `None` where it is fixed."""
        return None if self.centre is None else grasp.residual(forces, points - self.centre[None])


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
        else:
            sliding = jnp.zeros_like(local[:, 0]) if contact.remembers() else None
            memory.append(GodObject(local, jnp.zeros_like(local[:, 0]), sliding))
    if _edges_cross(first.placed.shape, second.placed.shape):
        memory.append(crossing.start(contact, first.placed, second.placed))
    return tuple(memory)


def collide(
    contact: Contact, memory: tuple[GodObject, ...], first: Mover, second: Mover, dt: Float[Array, ""]
) -> tuple[tuple[GodObject, ...], Touch, Wrench | None, Wrench | None]:
    """Push two objects out of each other.

    Returns the god-objects and touches, each in the frame of the object that is touched, and the wrenches on both
    objects in the world frame, equal and opposite at each contact point.
    """
    pair = (first, second)
    ways = _point_ways(first.placed.shape, second.placed.shape)
    after, touches, places, forces = [], [], [], []
    for (a, b), gods in zip(ways, memory, strict=False):
        masked = isinstance(pair[b].placed.shape, Capsule) and not (
            a == 0 and isinstance(pair[a].placed.shape, Capsule)
        )
        gods, touch, place, force = _points_on(contact, gods, pair[a], pair[b], masked, dt)
        after.append(gods)
        touches.append(touch)
        places.append(place)
        forces.append(force if a == 0 else -force)
    if _edges_cross(first.placed.shape, second.placed.shape):
        gods, touch, place, force = _edges_on(contact, memory[-1], first, second, dt)
        after.append(gods)
        touches.append(touch)
        places.append(place)
        forces.append(force)
    touch = jax.tree.map(lambda *parts: jnp.concatenate(parts), *touches)
    place, force = jnp.concatenate(places), jnp.concatenate(forces)
    return tuple(after), touch, first.wrench(place, force), second.wrench(place, -force)


def _point_ways(first: Shape, second: Shape) -> list[tuple[int, int]]:
    """Whose points touch whom: (of, on), 0 the first and 1 the second. A ball's centre alone says all of a ball."""
    for of, shape in enumerate((first, second)):
        if isinstance(shape, Sphere):
            return [(of, 1 - of)]
    has = [type(shape).points is not Shape.points for shape in (first, second)]
    return [(of, 1 - of) for of in (0, 1) if has[of]]


def _edges_cross(first: Shape, second: Shape) -> bool:
    """Whether both have edges or a round side, by which they can touch without a point of one in the other."""

    def has(shape):
        return bool(jax.tree.leaves(jax.eval_shape(lambda: (shape.edges(), shape.axis()))))

    return has(first) and has(second)


def _points_of(a: Mover, b: Mover) -> Float[Array, "P 3"]:
    """The points of `a` towards `b`, in the frame of `a`."""

    def facing(point):
        near = b.placed.shape.closest(b.placed.to_local(a.placed.to_world(point)))
        return rotation.turn_back(a.placed.matrix, rotation.turn(b.placed.matrix, near.normal))

    points = a.placed.shape.points(facing)
    assert points is not None
    return points


def _points_in(a: Mover, b: Mover) -> Float[Array, "P 3"]:
    """The points of `a` towards `b`, in the frame of `b`."""
    return b.placed.to_local(a.placed.to_world(_points_of(a, b)))


def _points_on(contact: Contact, gods: GodObject, a: Mover, b: Mover, masked: bool, dt: Float[Array, ""]):
    """The points of `a` against the surface of `b`: god-objects and touches, places and forces in the world frame."""
    shape, radius = b.placed.shape, a.placed.shape.rounding()
    own = _points_of(a, b)
    points = b.placed.to_local(a.placed.to_world(own))
    if radius is None:
        track, near = jax.vmap(shape.follow)(gods.track, points)
    else:
        track, near = None, jax.vmap(shape.closest)(points)
        points = points - radius * near.normal
        near = eqx.tree_at(lambda n: n.depth, near, near.depth + radius)
    if masked:
        assert isinstance(shape, Capsule)  # the balls at a capsule's ends touch by their own points
        side = jax.vmap(shape.has_side)(points)
        near = eqx.tree_at(lambda n: n.depth, near, jnp.where(side, near.depth, 0))
    places = b.placed.to_world(points)
    slip = None
    if contact.needs_velocity():
        slip = rotation.turn_back(b.placed.matrix, a.velocity_at(places) - b.velocity_at(places))
    carried = _carried(a, b, own, radius, near)
    if carried is not None:
        gods = eqx.tree_at(lambda g: g.point, gods, gods.point - dt * carried)

    def one(god, way, place, point, speed):
        return god_object.answer(contact, god, way, place, point, speed, dt)

    axes = (0, None if track is None else 0, 0, 0, None if slip is None else 0)
    gods, touch = jax.vmap(one, in_axes=axes)(gods, track, near, points, slip)
    return gods, touch, places, rotation.turn(b.placed.matrix, touch.force)


def _carried(a: Mover, b: Mover, own, radius, near: SurfacePoint):
    """How fast the material of `a` passes through its contact points, in the frame of `b`; `None`: it does not.

    The lowest point of a rolling ball travels with its centre while the material there stands still: the god-object is
    held by the material, so it goes along.
    """
    spin, other = a.spin(), b.spin()
    if other is not None:
        spin = -other if spin is None else spin - other
    if spin is None:
        return None
    if radius is not None:
        arms = -radius * near.normal
        return jnp.cross(jnp.broadcast_to(rotation.turn_back(b.placed.matrix, spin), arms.shape), arms)
    carried = a.placed.shape.carried(own, rotation.turn_back(a.placed.matrix, spin))
    if carried is None:
        return None
    return rotation.turn_back(b.placed.matrix, rotation.turn(a.placed.matrix, carried))


def _edges_on(contact: Contact, gods: GodObject, a: Mover, b: Mover, dt: Float[Array, ""]):
    """Where edges and round sides of `a` cross those of `b`, as `_points_on`."""
    found = crossing.find(a.placed, b.placed)
    active = crossing.is_active(found, gods.depth)
    places = b.placed.to_world(found.point)
    slip = rotation.turn_back(b.placed.matrix, a.velocity_at(places) - b.velocity_at(places))
    depth = jnp.where(active, found.depth, 0)
    # The crossing wanders along both edges; what friction stretches is held by the material.
    offset = jnp.where((gods.depth > 0)[:, None], gods.point - dt * slip, 0)

    def one(point, normal, depth, offset, sliding, speed):
        near = SurfacePoint(point + depth * normal, normal, depth, jnp.zeros((), jnp.int32))
        rounding = 8 * jnp.finfo(speed.dtype).eps * jnp.max(jnp.abs(near.point))
        speed = speed if contact.needs_velocity() else None
        return god_object.press(contact, near, offset, sliding, speed, dt, rounding)

    axes = (0, 0, 0, 0, None if gods.sliding is None else 0, 0)
    offset, sliding, touch = jax.vmap(one, in_axes=axes)(
        found.point, found.normal, depth, offset, gods.sliding, slip
    )
    seen = jnp.where(active, depth, jnp.where(found.admissible, jnp.minimum(found.depth, 0), 0))
    gods = GodObject(jnp.where(active[:, None], offset, 0), seen, sliding)
    return gods, touch, places, rotation.turn(b.placed.matrix, touch.force)
