"""Rotations: unit quaternions w x y z in states and files, matrices inside a step.

jaxlie supplies the exponential map and its inverse, with care at zero rotation. Its product and inverse mix integers
with floats, which strict dtype promotion forbids, so the product stands here.
"""

import jax.numpy as jnp
import jaxlie
from jaxtyping import Array, Float


def product(p: Float[Array, "4"], q: Float[Array, "4"]) -> Float[Array, "4"]:
    """Hamilton product: the rotation `q` followed by the rotation `p`."""
    vector = p[0] * q[1:] + q[0] * p[1:] + jnp.cross(p[1:], q[1:])
    return jnp.concatenate([(p[0] * q[0] - jnp.sum(p[1:] * q[1:]))[None], vector])


def from_rotation_vector(w: Float[Array, "3"]) -> Float[Array, "4"]:
    """The rotation by |w| rad about w (exponential map)."""
    return jaxlie.SO3.exp(w).wxyz


def to_rotation_vector(q: Float[Array, "4"]) -> Float[Array, "3"]:
    """The shortest rotation vector of a unit quaternion, rad (logarithm)."""
    return jaxlie.SO3(q).log()


def normalise(q: Float[Array, "4"]) -> Float[Array, "4"]:
    """The unit quaternion along `q`, which must not be zero."""
    return q / jnp.sqrt(jnp.sum(q * q))


def conjugate(q: Float[Array, "4"]) -> Float[Array, "4"]:
    """The inverse of a unit quaternion."""
    return jnp.concatenate([q[:1], -q[1:]])


def to_matrix(q: Float[Array, "4"]) -> Float[Array, "3 3"]:
    """The matrix that turns body coordinates into world coordinates."""
    return jaxlie.SO3(q).as_matrix()


def from_matrix(matrix: Float[Array, "3 3"]) -> Float[Array, "4"]:
    """The unit quaternion of an orthonormal matrix."""
    return jaxlie.SO3.from_matrix(matrix).wxyz


def turn(matrix: Float[Array, "3 3"], vectors: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
    """The matrix applied to each vector; in full precision on accelerators that would otherwise round to TF32."""
    return _sum_of_rows(matrix.T, vectors)


def turn_back(matrix: Float[Array, "3 3"], vectors: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
    """The inverse of the rotation matrix applied to each vector."""
    return _sum_of_rows(matrix, vectors)


def _sum_of_rows(rows: Float[Array, "3 3"], weights: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
    # Written out, because a matrix product is a call that the compiler fuses with nothing around it.
    x, y, z = (jnp.broadcast_to(row, weights.shape) for row in rows)
    return weights[..., 0:1] * x + weights[..., 1:2] * y + weights[..., 2:3] * z
