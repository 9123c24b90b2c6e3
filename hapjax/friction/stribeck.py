"""Stribeck's curve: friction that falls from the static to the kinetic one as sliding gets faster."""

import equinox as eqx
from jaxtyping import Array, Float

from .._validate import as_float, check_not_negative, check_positive
from ..errors import InputError
from ._law import Friction, Law, Press
from ._slide import decay, drag, pull_of


class Stribeck(Law):
    """Static, kinetic, viscous and Stribeck friction (Armstrong-Helouvry, Dupont, Canudas de Wit 1994, section 2.1).

    A god-object that holds breaks away at mu_s f_n, and slides with

        f_n (mu_k + (mu_s - mu_k) exp(-(v/v_s)^2) + b v)

    until its spring pulls with less; then it holds again, with the full static limit. In the exponential v is the
    point's slip speed over the surface: evaluated at the god-object's own speed, a curve that falls would make a
    god-object without mass jump. In b v it is the god-object's own, solved for implicitly. The tangential part of the
    surface's `damping` applies, within the limit. v_s to 0 and b = 0: the cone with `mu_static` and `mu_kinetic`.

    **Arguments:** `stribeck_velocity`, v_s in m/s, above 0; `viscous`, b in s/m, 0 or above. The surface has `mu_static`
    and `mu_kinetic`.
    """

    stribeck_velocity: Float[Array, ""] = eqx.field(converter=as_float)
    viscous: Float[Array, ""] = eqx.field(converter=as_float, default=0.0)

    needs_travel = True
    needs_dt = True

    def __check_init__(self):
        check_positive("stribeck_velocity", self.stribeck_velocity, unit="m/s")
        check_not_negative("viscous", self.viscous, unit="s/m")

    def check(self, has_kinetic: bool) -> None:
        """Refuse a single mu."""
        if not has_kinetic:
            raise InputError("the stribeck law has mu alone; allowed: mu_static with mu_kinetic")

    def remembers(self, has_kinetic: bool) -> bool:
        """Whether it slides."""
        return True

    def hold(self, press: Press) -> Friction:
        """The friction of one step."""
        assert press.kinetic is not None
        pull = pull_of(press)
        static, kinetic = press.static(pull), press.kinetic(pull)
        mu = kinetic + (static - kinetic) * decay(press, self.stribeck_velocity)
        return drag(press, mu, self.viscous)
