"""Accelerations about a pivot near the contacts: MHS section 6."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from .. import body as rigid
from .. import rotation
from ..body import Body, Motion, Wrench
from ..shape import Shape
from ..torsion import Twist, lock
from .semi_implicit import SemiImplicit


class PivotForm(SemiImplicit):
    """Semi-implicit Euler of the velocity of a pivot in place of the centre of mass's (MHS section 6).

    The pivot is the point of the body at the mean of the god-objects of the fingers that touch, else its centre of
    mass. It moves straight on in a step, and the body turns about it; a locked grasp's line goes through it. A held
    object then swings about the fingers, and not about its centre with the fingers pulling that back.
    """

    needs_pivot = True

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
        if motion.spin is None or pivot is None:
            return super().advance(body, shape, motion, wrench, gyroscopic, twist, dt)
        matrix = rotation.to_matrix(motion.orientation)
        arm = rigid.centre_of(body, shape, motion.position, matrix) - pivot
        # The spatial inertia at the pivot, solved for the accelerations there: those of the centre of mass, carried over.
        turning = rigid.angular_acceleration(
            rigid.inertia_of(body, shape), matrix, motion.spin, wrench.torque, gyroscopic
        )
        centripetal = jnp.cross(motion.spin, jnp.cross(motion.spin, arm))
        acceleration = wrench.force / body.mass - jnp.cross(turning, arm) - centripetal

        velocity = motion.velocity - jnp.cross(motion.spin, arm) + dt * acceleration
        spin = motion.spin + dt * turning
        if twist is not None:
            spin = lock(twist, spin)
        orientation = rotation.normalise(self.turn(motion.orientation, spin, dt))
        turned = rotation.to_matrix(orientation)
        from_pivot = rotation.turn(turned, rotation.turn_back(matrix, motion.position - pivot))
        position = pivot + dt * velocity + from_pivot
        after = rotation.turn(turned, rotation.turn_back(matrix, arm))
        return Motion(position, orientation, velocity + jnp.cross(spin, after), spin)
