"""What a torsion model is told of a grasp, and what it answers."""

from abc import abstractmethod
from typing import ClassVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float


class Grip(eqx.Module):
    """All fingers on one object in one step, world frame.

    `point` (F, 3) m, the god-objects from the object's origin; `normal` (F, 3), the outward normals of the surface
    there, 0 where nothing touches; `normal_force` (F,) N; `circle` (F,) m, the radii mu d of the friction circles;
    `touching` (F,), and `touched`, whether they did in the step before.
    """

    point: Float[Array, "F 3"]
    normal: Float[Array, "F 3"]
    normal_force: Float[Array, "F"]
    circle: Float[Array, "F"]
    touching: Bool[Array, "F"]
    touched: Bool[Array, "F"]


class Twist(eqx.Module):
    """The line through a two-finger grasp: its unit direction, 0 without such a grasp, and what of the torque is left.

    `free` is max(0, 1 - A / A_crit); at 0 the line is locked. `rate` (rad/s) is what a locked line turns with, where
    gimbals turn it; `None`: it stands still.
    """

    axis: Float[Array, "3"]
    free: Float[Array, ""]
    rate: Float[Array, ""] | None = None


class Held(eqx.Module):
    """What a torsion model leaves of the torque (N m), the line that it may lock, and each finger's god-angle (rad)."""

    torque: Float[Array, "3"]
    twist: Twist | None = None
    angle: Float[Array, "F"] | None = None


class Torsion(eqx.Module):
    """How a grasp resists turning.

    `needs_gimbal`: it reads the angles of the fingers' gimbals. `least_fingers`: with fewer it does nothing.
    """

    needs_gimbal: ClassVar[bool] = False
    least_fingers: ClassVar[int] = 1

    def start(self, hip: Float[Array, "F 3"]) -> Float[Array, "F"] | None:
        """The god-angles (rad) before the first touch. `None`: the model remembers none."""
        return None

    @abstractmethod
    def hold(
        self,
        grip: Grip,
        angle: Float[Array, "F"] | None,
        torque: Float[Array, "3"],
        spin: Float[Array, "3"],
        gimbal_rate: Float[Array, "F"] | None,
        dt: Float[Array, ""],
    ) -> Held:
        """What the model makes of the fingers' `torque` (N m) on an object that turns with `spin` (rad/s).

        **Arguments:** `angle` (rad), the god-angles of the last step, where there are any; `gimbal_rate` (rad/s) of
        each finger's gimbal, where the model needs it; the step `dt` (s).
        """


def lock(twist: Twist, spin: Float[Array, "3"]) -> Float[Array, "3"]:
    """The spin (rad/s), its part about a locked grasp's line replaced by that of the line."""
    about = jnp.sum(spin * twist.axis)
    held = jnp.zeros_like(about) if twist.rate is None else twist.rate
    return spin + jnp.where(twist.free == 0, held - about, 0) * twist.axis
