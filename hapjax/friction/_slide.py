"""What the laws that hold and slide share: a god-object that stays within a limit, and is dragged beyond it."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from .. import safe
from ._law import Friction, Press


def pull_of(press: Press) -> Float[Array, "3"]:
    """The force (N) of spring and contact damping together, before any limit."""
    spring = press.stiffness * press.offset
    return spring if press.viscous is None else spring + press.viscous


def capped(pull: Float[Array, "3"], limit: Float[Array, ""]) -> Float[Array, "3"]:
    """The pull, or what the limit (N) leaves of it in its direction."""
    size = safe.norm(pull)
    return jnp.where(size > limit, pull * safe.divide(limit, size), pull)


def decay(press: Press, stribeck_velocity: Float[Array, ""]) -> Float[Array, ""]:
    """Stribeck's exp(-(v/v_s)^2) at the point's slip speed v, both in m/s.

    Beyond v = 10 v_s it is below 4e-44 and counts as constant, so that a tiny v_s gives no NaN in derivatives.
    """
    assert press.travel is not None and press.dt is not None
    speed = safe.norm(press.travel) / press.dt
    return jnp.exp(-(safe.ratio(speed, stribeck_velocity, 10.0) ** 2))


def drag(
    press: Press,
    sliding_mu: Float[Array, ""] | None,
    viscous: Float[Array, ""],
) -> Friction:
    """Hold up to the static limit, then slide against `sliding_mu` and `viscous` (s/m) times the god-object's speed.

    The god-object slides x in the step, and its speed is x / dt. Its spring explains the force:

        k (|o| - x) = f_n (mu + b x / dt)

    so the force is (f_n mu + beta k |o|) / (1 + beta) with beta = f_n b / (k dt): implicit, and stable for any step.
    It goes along the pull, which has the contact's own damping in it, and is never above the pull.

    `sliding_mu` `None`: the static one, and nothing is remembered.
    """
    assert press.dt is not None
    pull, spring = pull_of(press), press.stiffness * safe.norm(press.offset)
    size = safe.norm(pull)
    limit = press.static(pull) * press.normal_force
    dragged = size > limit
    if sliding_mu is not None and press.sliding is not None:
        limit = sliding_mu * press.normal_force
        dragged = jnp.where(press.sliding > 0, size > limit + press.stiffness * press.rounding, dragged)
    beta = viscous * press.normal_force / (press.stiffness * press.dt)
    limit = limit + beta / (1 + beta) * jnp.maximum(spring - limit, 0)
    return slid(press, pull, limit, dragged)


def slid(
    press: Press, pull: Float[Array, "3"], limit: Float[Array, ""], dragged: Bool[Array, ""]
) -> Friction:
    """The limited pull, and the god-object where it was, or dragged to where its spring alone is at the limit.

    Had the god-object to explain the damper's part of the force too, the spring would store what the damper gave.
    """
    is_cut = dragged & (safe.norm(pull) > limit)
    force = jnp.where(is_cut, capped(pull, limit), pull)
    spring = press.stiffness * safe.norm(press.offset)
    offset = press.offset * jnp.where(is_cut & (spring > limit), safe.divide(limit, spring), 1)
    return Friction(offset, force, None if press.sliding is None else dragged.astype(limit.dtype))
