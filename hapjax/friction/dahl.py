"""Dahl's law: friction as a spring that gives way little by little."""

from ..errors import InputError
from ._bristle import kept_within, stretch
from ._law import Friction, Law, Press
from ._slide import capped


class Dahl(Law):
    """Dahl's law with exponent 1 (Dahl 1968, 1976): dF/dx = k (1 - F sign(v) / (mu f_n)), here for vectors.

    The force rises from the stiffness k at a reversal smoothly to mu f_n, without a moment of breaking away, and
    depends on the path alone, not on speed. The step is exact for travel at constant velocity. The force never passes
    mu f_n: where the normal force falls, the offset is cut to the circle. A force that comes and goes makes it creep.
    The tangential part of the surface's `damping` applies, within the limit. k to infinity: the cone, rigid.

    No numbers of its own: k is the surface's `tangential_stiffness`, and `mu` is one.
    """

    needs_travel = True

    def check(self, has_kinetic: bool) -> None:
        """Refuse two mu."""
        if has_kinetic:
            raise InputError("the dahl law has mu_static and mu_kinetic; allowed: mu alone")

    def remembers(self, has_kinetic: bool) -> bool:
        """Nothing beside the offset."""
        return False

    def hold(self, press: Press) -> Friction:
        """The friction of one step."""
        assert press.travel is not None
        offset = kept_within(press, stretch(press, press.static(press.travel)))
        pull = press.stiffness * offset
        if press.viscous is not None:
            pull = pull + press.viscous
            pull = capped(pull, press.static(pull) * press.normal_force)
        return Friction(offset, pull, press.sliding)
