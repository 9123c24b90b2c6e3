"""One point that touches one surface: MHS section 2, steps 1 to 5.

The point is a finger's haptic interface point (HIP) or a point of another object; the same code serves both.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .shape import Shape, SurfacePoint, Track
from .surface import Surface


class GodObject(eqx.Module):
    """The memory of a touching point, in the touched object's frame.

    `point` (m) is the god-object; out of contact it is the touching point itself. `depth` (m) is that of the last
    step; above 0 means that the point was in contact. `sliding` is what the friction law remembers (of static and
    kinetic friction, 1 while the god-object is dragged, else 0) and `track` what the shape does; each is `None` where
    that is nothing.
    """

    point: Float[Array, "*n 3"]
    depth: Float[Array, "*n"]
    sliding: Float[Array, "*n"] | None
    track: Track | None = None


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
    return answer(surface, god, track, near, point, velocity, dt)


def answer(
    surface: Surface,
    god: GodObject,
    track: Track | None,
    near: SurfacePoint,
    point: Float[Array, "3"],
    velocity: Float[Array, "3"] | None,
    dt: Float[Array, ""] | None,
) -> tuple[GodObject, Touch]:
    """`touch` of a point whose surface point `near` is known."""
    offset = jnp.where(god.depth > 0, god.point - near.point, 0)
    rounding = 8 * jnp.finfo(point.dtype).eps * (jnp.max(jnp.abs(point)) + jnp.max(jnp.abs(god.point)))
    offset, sliding, result = press(surface, near, offset, god.sliding, velocity, dt, rounding)
    in_contact = near.depth > 0
    held = jnp.where(in_contact, near.point + offset, point)
    depth = jnp.where(in_contact, near.depth, 0)
    return GodObject(held, depth, sliding, track), result


def press(
    surface: Surface,
    near: SurfacePoint,
    offset: Float[Array, "3"],
    sliding: Float[Array, ""] | None,
    velocity: Float[Array, "3"] | None,
    dt: Float[Array, ""] | None,
    rounding: Float[Array, ""],
) -> tuple[Float[Array, "3"], Float[Array, ""] | None, Touch]:
    """The law of a touch: the god-object's new offset from the surface point, what friction remembers, the force.

    **Arguments:** `offset` (m), the god-object from the surface point before; `sliding`, what friction remembered;
    the others as for `touch`.
    """
    in_contact = near.depth > 0
    depth = jnp.where(in_contact, near.depth, 0)
    normal = near.normal
    normal_force = surface.stiffness * depth
    travel = viscous = None
    if velocity is not None:
        deepening = -jnp.sum(normal * velocity)
        slip = velocity + deepening * normal
        if surface.damping is not None:
            viscous = -surface.damping * normal_force * slip
            normal_force = normal_force * jnp.maximum(1 + surface.damping * deepening, 0)
        if surface.law().needs_travel:
            assert dt is not None
            travel = slip * dt

    offset = offset - jnp.sum(offset * normal) * normal
    law = surface.hold(near, offset, normal_force, viscous, travel, sliding, rounding, dt)
    friction_force = jnp.where(in_contact, law.force, 0)
    force = normal_force * normal + friction_force
    circle = surface.static_at(near, friction_force) * depth
    remembered = None if law.sliding is None else jnp.where(in_contact, law.sliding, 0)
    return law.offset, remembered, Touch(force, normal_force, friction_force, circle)
