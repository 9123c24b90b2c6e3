"""Friction of points dragged over a plane: their motion and their loads are known, nothing is integrated.

For identification from recordings of an object that slides on feet: where the feet went and what they carry
is measured, the friction they feel is wanted.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from . import friction
from .errors import InputError
from .shape import Plane
from .surface import Surface


def drag(surface: Surface, points: Float[Array, "T V 3"], loads: Float[Array, " V"]) -> Float[Array, "T V 3"]:
    """The friction force (N) of a plane on V points pressed onto it, at each of T times of their motion.

    Each point has a god-object that starts at the point and is then dragged by MHS's friction circle (section
    2) with the radius mu load / stiffness. The stiffer the surface, the closer to Coulomb's law for rigid
    bodies; the forces depend on the path alone, not on how fast it is passed.

    **Arguments:**

    - `surface`: its mu, or mu_static and mu_kinetic, and its stiffness, here the tangential one (N/m).
    - `points`: m, in the plane's frame (normal +z); their heights are not read.
    - `loads`: the normal force on each point, N, 0 or above, the same at all times.

    **Raises:** `InputError` for a surface with damping, whose force would need the motion's clock, or with a
    list of mu that is not of one face.
    """
    surface.check_faces(Plane.faces)
    if surface.damping is not None:
        raise InputError("damping is given; allowed for points with known loads: a surface without")
    face = jnp.zeros((), jnp.int32)
    static, kinetic = surface.static_at(face), surface.kinetic_at(face)
    in_plane = jnp.array([1, 1, 0], points.dtype)

    def one(god, sliding, point, load):
        law = friction.cone(
            (god - point) * in_plane,
            surface.stiffness,
            None,
            static * load,
            None if kinetic is None else kinetic * load,
            None if kinetic is None else sliding,
            rounding=8 * jnp.finfo(point.dtype).eps * (jnp.max(jnp.abs(point)) + jnp.max(jnp.abs(god))),
        )
        return point + law.offset, law.dragged.astype(point.dtype), law.force

    def all_points(memory, now):
        god, sliding = memory
        god, sliding, force = jax.vmap(one)(god, sliding, now, loads)
        return (god, sliding), force

    return jax.lax.scan(all_points, (points[0], jnp.zeros_like(loads)), points)[1]
