"""Two-point torsion by the area of the friction circles: MHS section 3.2, solution 2."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .. import safe
from .._validate import as_float, check_not_negative, check_positive
from ._torsion import Grip, Held, Torsion, Twist


class GravityDrop(Torsion):
    """Two-point torsion, MHS section 3.2, solution 2.

    While exactly two fingers touch an object, its net torque about the line through the two god-objects is scaled by
    1 - A / A_crit, not below 0, where A is the mean area of the two friction circles, pi (mu d)^2. With A >= A_crit
    nothing turns about that line. (MHS's bracket is read as a dot product with the line's direction.)

    **Arguments:** `critical_area`, A_crit in m^2, above 0; `twist_damping` about the grasp's line in N m s/rad, 0 or
    above: without it the object swings for ever. `None`: none.
    """

    critical_area: Float[Array, ""] = eqx.field(converter=as_float)
    twist_damping: Float[Array, ""] | None = eqx.field(converter=as_float, default=None)

    least_fingers = 2

    def __check_init__(self):
        check_positive("critical_area", self.critical_area, unit="m^2")
        if self.twist_damping is not None:
            check_not_negative("twist_damping", self.twist_damping, unit="N m s/rad")

    def hold(
        self,
        grip: Grip,
        angle: Float[Array, "F"] | None,
        torque: Float[Array, "3"],
        spin: Float[Array, "3"],
        gimbal_rate: Float[Array, "F"] | None,
        dt: Float[Array, ""],
    ) -> Held:
        """MHS's T - (T . u) u min(A / A_crit, 1), less the damping; see `Torsion.hold`."""
        twist = self.twist_of(grip, gimbal_rate)
        about = (twist.free - 1) * jnp.sum(torque * twist.axis)
        if self.twist_damping is not None:
            slip = jnp.sum(spin * twist.axis)
            slip = slip if twist.rate is None else slip - twist.rate
            about = about - self.twist_damping * slip
        return Held(torque + about * twist.axis, twist)

    def twist_of(self, grip: Grip, gimbal_rate: Float[Array, "F"] | None) -> Twist:
        """The line of a grasp of two fingers, from the first to the last of those that touch, and what it leaves."""
        two = jnp.sum(grip.touching, dtype=jnp.int32) == 2
        first = jnp.argmax(grip.touching)
        last = grip.touching.shape[0] - 1 - jnp.argmax(grip.touching[::-1])
        line = jnp.where(two, grip.point[last] - grip.point[first], 0)
        area = jnp.pi * (grip.circle[first] ** 2 + grip.circle[last] ** 2) / 2
        free = jnp.where(two, jnp.maximum(1 - area / self.critical_area, 0), 1)
        rate = None if gimbal_rate is None else (gimbal_rate[first] + gimbal_rate[last]) / 2
        return Twist(safe.normalise(line), free, rate)
