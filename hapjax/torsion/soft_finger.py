"""Fingertips with an area: Coulomb friction in twist about each finger's surface normal."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .. import safe
from .._validate import as_float, check_not_negative, check_positive
from ._torsion import Grip, Held, Torsion


class SoftFinger(Torsion):
    """Coulomb friction in twist: each finger resists the object's turning about the surface's normal at the finger.

    The friction cone in one angle. While a finger touches, its god-angle is how far the object has turned about the
    normal since first touch; the torque on the object is -(stiffness times the angle, plus the damping times the
    rate), limited to `torsional_mu` times the normal force, and the angle is set to what explains the limited torque.
    It serves one finger and many alike.

    **Arguments:**

    - `torsional_mu`: m, 0 or above: the limit torque for each N of normal force. A round patch of radius a that is
      pressed evenly has 2/3 mu a, Hertz's pressure 3 pi / 16 mu a.
    - `stiffness`: N m/rad, above 0.
    - `twist_damping`: N m s/rad, 0 or above. `None`: none.
    """

    torsional_mu: Float[Array, ""] = eqx.field(converter=as_float)
    stiffness: Float[Array, ""] = eqx.field(converter=as_float)
    twist_damping: Float[Array, ""] | None = eqx.field(converter=as_float, default=None)

    def __check_init__(self):
        check_not_negative("torsional_mu", self.torsional_mu, unit="m")
        check_positive("stiffness", self.stiffness, unit="N m/rad")
        if self.twist_damping is not None:
            check_not_negative("twist_damping", self.twist_damping, unit="N m s/rad")

    def start(self, hip: Float[Array, "F 3"]) -> Float[Array, "F"]:
        """No finger is twisted before it touches."""
        return jnp.zeros_like(hip[:, 0])

    def hold(
        self,
        grip: Grip,
        angle: Float[Array, "F"] | None,
        torque: Float[Array, "3"],
        spin: Float[Array, "3"],
        gimbal_rate: Float[Array, "F"] | None,
        dt: Float[Array, ""],
    ) -> Held:
        """The torque with the fingers' own added, and the god-angles; see `Torsion.hold`."""
        assert angle is not None
        rate = jnp.sum(grip.normal * spin[None, :], axis=-1)
        # The spin is what the object has just turned with; at first touch the angle is 0.
        angle = jnp.where(grip.touched, angle + dt * rate, 0)
        pull = self.stiffness * angle
        if self.twist_damping is not None:
            pull = pull + self.twist_damping * rate
        limit = self.torsional_mu * grip.normal_force
        size = jnp.abs(pull)
        dragged = size > limit
        held = jnp.where(dragged, pull * safe.divide(limit, size), pull)
        angle = jnp.where(dragged, held / self.stiffness, angle)
        own = -jnp.sum(jnp.where(grip.touching, held, 0)[:, None] * grip.normal, axis=0)
        return Held(torque + own, None, jnp.where(grip.touching, angle, 0))
