"""Several fingers on one object: residual force and torque, pivot, dead band (MHS sections 3, 5 and 6)."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from . import rotation, safe
from .body import Wrench


def residual(forces: Float[Array, "n 3"], arms: Float[Array, "n 3"]) -> Wrench:
    """Sum of forces (N) and of torques (N m) that act at `arms` (m) from the centre of mass (MHS section 3)."""
    # One sum for both. A force is a sum itself, of a turned one's components; the compiler would make one sum of the two,
    # and compute the touches in it once for each component.
    levers = jnp.concatenate([jnp.ones_like(arms[:, :1]), arms], axis=1)
    moments = jnp.sum(levers[:, :, None] * forces[:, None, :], axis=0)
    return Wrench(moments[0], rotation.cross_of_dyads(moments[1:]))


def pivot(
    god_objects: Float[Array, "F 3"], touching: Bool[Array, "F"], centre: Float[Array, "3"]
) -> Float[Array, "3"]:
    """The mean of the god-objects (m) of the fingers that touch, else the centre of mass (MHS section 6)."""
    number = jnp.sum(touching.astype(god_objects.dtype))
    mean = jnp.sum(jnp.where(touching[:, None], god_objects, 0), axis=0) / jnp.maximum(number, 1)
    return jnp.where(number > 0, mean, centre)


def dead_band(torque: Float[Array, "3"], critical_torque: Float[Array, ""]) -> Float[Array, "3"]:
    """No torque at all where |T| <= T_crit (MHS section 5), N m."""
    return jnp.where(safe.norm(torque) <= critical_torque, 0, torque)
