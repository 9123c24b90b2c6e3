"""The friction cone with a force that grows with the speed of sliding."""

import equinox as eqx
from jaxtyping import Array, Float

from .._validate import as_float, check_not_negative
from ._law import Friction, Law, Press
from ._slide import drag, pull_of


class Viscous(Law):
    """Coulomb and viscous friction: the limit of a sliding god-object is f_n (mu + b v).

    v is the god-object's own speed, solved for implicitly, so that the law is stable for any b and step. A point at
    rest is held as by the cone. With `mu_static` and `mu_kinetic` it breaks away at the one and slides with the other
    for mu. The tangential part of the surface's `damping` applies, within the limit. b = 0: the cone.

    **Arguments:** `coefficient`, b in s/m, 0 or above.
    """

    coefficient: Float[Array, ""] = eqx.field(converter=as_float)

    needs_dt = True

    def __check_init__(self):
        check_not_negative("coefficient", self.coefficient, unit="s/m")

    def remembers(self, has_kinetic: bool) -> bool:
        """Only which of two mu holds."""
        return has_kinetic

    def hold(self, press: Press) -> Friction:
        """The friction of one step."""
        kinetic = None if press.kinetic is None else press.kinetic(pull_of(press))
        return drag(press, kinetic, self.coefficient)
