"""The LuGre law: bristles with damping, a Stribeck curve and viscous friction."""

import equinox as eqx
from jaxtyping import Array, Float

from .. import safe
from .._validate import as_float, check_not_negative, check_positive
from ..errors import InputError
from ._bristle import kept_within, stretch
from ._law import Friction, Law, Press
from ._slide import decay


class LuGre(Law):
    """The LuGre law (Canudas de Wit, Olsson, Astrom, Lischinsky 1995), its coefficients per newton of normal force.

        dz/dt = v - |v| k z / (f_n g(v))
        g(v) = mu_k + (mu_s - mu_k) exp(-(v/v_s)^2)
        F = k z + f_n (sigma_1 dz/dt + sigma_2 v)

    with v the point's slip velocity over the surface, k the surface's `tangential_stiffness` (sigma_0), and z minus the
    offset. At constant speed F = f_n (g(v) + sigma_2 v). z over a step is exact for travel at constant velocity, so
    z is stable for any step; dz/dt is that at the step's end. z is cut to the static circle where the normal
    force falls, which the equations of 1995 leave open: their normal force is constant. F itself may pass
    mu_s f_n by the two damping terms. The tangential part of the surface's `damping` does not apply: sigma_1 is in its
    place. sigma_1 = sigma_2 = 0 and `mu` alone: Dahl's law. The damping terms are those of the velocity at hand: a mass m
    that slides freely is stable for f_n (sigma_1 + sigma_2) dt < 2 m.

    **Arguments:**

    - `bristle_damping`: sigma_1 in s/m, 0 or above.
    - `viscous`: sigma_2 in s/m, 0 or above.
    - `stribeck_velocity`: v_s in m/s, above 0; with `mu_static` and `mu_kinetic`. `None`: with `mu` alone.
    """

    bristle_damping: Float[Array, ""] = eqx.field(converter=as_float, default=0.0)
    viscous: Float[Array, ""] = eqx.field(converter=as_float, default=0.0)
    stribeck_velocity: Float[Array, ""] | None = eqx.field(converter=as_float, default=None)

    needs_travel = True
    needs_dt = True

    def __check_init__(self):
        check_not_negative("bristle_damping", self.bristle_damping, unit="s/m")
        check_not_negative("viscous", self.viscous, unit="s/m")
        if self.stribeck_velocity is not None:
            check_positive("stribeck_velocity", self.stribeck_velocity, unit="m/s")

    def check(self, has_kinetic: bool) -> None:
        """Refuse a Stribeck velocity without two mu, and the other way round."""
        if has_kinetic and self.stribeck_velocity is None:
            raise InputError(
                "stribeck_velocity is missing; allowed: above 0 m/s beside mu_static and mu_kinetic"
            )
        if not has_kinetic and self.stribeck_velocity is not None:
            raise InputError("stribeck_velocity is given with mu alone; allowed: mu_static with mu_kinetic")

    def remembers(self, has_kinetic: bool) -> bool:
        """Nothing beside the offset."""
        return False

    def hold(self, press: Press) -> Friction:
        """The friction of one step."""
        assert press.travel is not None and press.dt is not None
        mu = press.static(press.travel)
        if press.kinetic is not None and self.stribeck_velocity is not None:
            kinetic = press.kinetic(press.travel)
            mu = kinetic + (mu - kinetic) * decay(press, self.stribeck_velocity)
        offset = kept_within(press, stretch(press, mu))
        slip = -press.travel / press.dt
        limit = mu * press.normal_force / press.stiffness
        # mu_s / mu_k times 1 at most, and below 1e6 for any two that make sense
        rate = slip - safe.norm(slip) * safe.normalise(offset) * safe.ratio(safe.norm(offset), limit, 1e6)
        damped = press.normal_force * (self.bristle_damping * rate + self.viscous * slip)
        return Friction(offset, press.stiffness * offset + damped, press.sliding)
