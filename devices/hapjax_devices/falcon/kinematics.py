"""The Falcon's three legs: where the grip is for given angles of the arms, and which torques push it how.

The Falcon is a Delta robot as of L.-W. Stamper, *A three degree of freedom parallel manipulator with only translational
degrees of freedom* (PhD thesis, University of Maryland, 1997). The device's frame: x to the right, y up, z towards the
user, its origin in the middle of the base. An arm is the first link of a leg, and turns about an axis in the base.
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

ARM, ROD = 0.060, 0.1025  # m, the arm and the parallelogram after it (Stamper's a and b)
OFFSET, ENDS = (
    0.01443,
    0.0225,
)  # m, of the platform's joints (c), of the parallelogram's two ends together (d + e)
SIDE, RADIUS, SIDE_OF_BASE = -0.025, 0.040, -0.02309  # m, of platform and base (f, r and s)
LEGS = np.radians([105.0, -15.0, -135.0])  # where the legs stand around z
CENTRE = np.array([0.0, 0.0, 0.125])  # m, the middle of the workspace

COUNT = np.radians(0.036435)  # rad an arm: 1280 counts a turn of the motor, geared down by 0.01425 : 0.110
AT_ZERO = np.radians(35.0)  # an arm's angle where its encoder is at 0

_NEWTON_STEPS = 8


def inverse(position: Float[Array, "3"]) -> Float[Array, "3"]:
    """The arms' angles, rad, for a position of the grip, m, in the device's frame; NaN where it cannot be."""
    return arm_angle(jnp, *_in_legs_frames(position))


def arm_angle(functions: Any, outwards: Any, sideways: Any, along: Any) -> Any:
    """The angle of an arm, rad, for its leg's end on the platform in the leg's own frame, m.

    `functions` are those for the numbers at hand: `jnp` for arrays, `math` for one of each.
    """
    across = ENDS + functions.sqrt(
        ROD**2 - sideways**2
    )  # the parallelogram's length as seen in the leg's plane
    far = functions.hypot(outwards, along)
    bend = functions.acos((far**2 + ARM**2 - across**2) / (2 * ARM * far))
    return functions.atan2(along, outwards) - bend


def jacobian(position: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Derivative of the arms' angles by the position of the grip, rad/m: a row a leg."""
    return jax.jacfwd(inverse)(position)


@jax.custom_jvp
def forward(angles: Float[Array, "3"]) -> Float[Array, "3"]:
    """The position of the grip, m, in the device's frame, for the arms' angles, rad.

    Newton's method on the rods' lengths, from the workspace's middle; NaN where no position has these angles.
    """

    def closer(_, position):
        slope = jax.jacfwd(_too_long)(position, angles)
        return position - _solve(slope, _too_long(position, angles))

    position = jax.lax.fori_loop(0, _NEWTON_STEPS, closer, jnp.asarray(CENTRE, angles.dtype))
    # The rods' lengths do not tell a knee that points outwards from one that points inwards; the angles do.
    miss = jnp.max(jnp.abs(inverse(position) - angles))
    return jnp.where(miss < 1e4 * jnp.finfo(angles.dtype).eps, position, jnp.nan)


@forward.defjvp
def _forward_jvp(primals, tangents):
    # Through inverse(position) = angles, not through Newton's steps.
    position = forward(primals[0])
    return position, _solve(jacobian(position), tangents[0])


def _in_legs_frames(position):
    """Of each leg where its end of the platform is: outwards (Stamper's u + c), sideways (v + f), and along z (w)."""
    cos, sin = jnp.asarray(np.cos(LEGS), position.dtype), jnp.asarray(np.sin(LEGS), position.dtype)
    outwards = position[0] * cos + position[1] * sin - RADIUS + OFFSET
    sideways = position[1] * cos - position[0] * sin - SIDE_OF_BASE + SIDE
    return outwards, sideways, position[2]


def _too_long(position, angles):
    """By how much each rod would have to be longer than it is, m, to join its knee and the platform."""
    outwards, sideways, w = _in_legs_frames(position)
    across = jnp.hypot(outwards - ARM * jnp.cos(angles), w - ARM * jnp.sin(angles))
    return jnp.hypot(across - ENDS, sideways) - ROD


def _solve(matrix, vector):
    """The solution of a system of three equations, by Cramer's rule."""
    a, b, c = matrix[:, 0], matrix[:, 1], matrix[:, 2]
    bc = jnp.cross(b, c)
    return jnp.stack([bc, jnp.cross(c, a), jnp.cross(a, b)]) @ vector / jnp.dot(a, bc)
