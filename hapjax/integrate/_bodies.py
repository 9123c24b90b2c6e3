"""All moving objects at once: what an integrator that looks ahead computes with."""

from collections.abc import Mapping

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from .. import body as rigid
from .. import rotation
from ..body import Body, Motion, Wrench
from ..link import Rates
from ..shape import Shape


class Bodies(eqx.Module):
    """The moving objects by name, and what acts on them beside touches.

    `parts`: each one's body and shape; `matrix`: its rotation; `centre` (m): its centre of mass.
    """

    parts: Mapping[str, tuple[Body, Shape]]
    motion: Mapping[str, Motion]
    matrix: Mapping[str, Float[Array, "3 3"]]
    centre: Mapping[str, Float[Array, "3"]]
    gravity: Float[Array, "3"] | None
    gyroscopic: bool = eqx.field(static=True)

    def rates(self) -> Rates:
        """Their velocities now."""
        return {name: (motion.velocity, motion.spin) for name, motion in self.motion.items()}

    def moving_at(self, rates: Rates) -> dict[str, Motion]:
        """The objects where they are, with other velocities."""
        return {
            name: Motion(motion.position, motion.orientation, *rates[name])
            for name, motion in self.motion.items()
        }

    def pushed(self, rates: Rates, wrenches: Mapping[str, Wrench], dt: Float[Array, ""]) -> Rates:
        """The velocities after wrenches have acted for `dt` s."""
        after = dict(rates)
        for name, wrench in wrenches.items():
            (body, shape), (velocity, spin) = self.parts[name], rates[name]
            velocity = velocity + dt * wrench.force / body.mass
            if spin is not None:
                inertia = rigid.inertia_of(body, shape)
                spin = spin + dt * rigid.angular_acceleration(
                    inertia, self.matrix[name], spin, wrench.torque, False
                )
            after[name] = (velocity, spin)
        return after

    def weights(self) -> dict[str, Wrench]:
        """Gravity on each of them; empty where there is none."""
        if self.gravity is None:
            return {}
        nothing = jnp.zeros_like(self.gravity)
        return {name: Wrench(body.mass * self.gravity, nothing) for name, (body, _) in self.parts.items()}

    def momenta(self, rates: Rates) -> Rates:
        """Linear (kg m/s) and angular momenta (kg m^2/s) of these velocities."""
        found = {}
        for name, (velocity, spin) in rates.items():
            body, shape = self.parts[name]
            if spin is not None:
                spin = rotation.turn(
                    self.matrix[name],
                    rigid.momentum(
                        rigid.inertia_of(body, shape), rotation.turn_back(self.matrix[name], spin)
                    ),
                )
            found[name] = (body.mass * velocity, spin)
        return found
