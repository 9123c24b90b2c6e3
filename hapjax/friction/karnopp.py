"""Karnopp's velocity band: what is slower than the band may hold."""

import equinox as eqx
from jaxtyping import Array, Float

from .. import safe
from .._validate import as_float, check_positive
from ._law import Friction, Law, Press
from ._slide import pull_of, slid


class Karnopp(Law):
    """Stick and slip told apart by a band of velocities (Karnopp 1985; for haptics, Richards and Cutkosky 2002).

    A god-object that holds stays just where it is while the pull is within mu_s f_n. Once it slides it does so with at
    most mu_k f_n, until the point's slip speed over the surface is below the band D_v and the pull is within mu_s f_n.
    What the cone asks of forces, to tell when sliding ends, this law asks of the speed: a point that slows down and
    gets faster again without having stopped does not have to break away again. The tangential part of the surface's
    `damping` applies, within the limit. With `mu` alone: the cone.

    **Arguments:** `velocity_band`, D_v in m/s, above 0.
    """

    velocity_band: Float[Array, ""] = eqx.field(converter=as_float)

    needs_travel = True
    needs_dt = True

    def __check_init__(self):
        check_positive("velocity_band", self.velocity_band, unit="m/s")

    def remembers(self, has_kinetic: bool) -> bool:
        """Whether it slides."""
        return True

    def hold(self, press: Press) -> Friction:
        """The friction of one step."""
        assert press.travel is not None and press.dt is not None and press.sliding is not None
        pull = pull_of(press)
        slow = safe.norm(press.travel) < self.velocity_band * press.dt
        within = safe.norm(pull) <= press.static(pull) * press.normal_force
        holds = ((press.sliding == 0) | slow) & within
        mu = press.static(pull) if press.kinetic is None else press.kinetic(pull)
        return slid(press, pull, mu * press.normal_force, ~holds)
