"""Several fingers on one object: residual force and torque, two-point torsion, dead band (MHS sections 3 and 5)."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from . import safe
from ._validate import as_float, check_not_negative, check_positive
from .body import Wrench


class GravityDrop(eqx.Module):
    """Two-point torsion, MHS section 3.2, solution 2.

    While exactly two fingers touch an object, its net torque about the line through the two god-objects is scaled by
    1 - A / A_crit, not below 0, where A is the mean area of the two friction circles, pi (mu d)^2. With A >= A_crit
    nothing turns about that line. (MHS's bracket is read as a dot product with the line's direction.)

    **Arguments:** `critical_area`, A_crit in m^2, above 0; `twist_damping` about the grasp's line in N m s/rad, 0 or
    above: without it the object swings for ever. `None`: none.
    """

    critical_area: Float[Array, ""] = eqx.field(converter=as_float)
    twist_damping: Float[Array, ""] | None = eqx.field(converter=as_float, default=None)

    def __check_init__(self):
        check_positive("critical_area", self.critical_area, unit="m^2")
        if self.twist_damping is not None:
            check_not_negative("twist_damping", self.twist_damping, unit="N m s/rad")


class Twist(eqx.Module):
    """The line through a two-finger grasp: its unit direction, 0 without such a grasp, and what of the torque is left.

    `free` is max(0, 1 - A / A_crit); at 0 the line is locked.
    """

    axis: Float[Array, "3"]
    free: Float[Array, ""]


def residual(forces: Float[Array, "n 3"], arms: Float[Array, "n 3"]) -> Wrench:
    """Sum of forces (N) and of torques (N m) that act at `arms` (m) from the centre of mass (MHS section 3)."""
    return Wrench(jnp.sum(forces, axis=0), jnp.sum(jnp.cross(arms, forces), axis=0))


def twist_of(
    torsion: GravityDrop,
    god_objects: Float[Array, "F 3"],
    circles: Float[Array, "F"],
    touching: Bool[Array, "F"],
) -> Twist:
    """The twist axis of a grasp. `god_objects` (m) in the world frame, `circles` their radii mu d (m)."""
    two = jnp.sum(touching, dtype=jnp.int32) == 2
    first = jnp.argmax(touching)
    last = touching.shape[0] - 1 - jnp.argmax(touching[::-1])
    line = jnp.where(two, god_objects[last] - god_objects[first], 0)
    area = jnp.pi * (circles[first] ** 2 + circles[last] ** 2) / 2
    free = jnp.where(two, jnp.maximum(1 - area / torsion.critical_area, 0), 1)
    return Twist(safe.normalise(line), free)


def resist(
    torsion: GravityDrop, twist: Twist, torque: Float[Array, "3"], spin: Float[Array, "3"]
) -> Float[Array, "3"]:
    """The torque (N m) that is left of `torque` in a two-finger grasp; MHS's T - (T.u) u min(A / A_crit, 1)."""
    about = (twist.free - 1) * jnp.sum(torque * twist.axis)
    if torsion.twist_damping is not None:
        about = about - torsion.twist_damping * jnp.sum(spin * twist.axis)
    return torque + about * twist.axis


def lock(twist: Twist, spin: Float[Array, "3"]) -> Float[Array, "3"]:
    """The spin (rad/s) without its part about a locked grasp's line."""
    locked = jnp.where(twist.free == 0, jnp.sum(spin * twist.axis), 0)
    return spin - locked * twist.axis


def dead_band(torque: Float[Array, "3"], critical_torque: Float[Array, ""]) -> Float[Array, "3"]:
    """No torque at all where |T| <= T_crit (MHS section 5), N m."""
    return jnp.where(safe.norm(torque) <= critical_torque, 0, torque)
