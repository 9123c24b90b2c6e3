"""One point that touches one surface: MHS section 2, steps 1 to 5.

The point is a finger's haptic interface point (HIP) or an object's vertex; the same code serves both.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from . import friction
from .shape import Shape
from .surface import Surface


class GodObject(eqx.Module):
    """The memory of a touching point, in the touched object's frame.

    `point` (m) is the god-object; out of contact it is the touching point itself. `depth` (m) is that of the last
    step; above 0 means that the point was in contact. `sliding` (1 or 0) is kept only where static and kinetic
    friction differ.
    """

    point: Float[Array, "*n 3"]
    depth: Float[Array, "*n"]
    sliding: Float[Array, "*n"] | None


class Touch(eqx.Module):
    """What a touch does, in the touched object's frame: N, on the touching point.

    `force` = `normal_force` times the outward normal + `friction_force`. `circle` is mu times the depth, m: the
    radius of MHS's friction circle.
    """

    force: Float[Array, "*n 3"]
    normal_force: Float[Array, "*n"]
    friction_force: Float[Array, "*n 3"]
    circle: Float[Array, "*n"]


def start(surface: Surface, points: Float[Array, "n 3"]) -> GodObject:
    """God-objects of points that have touched nothing yet."""
    sliding = None if surface.mu_kinetic is None else jnp.zeros_like(points[:, 0])
    return GodObject(points, jnp.zeros_like(points[:, 0]), sliding)


def touch(
    shape: Shape,
    surface: Surface,
    god: GodObject,
    point: Float[Array, "3"],
    velocity: Float[Array, "3"] | None,
) -> tuple[GodObject, Touch]:
    """The force on a point that touches a surface, and where its god-object goes.

    In contact (depth d > 0) the normal force is k d (1 + c d'), not below 0 (Hunt and Crossley 1975), and the
    tangential one k times the god-object's offset, plus k d c times the slip velocity, limited by the friction cone.
    At first touch the god-object is the surface point.

    **Arguments:** `point` (m) and its `velocity` against the surface (m/s; only read where there is damping), both in
    the touched object's frame.
    """
    near = shape.closest(point)
    in_contact = near.depth > 0
    depth = jnp.where(in_contact, near.depth, 0)
    normal_force = surface.stiffness * depth
    viscous = None
    if surface.damping is not None and velocity is not None:
        deepening = -jnp.sum(near.normal * velocity)
        slip = velocity + deepening * near.normal
        viscous = -surface.damping * normal_force * slip
        normal_force = normal_force * jnp.maximum(1 + surface.damping * deepening, 0)

    offset = jnp.where(god.depth > 0, god.point - near.point, 0)
    offset = offset - jnp.sum(offset * near.normal) * near.normal
    static, kinetic = surface.static_at(near.face), surface.kinetic_at(near.face)
    law = friction.cone(
        offset,
        surface.stiffness,
        viscous,
        static * normal_force,
        None if kinetic is None else kinetic * normal_force,
        god.sliding,
        rounding=8 * jnp.finfo(point.dtype).eps * (jnp.max(jnp.abs(point)) + jnp.max(jnp.abs(god.point))),
    )
    held = jnp.where(in_contact, near.point + law.offset, point)
    sliding = None if god.sliding is None else (law.dragged & in_contact).astype(point.dtype)
    friction_force = jnp.where(in_contact, law.force, 0)
    force = normal_force * near.normal + friction_force
    return GodObject(held, depth, sliding), Touch(force, normal_force, friction_force, static * depth)
