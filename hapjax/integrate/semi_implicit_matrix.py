"""MHS's rotation update (section 3): semi-implicit Euler on matrices."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from .. import rotation
from .semi_implicit import SemiImplicit


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
