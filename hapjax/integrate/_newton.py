"""The minimum of a mass term and of potentials of forces, by Newton's method."""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

_MOST_STEPS, _MOST_TRIALS = 60, 60


class Balance(eqx.Module):
    """Velocities v (all objects' in one vector) at which momenta and impulses agree:

        M (v - free) = dt J' f(J v)

    **Arguments:** `mass` M; `free`, the velocities without touches; `slips` J, from v to the slip (m/s) of each point,
    one after the other; `force` f, from slips to forces (N); `dt` (s).
    """

    mass: Float[Array, "D D"]
    free: Float[Array, "D"]
    slips: Float[Array, "R D"]
    force: Callable[[Float[Array, "N 3"]], Float[Array, "N 3"]]
    dt: Float[Array, ""]

    def residual(self, v: Float[Array, "D"]) -> Float[Array, "D"]:
        """By how much they do not agree (N s, N m s)."""
        force = self.force(self._slip(v))
        return _times(self.mass, v - self.free) - self.dt * _times(self.slips.T, force.ravel())

    def solve(self, guess: Float[Array, "D"]) -> Float[Array, "D"]:
        """The v for which the residual is 0. Derivatives are those of the solution, not of the way to it."""

        def balanced(v):
            return self.residual(v)

        def tangent_solve(linear, y):
            return _solved(jax.vmap(linear, out_axes=1)(jnp.eye(y.size, dtype=y.dtype)), y)

        return jax.lax.custom_root(balanced, guess, lambda _, start: self._descend(start), tangent_solve)

    def _slip(self, v: Float[Array, "D"]) -> Float[Array, "N 3"]:
        return _times(self.slips, v).reshape(-1, 3)

    def _descend(self, start: Float[Array, "D"]) -> Float[Array, "D"]:
        """Newton steps with an exact line search, until the residual is none or v no longer changes."""
        energy = jnp.sum(start * _times(self.mass, start)) + jnp.sum(self.free * _times(self.mass, self.free))
        eps = jnp.finfo(start.dtype).eps
        little, least = eps**1.5 * energy, (64 * eps) ** 2 * energy

        def goes_on(carry):
            _, residual, change, count = carry
            left = jnp.sum(residual**2 / jnp.diagonal(self.mass))
            moved = jnp.sum(change * _times(self.mass, change))
            # Stiff touches magnify rounding, and a residual may stay; then steps no longer change v.
            return (left > little) & ((moved > least) | (count == 0)) & (count < _MOST_STEPS)

        def one(carry):
            v, residual, _, count = carry
            hessian = self._hessian(v)
            change = -_solved(hessian, residual)
            # In float32 rounding of stiff touches may lead uphill.
            leads = jnp.sum(residual * change) < 0  # and False of NaN
            change = jnp.where(leads, change, -residual / jnp.diagonal(hessian))
            v, residual = self._down(v, change, -jnp.sum(residual * change))
            return v, residual, change, count + 1

        return jax.lax.while_loop(goes_on, one, (start, self.residual(start), 0 * start, 0))[0]

    def _hessian(self, v: Float[Array, "D"]) -> Float[Array, "D D"]:
        force, along = jax.linearize(self.force, self._slip(v))
        columns = [along(jnp.broadcast_to(axis, force.shape)) for axis in jnp.eye(3, dtype=v.dtype)]
        rows = jnp.stack(columns, axis=-1)  # of each point: force against slip
        stiffness = -(rows + jnp.swapaxes(rows, -1, -2)) / 2
        slips = self.slips.reshape(-1, 3, v.size)
        curvature = jnp.sum(stiffness[..., None] * slips[:, None], axis=2).reshape(-1, v.size)
        return self.mass + self.dt * jnp.sum(self.slips[:, :, None] * curvature[:, None], axis=0)

    def _down(self, v, change, promise) -> tuple[Float[Array, "D"], Float[Array, "D"]]:
        """To the minimum along a Newton step, which is its end unless it climbs again before; and the residual there.

        The function is convex, so its slope along the step only grows: secants and halvings in turn find where it is 0.
        """

        def goes_on(carry):
            *_, slope, _, _, count = carry
            return (jnp.abs(slope) > 0.1 * promise) & (count < _MOST_TRIALS)

        def one(carry):
            low, low_slope, high, high_slope, _, _, _, count = carry
            secant = low - low_slope * (high - low) / (high_slope - low_slope)
            part = jnp.where(count % 2 == 0, secant, (low + high) / 2)
            residual = self.residual(v + part * change)
            slope = jnp.sum(residual * change)
            below, above = (
                jnp.stack([part, slope, high, high_slope]),
                jnp.stack([low, low_slope, part, slope]),
            )
            ends = jnp.where(slope < 0, below, above)
            return *ends, slope, part, residual, count + 1

        whole = jnp.ones_like(promise)
        residual = self.residual(v + change)
        slope = jnp.sum(residual * change)
        # Where the end still goes down there is nothing to search.
        start = (0 * whole, -promise, whole, slope, jnp.maximum(slope, 0), whole, residual, 0)
        *_, part, residual, _ = jax.lax.while_loop(goes_on, one, start)
        return v + part * change, residual


# Where all operations of a loop are simple ones, the compiler can make one function of it, several times as fast. Products
# of matrices and LAPACK are calls, a single one of which forbids that.


def _times(matrix: Float[Array, "A B"], vector: Float[Array, "B"]) -> Float[Array, "A"]:
    return jnp.sum(matrix * vector[None], axis=1)


def _solved(matrix: Float[Array, "D D"], vector: Float[Array, "D"]) -> Float[Array, "D"]:
    """Gauss's elimination, with no rows exchanged: for matrices whose symmetric part is positive definite."""
    tops, found = [], []
    for _ in range(vector.size):
        # Matrix and vector stay apart, or JAX does not see that the answer is linear in the vector.
        top, value, below = matrix[0, 1:] / matrix[0, 0], vector[0] / matrix[0, 0], matrix[1:, 0]
        matrix, vector = matrix[1:, 1:] - below[:, None] * top[None], vector[1:] - below * value
        tops.append((top, value))
    for top, value in reversed(tops):
        found.insert(0, value - jnp.sum(top * jnp.stack(found)) if found else value)
    return jnp.stack(found)
