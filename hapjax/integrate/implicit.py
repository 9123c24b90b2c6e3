"""The fully implicit step: all touches of all objects in one convex minimisation."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from .. import body as rigid
from .. import god_object, rotation
from ..body import Body, Motion
from ..god_object import Grip
from ..link import Link, Rates
from ..shape import Shape
from ._bodies import Bodies
from ._integrator import Links
from ._newton import Balance
from .semi_implicit import SemiImplicit


class Implicit(SemiImplicit):
    """Semi-implicit Euler whose forces are those of the end of the step. First order, stable for any stiffness and step.

    The velocities v of all objects after the step minimise a convex function (Castro, Permenter and Han 2022, in the
    form in which friction's limit is lagged):

        1/2 (v - v_free)' M (v - v_free) + sum over the touches of the potential of their force,

    with v_free the velocities without touches, M the masses and inertias, and the force of a touch that of its law `dt`
    later, its surface taken as flat in between. Friction is limited by the normal force of the step before: there is
    none in the step in which a point first reaches a surface. Torsion and the dead band act on the forces that come out.
    """

    looks_ahead = True

    def foresee(
        self, links: Links, bodies: Bodies, dt: Float[Array, ""]
    ) -> tuple[Links, dict[str, Motion] | None]:
        """Touches and velocities as they are at the end of the step."""
        every = jax.tree.leaves(links, is_leaf=_is_link)
        if not bodies.motion or not every:
            return links, None
        touches = _Touches(every, [link.grip() for link in every], bodies, dt)
        free, unflatten = ravel_pytree(self._free(bodies, dt))
        now, _ = ravel_pytree(bodies.rates())
        each = jnp.eye(free.size, dtype=free.dtype)
        mass = jax.vmap(lambda v: ravel_pytree(bodies.momenta(unflatten(v)))[0], out_axes=1)(each)
        slips = jax.vmap(lambda v: touches.slips(unflatten(v)).ravel(), out_axes=1)(each)
        v = Balance(mass, free, slips, touches.force, dt).solve(now)
        rates = unflatten(v)
        found = iter(touches.ahead(touches.slips(rates)))
        return jax.tree.map(lambda _: next(found), links, is_leaf=_is_link), bodies.moving_at(rates)

    def _free(self, bodies: Bodies, dt: Float[Array, ""]) -> Rates:
        """The velocities after the step if nothing touched."""
        rates = {}
        for name, (velocity, spin) in bodies.rates().items():
            if spin is not None and bodies.gyroscopic:
                spin = _coast(*bodies.parts[name], bodies.matrix[name], spin, dt)
            rates[name] = (velocity, spin)
        return bodies.pushed(rates, bodies.weights(), dt)


class _Touches:
    """All touches of a step, `dt` s on."""

    def __init__(self, links: Sequence[Link], grips: Sequence[Grip], bodies: Bodies, dt: Float[Array, ""]):
        self.links, self.grips, self.bodies, self.dt = links, grips, bodies, dt

    def slips(self, rates: Rates) -> Float[Array, "N 3"]:
        return jnp.concatenate([link.slip(rates, self.bodies.centre) for link in self.links])

    def ahead(self, slips: Float[Array, "N 3"]) -> list[Link]:
        parts = jnp.split(slips, np.cumsum([len(link.point) for link in self.links])[:-1])
        known = zip(self.links, parts, self.grips, strict=True)
        return [link.ahead(slip, grip, self.dt) for link, slip, grip in known]

    def force(self, slips: Float[Array, "N 3"]) -> Float[Array, "N 3"]:
        pressed = [god_object.press(link.meeting, self.dt) for link in self.ahead(slips)]
        return jnp.concatenate([answer.touch.force for answer in pressed])


def _is_link(x: Any) -> bool:
    return isinstance(x, Link)


def _coast(
    body: Body, shape: Shape, matrix: Float[Array, "3 3"], spin: Float[Array, "3"], dt: Float[Array, ""]
):
    """The spin after `dt` s without torque: one Newton step of J (w - w_before) + dt w x J w = 0, which stays bounded."""
    inertia, own = rigid.inertia_of(body, shape), rotation.turn_back(matrix, spin)
    momentum = rigid.momentum(inertia, own)
    full = jnp.diag(inertia) if inertia.ndim == 1 else inertia
    each = jnp.eye(3, dtype=spin.dtype)
    # Column i of J + dt ([w] J - [J w]).
    columns = full.T + dt * (jnp.cross(own[None], full.T) - jnp.cross(momentum[None], each))
    own = own - dt * rigid.spin_of(columns.T, jnp.cross(own, momentum))
    return rotation.turn(matrix, own)
