"""Rigid bodies: mass, centre, inertia, and the Newton-Euler equations."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from . import rotation
from ._validate import as_float, check_number, check_positive, flag, is_traced
from .errors import InputError
from .shape import Shape


class Body(eqx.Module):
    """What an object resists motion with.

    **Arguments:**

    - `mass`: kg, above 0.
    - `inertia`: kg m^2 about the centre of mass along the object's axes: the three principal ones, or the symmetric 3x3
      matrix. `None`: that of uniform density.
    - `centre`: the centre of mass in the object's frame, m; needs an `inertia`. `None`: the shape's centre of mass.
    - `rotation`: `False` leaves rotation out: the object only translates.

    **Raises:** `InputError` where no real body has these numbers (the principal moments obey the triangle inequality).
    """

    mass: Float[Array, ""] = eqx.field(converter=as_float)
    inertia: Float[Array, "3"] | Float[Array, "3 3"] | None = eqx.field(converter=as_float, default=None)
    centre: Float[Array, "3"] | None = eqx.field(converter=as_float, default=None)
    rotation: bool = eqx.field(static=True, converter=flag("rotation"), default=True)

    def __check_init__(self):
        check_positive("mass", self.mass, unit="kg")
        if self.inertia is not None:
            check_number(
                "inertia", self.inertia, "three numbers or a 3x3 matrix in kg m^2", shape=(3,), other=(3, 3)
            )
            _check_inertia(self.inertia)
        if self.centre is not None:
            check_number("centre", self.centre, "three numbers in m", shape=(3,))
            if self.inertia is None:
                raise InputError(
                    "centre is given without inertia; allowed: both, or neither for uniform density"
                )
        if not self.rotation and not (self.inertia is None and self.centre is None):
            raise InputError(
                "rotation is false but inertia or centre is given; allowed: a body that turns, or neither"
            )

    @classmethod
    def of_density(cls, shape: Shape, density: Any, rotation: bool = True) -> "Body":
        """The body of a shape of uniform `density` (kg/m^3, above 0): mass, centre and inertia follow from it.

        **Raises:** `InputError` where the density is out of range, or the shape is unbounded.
        """
        density = as_float(density)
        check_positive("density", density, unit="kg/m^3")
        volume = shape.volume()
        if volume is None:
            raise InputError(
                f"density is given, but a {type(shape).__name__.lower()} has no volume; allowed: mass"
            )
        return cls(density.astype(volume.dtype) * volume, rotation=rotation)


class Motion(eqx.Module):
    """Where an object is and how it moves, in the world frame.

    `position` (m) is the origin of the object's frame, `orientation` its unit quaternion w x y z, `velocity` (m/s)
    that of the centre of mass, `spin` the angular velocity (rad/s), `None` where the body does not rotate.
    """

    position: Float[Array, "3"]
    orientation: Float[Array, "4"]
    velocity: Float[Array, "3"]
    spin: Float[Array, "3"] | None


class Wrench(eqx.Module):
    """Force (N) and torque about the centre of mass (N m) on a body, world frame."""

    force: Float[Array, "3"]
    torque: Float[Array, "3"]


def centre_within(body: Body, shape: Shape) -> Float[Array, "3"] | None:
    """The centre of mass in the object's frame, m: given, or that of uniform density. `None`: the frame's origin."""
    return shape.centre() if body.centre is None else body.centre


def centre_of(
    body: Body, shape: Shape, position: Float[Array, "3"], matrix: Float[Array, "3 3"]
) -> Float[Array, "3"]:
    """The centre of mass in the world frame, m."""
    centre = centre_within(body, shape)
    return position if centre is None else position + rotation.turn(matrix, centre)


def velocity_at(motion: Motion, arms: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
    """Velocity (m/s) of the body's points at `arms` (m) from its centre of mass, world frame."""
    if motion.spin is None:
        return jnp.broadcast_to(motion.velocity, arms.shape)
    turning = rotation.turn(rotation.cross_matrix(motion.spin), arms)
    return jnp.broadcast_to(motion.velocity, arms.shape) + turning


def inertia_of(body: Body, shape: Shape) -> Float[Array, "3"] | Float[Array, "3 3"]:
    """Inertia about the centre of mass along the object's axes, kg m^2: given, or that of uniform density."""
    if body.inertia is not None:
        return body.inertia
    per_mass = shape.inertia_per_mass()
    if per_mass is None:
        raise InputError(
            f"a body with the shape {type(shape).__name__.lower()} has no inertia; allowed: a bounded shape"
        )
    return body.mass * per_mass


def angular_acceleration(
    inertia: Float[Array, "3"] | Float[Array, "3 3"],
    matrix: Float[Array, "3 3"],
    spin: Float[Array, "3"],
    torque: Float[Array, "3"],
    gyroscopic: bool,
) -> Float[Array, "3"]:
    """Euler's equation J dw/dt = T - w x J w, world frame, J = R J_p R^T (MHS section 3, rad/s^2).

    Without `gyroscopic` the last term is left out, MHS's approximation.
    """
    torque = rotation.turn_back(matrix, torque)
    if gyroscopic:
        turning = rotation.turn_back(matrix, spin)
        torque = torque - rotation.cross(turning, momentum(inertia, turning))
    return rotation.turn(matrix, spin_of(inertia, torque))


def momentum(inertia: Float[Array, "3"] | Float[Array, "3 3"], spin: Float[Array, "3"]) -> Float[Array, "3"]:
    """J w, the angular momentum (kg m^2/s) of a spin (rad/s), both along the object's axes."""
    return inertia * spin if inertia.ndim == 1 else jnp.sum(inertia * spin[None, :], axis=-1)


def spin_of(
    inertia: Float[Array, "3"] | Float[Array, "3 3"], momentum: Float[Array, "3"]
) -> Float[Array, "3"]:
    """J^-1 L, the spin (rad/s) of an angular momentum (kg m^2/s), both along the object's axes."""
    return momentum / inertia if inertia.ndim == 1 else _solve(inertia, momentum)


def _solve(matrix: Float[Array, "3 3"], vector: Float[Array, "3"]) -> Float[Array, "3"]:
    # Cramer's rule: a call of LAPACK for three unknowns costs more than the rest of the step.
    a, b, c = matrix[:, 0], matrix[:, 1], matrix[:, 2]
    bc = jnp.cross(b, c)
    x = jnp.stack(
        [jnp.sum(vector * bc), jnp.sum(vector * jnp.cross(c, a)), jnp.sum(vector * jnp.cross(a, b))]
    )
    return x / jnp.sum(a * bc)


def _check_inertia(inertia: Any) -> None:
    if is_traced(inertia):
        return
    value = np.asarray(inertia, np.float64)
    if value.ndim == 2 and not np.allclose(value, value.T, rtol=1e-6):
        raise InputError(
            f"inertia is {value.tolist()}, which is not symmetric; allowed: a symmetric 3x3 matrix"
        )
    principal = np.sort(value if value.ndim == 1 else np.linalg.eigvalsh(value))
    if principal[0] <= 0 or principal[2] > (principal[0] + principal[1]) * (1 + 1e-6):
        raise InputError(
            f"inertia has the principal moments {principal.tolist()} kg m^2; "
            "allowed: all above 0, and none larger than the sum of the other two"
        )
