"""The friction cone, static and kinetic: the law of a surface that names none."""

import jax.numpy as jnp

from .. import safe
from ._law import Friction, Law, Press
from ._slide import pull_of, slid


class Cone(Law):
    """Coulomb's cone with MHS's circle: the offset stays if the pull is within the limit, else goes to its edge.

    The pull is k o, plus the `viscous` force where there is damping; the whole is limited to mu f_n, so
    |force| <= mu f_n holds to rounding, and so is the spring's own part: the friction circle has the radius mu f_n / k
    (MHS section 2, there with f_n = k d and so radius mu d).

    With a mu of sliding of its own the static limit holds until it is passed, then the kinetic one while the offset is
    being dragged; what it remembers is 1 then, else 0. Dragged means past the kinetic limit by more than rounding.
    """

    def remembers(self, has_kinetic: bool) -> bool:
        """Only which of two mu holds."""
        return has_kinetic

    def hold(self, press: Press) -> Friction:
        """The friction of one step."""
        pull = pull_of(press)
        size = safe.norm(pull)
        limit = press.static(pull) * press.normal_force
        dragged = size > limit
        if press.kinetic is not None and press.sliding is not None:
            limit = press.kinetic(pull) * press.normal_force
            still_dragged = size > limit + press.stiffness * press.rounding
            dragged = jnp.where(press.sliding > 0, still_dragged, dragged)
        return slid(press, pull, limit, dragged)
