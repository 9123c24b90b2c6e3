"""Rotations: unit quaternions w x y z in states and files, matrices inside a step.

jaxlie supplies the exponential map and its inverse, with care at zero rotation. Its product and inverse mix integers
with floats, which strict dtype promotion forbids, and picks components apart, whose derivatives are slow in a loop; so
the product and the matrix stand here.
"""

import jax.numpy as jnp
import jaxlie
import numpy as np
from jaxtyping import Array, Float


def _tables() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The cross product (3, 3, 3), the Hamilton product (4, 4, 4) and a quaternion's matrix (3, 3, 4, 4): by what the
    products of two vectors' components count in each component of the result."""
    cross = np.zeros((3, 3, 3))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        cross[i, j, k], cross[i, k, j] = 1, -1
    hamilton = np.zeros((4, 4, 4))
    hamilton[0] = np.diag([1, -1, -1, -1])
    hamilton[1:, 1:, 1:] = cross
    hamilton[1:, 1:, 0] = hamilton[1:, 0, 1:] = np.eye(3)
    # q v q*: as the product of q v and the conjugate of q, where v is a vector.
    turned = np.einsum("iab,acd,be->icde", hamilton, hamilton, hamilton[0]).transpose(0, 2, 1, 3)
    return cross, hamilton, turned[1:, 1:]


# Sums of products with these, and not components taken apart and put together again: the derivatives are such sums
# too, where those of slices are paddings, each a kernel of its own.
_CROSS, _HAMILTON, _TURNED = _tables()


def cross(a: Float[Array, "3"], b: Float[Array, "3"]) -> Float[Array, "3"]:
    """a x b."""
    return _bilinear(_CROSS, a, b)


def cross_matrix(a: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """The matrix that takes a vector v to a x v."""
    return jnp.sum(-jnp.asarray(_CROSS, a.dtype) * a[None, None, :], axis=-1)


def cross_of_dyads(dyads: Float[Array, "3 3"]) -> Float[Array, "3"]:
    """The sum of a x b over several pairs, from the sum of their outer products."""
    return jnp.sum(jnp.asarray(_CROSS, dyads.dtype) * dyads[None], axis=(1, 2))


def product(p: Float[Array, "4"], q: Float[Array, "4"]) -> Float[Array, "4"]:
    """Hamilton product: the rotation `q` followed by the rotation `p`."""
    return _bilinear(_HAMILTON, p, q)


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
    """The matrix of a unit quaternion, which turns body coordinates into world coordinates."""
    return _bilinear(_TURNED, q, q)


def from_matrix(matrix: Float[Array, "3 3"]) -> Float[Array, "4"]:
    """The unit quaternion of an orthonormal matrix."""
    return jaxlie.SO3.from_matrix(matrix).wxyz


def turn(matrix: Float[Array, "3 3"], vectors: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
    """The matrix applied to each vector; in full precision on accelerators that would otherwise round to TF32."""
    return _product(matrix, vectors)


def turn_back(matrix: Float[Array, "3 3"], vectors: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
    """The inverse of the rotation matrix applied to each vector."""
    return _product(matrix.T, vectors)


def _product(matrix: Float[Array, "3 3"], vectors: Float[Array, "*batch 3"]) -> Float[Array, "*batch 3"]:
    # Not `@`, which is a call that the compiler fuses with nothing around it.
    shape = (*vectors.shape[:-1], 3, 3)
    columns = jnp.broadcast_to(vectors[..., None, :], shape)
    return jnp.sum(jnp.broadcast_to(matrix, shape) * columns, axis=-1)


def _bilinear(table: np.ndarray, a: Array, b: Array) -> Array:
    """The sum over j and k of table[..., j, k] a[j] b[k]."""
    factors = jnp.asarray(table, a.dtype)
    half = jnp.sum(factors * jnp.broadcast_to(b, factors.shape), axis=-1)
    return jnp.sum(half * jnp.broadcast_to(a, half.shape), axis=-1)
