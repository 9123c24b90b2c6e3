"""Semi-implicit Euler: velocities first, then positions with the new velocities. First order."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from .. import body as rigid
from .. import rotation
from ..body import Body, Motion, Wrench
from ..shape import Shape
from ..torsion import Twist, lock
from ._integrator import Integrator


class SemiImplicit(Integrator):
    """Semi-implicit Euler with the exact exponential map for the rotation."""

    def advance(
        self,
        body: Body,
        shape: Shape,
        motion: Motion,
        wrench: Wrench,
        gyroscopic: bool,
        twist: Twist | None,
        dt: Float[Array, ""],
        pivot: Float[Array, "3"] | None = None,
    ) -> Motion:
        """One step; see `Integrator.advance`."""
        velocity = motion.velocity + dt * wrench.force / body.mass
        if motion.spin is None:
            return Motion(motion.position + dt * velocity, motion.orientation, velocity, None)
        matrix = rotation.to_matrix(motion.orientation)
        inertia = rigid.inertia_of(body, shape)
        spin = motion.spin + dt * rigid.angular_acceleration(
            inertia, matrix, motion.spin, wrench.torque, gyroscopic
        )
        if twist is not None:
            spin = lock(twist, spin)
        orientation = rotation.normalise(self.turn(motion.orientation, spin, dt))
        position = motion.position + dt * velocity
        centre = rigid.centre_within(body, shape)
        if centre is not None:  # it is the centre of mass that moves straight on
            position = position + rotation.turn(matrix - rotation.to_matrix(orientation), centre)
        return Motion(position, orientation, velocity, spin)

    def turn(
        self, orientation: Float[Array, "4"], spin: Float[Array, "3"], dt: Float[Array, ""]
    ) -> Float[Array, "4"]:
        """R = exp(S dt) R_old, with S the cross-product matrix of the world-frame spin."""
        return rotation.product(rotation.from_rotation_vector(spin * dt), orientation)


class SemiImplicitMatrix(SemiImplicit):
    """Semi-implicit Euler with MHS's rotation update (section 3), its factors in the right order."""

    def turn(
        self, orientation: Float[Array, "4"], spin: Float[Array, "3"], dt: Float[Array, ""]
    ) -> Float[Array, "4"]:
        """R = (I + S dt) R_old, then Gram-Schmidt on the columns.

        MHS writes R_old (I + S dt) with the world-frame spin; that turns about the body's axes and does not converge.
        """
        old = rotation.to_matrix(orientation)
        columns = old.T + dt * jnp.cross(jnp.broadcast_to(spin, (3, 3)), old.T)
        x = columns[0] / jnp.sqrt(jnp.sum(columns[0] ** 2))
        y = columns[1] - jnp.sum(columns[1] * x) * x
        y = y / jnp.sqrt(jnp.sum(y**2))
        new = rotation.from_matrix(jnp.stack([x, y, jnp.cross(x, y)], axis=1))
        # q and -q are one rotation; a path of poses is to go on with the nearer of the two.
        return jnp.where(jnp.sum(new * orientation) < 0, -new, new)
