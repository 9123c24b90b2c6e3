"""The bristle that Dahl's and the LuGre law share: it is stretched by travel, and gives as it nears its limit."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from .. import safe
from ._law import Press

_LONG = 50.0  # exp(-50) is 2e-22, nothing beside 1 in either precision


def stretch(press: Press, mu: Float[Array, ""]) -> Float[Array, "3"]:
    """The offset (m) after a step of travel w against a bristle of the limit c = mu f_n / k, solved exactly.

    dz/dt = v - |v| z / c has, over a way of length s = |w| at constant v, the solution

        z = z_0 exp(-s/c) + (w/s) c (1 - exp(-s/c))

    With the offset before the law z_0 + w this is offset * E + w (phi - E), with E = exp(-s/c), phi = (1 - E) c / s.
    At first touch, where the offset is 0, so is z_0 + w: what was travelled before the touch does not count.
    """
    assert press.travel is not None
    way = -press.travel  # the god-object from the point: it lags behind
    length = safe.norm(way)
    limit = mu * press.normal_force / press.stiffness
    ratio = safe.ratio(length, limit, _LONG)
    kept, given = jnp.exp(-ratio), -jnp.expm1(-ratio)
    # (1 - E) c / s by the ratio where the way is short, and by the way where the limit is.
    is_short = ratio < 1
    by_ratio = given / jnp.where(is_short & (ratio > 0), ratio, 1)
    by_way = given * limit / jnp.where(is_short, 1, length)
    phi = jnp.where(is_short, jnp.where(ratio > 0, by_ratio, 1), by_way)
    return press.offset * kept + way * (phi - kept)


def kept_within(press: Press, offset: Float[Array, "3"]) -> Float[Array, "3"]:
    """The offset cut to the static circle: the bristle lets go when the normal force falls."""
    limit = press.static(offset) * press.normal_force / press.stiffness
    size = safe.norm(offset)
    return jnp.where(size > limit, offset * safe.divide(limit, size), offset)
