"""The minimum of a mass term and of potentials of forces, by Newton's method."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

_MOST_STEPS, _MOST_TRIALS = 60, 20


class Balance(eqx.Module):
    """Velocities v (all objects' in one vector) at which momenta and impulses agree:

        M (v - free) = dt J' f(J v)

    **Arguments:** `mass` M; `free`, the velocities without touches; `slips` J, from v to the slip (m/s) of each point,
    one after the other; `force` f, from slips to forces (N); `dt` (s).
    """

    mass: Float[Array, "D D"]
    free: Float[Array, "D"]
    slips: Float[Array, "N*3 D"]
    force: Callable[[Float[Array, "N 3"]], Float[Array, "N 3"]]
    dt: Float[Array, ""]

    def residual(self, v: Float[Array, "D"]) -> Float[Array, "D"]:
        """By how much they do not agree (N s, N m s)."""
        return self.mass @ (v - self.free) - self.dt * (self.force(self._slip(v)).ravel() @ self.slips)

    def solve(self, guess: Float[Array, "D"]) -> Float[Array, "D"]:
        """The v for which the residual is 0. Derivatives are those of the solution, not of the way to it."""

        def tangent_solve(linear, y):
            matrix = jax.vmap(linear, out_axes=1)(jnp.eye(y.size, dtype=y.dtype))
            return jnp.linalg.solve(matrix, y)

        def balanced(v):
            return self.residual(v)

        return jax.lax.custom_root(balanced, guess, lambda _, start: self._descend(start), tangent_solve)

    def _slip(self, v: Float[Array, "D"]) -> Float[Array, "N 3"]:
        return (self.slips @ v).reshape(-1, 3)

    def _descend(self, start: Float[Array, "D"]) -> Float[Array, "D"]:
        """Newton steps with an exact line search, until a step promises less than rounding can show."""
        tolerance = jnp.finfo(start.dtype).eps

        def goes_on(carry):
            _, promise, count = carry
            return (promise > tolerance) & (count < _MOST_STEPS)

        def one(carry):
            v, _, count = carry
            change, slope = self._newton(v)
            energy = v @ self.mass @ v + self.free @ self.mass @ self.free
            promise = -slope / jnp.where(energy > 0, energy, 1)
            return v + self._how_far(v, change, slope) * change, promise, count + 1

        return jax.lax.while_loop(goes_on, one, (start, jnp.ones_like(start[0]), 0))[0]

    def _newton(self, v: Float[Array, "D"]) -> tuple[Float[Array, "D"], Float[Array, ""]]:
        """The Newton step, and the slope of the function along it."""
        force, along = jax.linearize(self.force, self._slip(v))
        columns = [along(jnp.broadcast_to(axis, force.shape)) for axis in jnp.eye(3, dtype=v.dtype)]
        rows = jnp.stack(columns, axis=-1)  # of each point: force against slip
        stiffness = -(rows + jnp.swapaxes(rows, -1, -2)) / 2
        slips = self.slips.reshape(-1, 3, v.size)
        curvature = jnp.sum(stiffness[..., None] * slips[:, None], axis=2).reshape(-1, v.size)
        hessian = self.mass + self.dt * (self.slips.T @ curvature)
        residual = self.mass @ (v - self.free) - self.dt * (force.ravel() @ self.slips)
        factor = jax.scipy.linalg.cho_factor(hessian)
        change = -jax.scipy.linalg.cho_solve(factor, residual)
        return change, residual @ change

    def _how_far(self, v, change, slope) -> Float[Array, ""]:
        """The part of a Newton step that goes to the minimum along it: the whole, unless that climbs up again.

        The function is convex, so its slope along the step only grows: regula falsi (Illinois) finds where it is 0.
        """
        slip, turn = self._slip(v), self._slip(change)
        first, second = change @ self.mass @ (v - self.free), change @ self.mass @ change

        def slope_at(part):
            return first + part * second - self.dt * jnp.sum(turn * self.force(slip + part * turn))

        def goes_on(carry):
            _, _, _, _, found, count = carry
            return (jnp.abs(found) > 0.1 * jnp.abs(slope)) & (count < _MOST_TRIALS)

        def one(carry):
            low, low_slope, high, high_slope, _, count = carry
            part = low - low_slope * (high - low) / (high_slope - low_slope)
            found = slope_at(part)
            below = found < 0
            carry = (
                jnp.where(below, part, low),
                jnp.where(below, found, low_slope / 2),
                jnp.where(below, high, part),
                jnp.where(below, high_slope / 2, found),
                found,
                count + 1,
            )
            return carry

        whole, zero = slope_at(jnp.ones_like(slope)), jnp.zeros_like(slope)
        # A slope still below 0 at the end of the step needs no search.
        start = (zero, slope, jnp.ones_like(slope), whole, jnp.maximum(whole, 0), 0)
        low, _, high, _, found, count = jax.lax.while_loop(goes_on, one, start)
        last = jnp.where(found < 0, low, high)
        return jnp.where(count == 0, 1, last)
