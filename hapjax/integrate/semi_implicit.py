"""Semi-implicit Euler: velocities first, then positions with the new velocities. First order."""

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
