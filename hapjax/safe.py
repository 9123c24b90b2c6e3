"""Norms and normalisations whose value and gradient are finite at their singular points.

`jnp.where` alone does not help: its gradient multiplies the NaN of the branch not taken by zero. So the argument
is replaced by a harmless one before the singular function sees it, and the result is replaced afterwards.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


@jax.custom_jvp
def norm(x: Float[Array, "*batch n"]) -> Float[Array, "*batch"]:
    """Euclidean length along the last axis. At zero the value and the gradient are 0."""
    return jnp.sqrt(jnp.sum(x * x, axis=-1))


@norm.defjvp
def _norm_jvp(primals, tangents):
    (x,), (change,) = primals, tangents
    length = norm(x)
    return length, jnp.sum(x * change, axis=-1) * _inverse(length)


@jax.custom_jvp
def divide(numerator: Float[Array, "*batch"], denominator: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    """`numerator / denominator`, and 0 with gradient 0 where the denominator is 0."""
    is_zero = denominator == 0
    return jnp.where(is_zero, 0, numerator / jnp.where(is_zero, 1, denominator))


@divide.defjvp
def _divide_jvp(primals, tangents):
    # One division for all derivatives, which are products.
    (numerator, denominator), (above, below) = primals, tangents
    quotient = divide(numerator, denominator)
    return quotient, (above - quotient * below) * _inverse(denominator)


def _inverse(x: Float[Array, "*batch"]) -> Float[Array, "*batch"]:
    is_zero = x == 0
    return jnp.where(is_zero, 0, 1 / jnp.where(is_zero, 1, x))


def ratio(
    numerator: Float[Array, "*batch"], denominator: Float[Array, "*batch"], most: float
) -> Float[Array, "*batch"]:
    """`numerator / denominator` of numbers of 0 or above, and constant where it is more than `most` or 0 / 0.

    Derivatives stay finite however small the denominator, whose square may be too small to be told from 0.
    """
    smallest = jnp.maximum(
        jax.lax.stop_gradient(numerator) / most, 10 * jnp.sqrt(jnp.finfo(numerator.dtype).tiny)
    )
    return numerator / jnp.maximum(denominator, smallest.astype(numerator.dtype))


def normalise(x: Float[Array, "*batch n"]) -> Float[Array, "*batch n"]:
    """The unit vector along `x` (last axis), and 0 with gradient 0 where `x` is 0."""
    return x * divide(jnp.ones_like(x[..., 0]), norm(x))[..., None]
