"""The friction cone, as a law on the god-object's offset from the surface point.

The law sees a tangential spring of stiffness k whose length is the offset o, and may drag the offset so that the
force keeps within the cone.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from . import safe


class Friction(eqx.Module):
    """What the cone allows: the offset after dragging (m), the tangential force (N), and whether it was dragged."""

    offset: Float[Array, "3"]
    force: Float[Array, "3"]
    dragged: Bool[Array, ""]


def cone(
    offset: Float[Array, "3"],
    stiffness: Float[Array, ""],
    viscous: Float[Array, "3"] | None,
    static_limit: Float[Array, ""],
    kinetic_limit: Float[Array, ""] | None,
    sliding: Float[Array, ""] | None,
    rounding: Float[Array, ""],
) -> Friction:
    """Coulomb's cone with MHS's circle: the offset stays if the pull is within the limit, else goes to its edge.

    The pull is k o, plus the `viscous` force where there is damping; the whole is limited to mu f_n, and the offset is
    set to what explains the limited force, so |force| <= mu f_n holds to rounding and the friction circle has the
    radius mu f_n / k (MHS section 2, there with f_n = k d and so radius mu d).

    With a `kinetic_limit` the static limit holds until it is passed, then the kinetic one while the offset is being
    dragged; `sliding` (1 or 0) says which. Dragged means past the kinetic limit by more than `rounding` (m).
    """
    pull = stiffness * offset if viscous is None else stiffness * offset + viscous
    size = safe.norm(pull)
    limit = static_limit
    dragged = size > limit
    if kinetic_limit is not None and sliding is not None:
        still_dragged = size > kinetic_limit + stiffness * rounding
        dragged = jnp.where(sliding > 0, still_dragged, dragged)
        limit = kinetic_limit
    force = jnp.where(dragged, pull * safe.divide(limit, size), pull)
    return Friction(jnp.where(dragged, force / stiffness, offset), force, dragged)
