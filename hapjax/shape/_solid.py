"""Volume, centre of mass and inertia of the uniform solid within a mesh."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ._triangle import dot


class Solid(eqx.Module):
    """`volume` m^3; `centre` of mass, m; `inertia` about it over the mass, m^2."""

    volume: Float[Array, ""]
    centre: Float[Array, "3"]
    inertia: Float[Array, "3 3"]


@jax.jit
def solid_of(corners: Float[Array, "T 3 3"]) -> Solid:
    """The sums over the tetrahedra between each triangle and one point (Tonon 2004), differentiable.

    The integral of x x' over the tetrahedron (0, a, b, c) is det / 120 ((a+b+c)(a+b+c)' + aa' + bb' + cc').
    """
    middle = jnp.mean(corners, axis=(0, 1))
    a, b, c = (corners[:, i] - middle[None] for i in range(3))
    det = dot(a, jnp.cross(b, c))
    total = a + b + c
    volume = jnp.sum(det) / 6
    centre = jnp.sum(det[:, None] * total, axis=0) / (24 * volume)
    square = sum(jnp.einsum("t,ti,tj->ij", det, v, v) for v in (a, b, c, total)) / (120 * volume)
    square = square - centre[:, None] * centre[None, :]
    return Solid(volume, middle + centre, jnp.trace(square) * jnp.eye(3, dtype=square.dtype) - square)
