"""Friction of points dragged over a plane: their motion and their loads are known, nothing is integrated.

For identification from recordings of an object that slides on feet: where the feet went and what they carry
is measured, the friction they feel is wanted.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .errors import InputError
from .shape import Plane
from .surface import Surface


def drag(
    surface: Surface, points: Float[Array, "T V 3"], loads: Float[Array, " V"], dt: Any = None
) -> Float[Array, "T V 3"]:
    """The friction force (N) of a plane on V points pressed onto it, at each of T times of their motion.

    Each point has a god-object that starts at the point and is then moved by the surface's friction law: with the
    cone, dragged by MHS's friction circle (section 2) of the radius mu load / stiffness. The stiffer the surface, the
    closer to Coulomb's law for rigid bodies.

    **Arguments:**

    - `surface`: its mu, or mu_static and mu_kinetic, its stiffness, here the tangential one (N/m), its law.
    - `points`: m, in the plane's frame (normal +z); their heights are not read.
    - `loads`: the normal force on each point, N, 0 or above, the same at all times.
    - `dt`: s between the times, for a surface with damping or a law that depends on velocity; the forces of others,
      the cone and Dahl's law, depend on the path alone.

    **Raises:** `InputError` where such a surface is given without `dt`, a list of mu that is not of one
    face, or a `finger_mu`.
    """
    surface.check_faces(Plane.faces)
    if surface.finger_mu is not None:
        raise InputError("finger_mu is given, but no finger drags; allowed: a surface without it")
    law = surface.law()
    if (surface.damping is not None or law.needs_dt) and dt is None:
        raise InputError(
            "dt is missing; allowed: the time between points, for a surface whose friction depends on velocity"
        )
    clock = None if dt is None else jnp.asarray(dt, points.dtype)
    in_plane = jnp.array([1, 1, 0], points.dtype)
    near = Plane().closest(jnp.zeros_like(in_plane))

    def one(god, sliding, point, load, before):
        travel = viscous = None
        if surface.needs_velocity():
            travel = (point - before) * in_plane
            viscous = None if surface.damping is None else -surface.damping * load * travel / clock
        rounding = 8 * jnp.finfo(point.dtype).eps * (jnp.max(jnp.abs(point)) + jnp.max(jnp.abs(god)))
        offset = (god - point) * in_plane
        result = surface.hold(near, offset, load, viscous, travel, sliding, rounding, clock)
        return point + result.offset, result.sliding, result.force

    def all_points(memory, now):
        god, sliding, before = memory
        god, sliding, force = jax.vmap(one)(god, sliding, now, loads, before)
        return (god, sliding, now), force

    sliding = jnp.zeros_like(loads) if surface.remembers() else None
    return jax.lax.scan(all_points, (points[0], sliding, points[0]), points)[1]
