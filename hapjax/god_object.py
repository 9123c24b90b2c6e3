"""One point that touches one surface: MHS section 2, steps 1 to 5.

The point is a finger's haptic interface point (HIP) or a point of another object; the same code serves both.
"""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .shape import Mesh, Shape, SurfacePoint, Track
from .surface import Surface


class GodObject(eqx.Module):
    """The memory of a touching point, in the touched object's frame.

    `point` (m) is the god-object; out of contact it is the touching point itself. Of a ball, and of edges that cross, it is
    the offset from where they touch, as that wanders over the material. `depth` (m) is that of the last
    step; above 0 means that the point was in contact. `sliding` is what the friction law remembers (of static and
    kinetic friction, 1 while the god-object is dragged, else 0) and `track` what the shape does; each is `None` where
    that is nothing. `own` (m) is where a touching point that wanders over its object's material was in that object's
    frame; of a ball in a hollow, the way from its centre, in the touched object's.
    """

    point: Float[Array, "*n 3"]
    depth: Float[Array, "*n"]
    sliding: Float[Array, "*n"] | None
    track: Track | None = None
    own: Float[Array, "*n 3"] | None = None


class Touch(eqx.Module):
    """What a touch does, in the touched object's frame: N, on the touching point.

    `force` = `normal_force` times the outward normal + `friction_force`. `circle` is mu times the depth, m: the
    radius of MHS's friction circle.
    """

    force: Float[Array, "*n 3"]
    normal_force: Float[Array, "*n"]
    friction_force: Float[Array, "*n 3"]
    circle: Float[Array, "*n"]


def start(shape: Shape, surface: Surface, points: Float[Array, "n 3"]) -> GodObject:
    """God-objects of points that have touched nothing yet."""
    sliding = jnp.zeros_like(points[:, 0]) if surface.remembers() else None
    return GodObject(points, jnp.zeros_like(points[:, 0]), sliding, jax.vmap(shape.start)(points))


class Grip(eqx.Module):
    """A normal force (N) by which friction is limited: that of the contact's spring alone, and with its loss."""

    spring: Float[Array, "*n"]
    whole: Float[Array, "*n"]


class Meeting(eqx.Module):
    """Points at one surface whose places are known, before the law of touch has spoken; in the surface's frame.

    `near`: the surface points that belong to them. `offset` (m): their god-objects from those, before friction has moved
    them. `sliding`: what friction remembered. `rounding` (m): differences of positions up to this are errors of
    arithmetic. `velocity` (m/s): that of the points against the surface, where it is needed. `grip`: the normal
    force by which friction is limited; `None`: that of the touch itself.
    """

    surface: Surface
    near: SurfacePoint
    offset: Float[Array, "*n 3"]
    sliding: Float[Array, "*n"] | None
    rounding: Float[Array, "*n"]
    velocity: Float[Array, "*n 3"] | None
    grip: Grip | None = None


class Pressed(eqx.Module):
    """What the law of touch answers: the god-objects' new offsets (m), what friction remembers, and the touches."""

    offset: Float[Array, "*n 3"]
    sliding: Float[Array, "*n"] | None
    touch: Touch


def touch(
    shape: Shape,
    surface: Surface,
    god: GodObject,
    point: Float[Array, "3"],
    velocity: Float[Array, "3"] | None,
    dt: Float[Array, ""] | None,
) -> tuple[GodObject, Touch]:
    """The force on a point that touches a surface, and where its god-object goes.

    In contact (depth d > 0) the normal force is k d (1 + c d'), not below 0 (Hunt and Crossley 1975), and the
    tangential one k times the god-object's offset, plus k d c times the slip velocity, limited by the friction cone;
    or what another friction law makes of them. At first touch the god-object is the surface point.

    **Arguments:** `point` (m) and its `velocity` against the surface (m/s), both in the touched object's frame, and
    the step `dt` (s); the latter two are only read where the surface `needs_velocity`.
    """
    track, near = shape.follow(god.track, point)
    one = jax.tree.map(lambda x: x[None], (god, near, point, velocity))
    meeting = meet(surface, *one)
    pressed = press(meeting, dt)
    gods = keep(meeting, pressed, point[None], None)
    after, result = jax.tree.map(lambda x: x[0], (gods, pressed.touch))
    return GodObject(after.point, after.depth, after.sliding, track), result


def or_apart(
    shape: Shape, near: SurfacePoint, points: Float[Array, "n 3"]
) -> tuple[SurfacePoint, Bool[Array, "n"]]:
    """The surface points that hold points (m), of those that touch nothing the closest ones, with depths up to 0.

    Also which points have a depth. One that came in by no face has none, nor one far from a mesh: see
    `Mesh.closest_within`.
    """
    apart = near.depth <= 0
    if isinstance(shape, Mesh):
        closest, found = jax.vmap(shape.closest_within)(points, apart)
        closest = dataclasses.replace(closest, corner=near.corner)
    else:
        closest, found = jax.vmap(shape.closest)(points), True
    outside = apart & found & (closest.depth <= 0)

    def pick(out, held):
        return jnp.where(outside.reshape(outside.shape + (1,) * (held.ndim - 1)), out, held)

    return jax.tree.map(pick, closest, near), outside | (near.depth > 0)


def meet(
    surface: Surface,
    gods: GodObject,
    near: SurfacePoint,
    points: Float[Array, "n 3"],
    velocity: Float[Array, "n 3"] | None,
) -> Meeting:
    """Points (m) whose surface points `near` are known, and where their god-objects are from there."""
    offset = jnp.where((gods.depth > 0)[:, None], gods.point - near.point, 0)
    reach = jnp.max(jnp.abs(points), axis=-1) + jnp.max(jnp.abs(gods.point), axis=-1)
    return Meeting(surface, near, offset, gods.sliding, 8 * jnp.finfo(points.dtype).eps * reach, velocity)


def press(meeting: Meeting, dt: Float[Array, ""] | None) -> Pressed:
    """The law of touch at each of the points; the step `dt` (s) is read where the surface's law does so."""

    def one(near, offset, sliding, rounding, velocity, grip, factor):
        felt = meeting.surface.of_finger(factor)
        return _press(felt, near, offset, sliding, rounding, velocity, grip, dt)

    m = meeting
    factors = m.surface.finger_mu
    return jax.vmap(one)(m.near, m.offset, m.sliding, m.rounding, m.velocity, m.grip, factors)


def keep(meeting: Meeting, pressed: Pressed, points: Float[Array, "n 3"], track: Track | None) -> GodObject:
    """The god-objects after a touch."""
    in_contact = meeting.near.depth > 0
    held = jnp.where(in_contact[:, None], meeting.near.point + pressed.offset, points)
    return GodObject(held, jnp.where(in_contact, meeting.near.depth, 0), pressed.sliding, track)


def _press(surface: Surface, near: SurfacePoint, offset, sliding, rounding, velocity, grip, dt) -> Pressed:
    in_contact = near.depth > 0
    depth = jnp.where(in_contact, near.depth, 0)
    normal = near.normal
    normal_force = surface.stiffness * depth
    travel = viscous = None
    if velocity is not None:
        deepening = -jnp.sum(normal * velocity)
        slip = velocity + deepening * normal
        if surface.damping is not None:
            viscous = -surface.damping * (normal_force if grip is None else grip.spring) * slip
            normal_force = normal_force * jnp.maximum(1 + surface.damping * deepening, 0)
        if surface.law().needs_travel:
            assert dt is not None
            travel = slip * dt

    offset = offset - jnp.sum(offset * normal) * normal
    pressing = normal_force if grip is None else grip.whole
    law = surface.hold(near, offset, pressing, viscous, travel, sliding, rounding, dt)
    # Under the grip of the step before, friction must not end where the touch does: a force that jumps has no potential.
    friction_force = law.force if grip is not None else jnp.where(in_contact, law.force, 0)
    force = normal_force * normal + friction_force
    circle = surface.static_at(near, friction_force) * depth
    remembered = None if law.sliding is None else jnp.where(in_contact, law.sliding, 0)
    return Pressed(law.offset, remembered, Touch(force, normal_force, friction_force, circle))
