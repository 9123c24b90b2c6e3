"""Nonlinear least squares from several starts at once: optimistix's Levenberg-Marquardt."""

from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

Residuals = Callable[[Float[Array, " p"], Any], Float[Array, " n"]]


class Solutions(eqx.Module):
    """Where each start ended: `free` (S, p), its `loss` (S,) = half the sum of squares, evaluated anew,
    whether the solver met its tolerances, and after how many `steps`."""

    free: Float[Array, "*S p"]
    loss: Float[Array, "*S"]
    converged: Bool[Array, "*S"]
    steps: Int[Array, "*S"]


@dataclass
class Trace:
    """What the solver tells while it runs: for each start, the loss at each of its steps."""

    on_step: Callable[[int, int, float], None] | None = None
    losses: dict[int, dict[int, float]] = field(default_factory=dict)

    def add(self, start: int, step: int, loss: float) -> None:
        """Note one step of one start."""
        self.losses.setdefault(start, {})[step] = loss
        if self.on_step is not None:
            self.on_step(start, step, loss)


_listening: list[Trace] = []


@contextmanager
def listen(trace: Trace):
    """Let `trace` hear the solver's steps inside the block."""
    _listening.append(trace)
    try:
        yield trace
    finally:
        jax.effects_barrier()
        _listening.remove(trace)


def _hear(start: Array, step: Array, loss: Array) -> None:
    for trace in _listening:
        trace.add(int(start), int(step), float(loss))


def jacobian(residuals: Residuals, free: Float[Array, " p"], args: Any) -> Float[Array, "n p"]:
    """Forward-mode Jacobian: the parameters are few, the samples many."""
    return jax.jacfwd(lambda x: residuals(x, args))(free)


def _told_whole(residuals: Residuals) -> Residuals:
    """The residuals, with the whole Jacobian as their derivative.

    A linearised rollout would keep all its steps' intermediate values for as long as the solver keeps the
    Jacobian; this keeps the n x p matrix alone, and computes it with all directions side by side.
    """

    @jax.custom_jvp
    def told(free, args):
        return residuals(free, args)

    @told.defjvp
    def _(primals, tangents):
        free, args = primals
        matrix = jacobian(residuals, free, args)
        return residuals(free, args), jnp.matmul(matrix, tangents[0], precision="highest")

    return told


@eqx.filter_jit
def solve(
    residuals: Residuals,
    starts: Float[Array, "S p"],
    places: Int[Array, " S"],
    args: Any,
    rtol: float,
    atol: float,
    max_steps: int,
) -> Solutions:
    """Minimise half the sum of the squared residuals from each start; `places` number them in a `Trace`.

    `residuals(free, args)` must be the same function object from call to call, else each call compiles anew.
    """
    told = _told_whole(residuals)

    def one(start, place):
        def tell(num_steps, loss_this_step, **_):
            jax.debug.callback(_hear, place, num_steps[1], loss_this_step[1] * total)

        # Levenberg-Marquardt begins with a damping of 1: right for a problem of about that size.
        total = jnp.sum(residuals(start, args) ** 2)
        scale = jax.lax.rsqrt(jnp.maximum(total, jnp.finfo(start.dtype).tiny))
        solver = optx.LevenbergMarquardt(rtol=rtol, atol=atol, verbose=tell)
        with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
            solution = optx.least_squares(
                lambda x, _: scale * told(x, args),
                solver,
                start,
                max_steps=max_steps,
                throw=False,
                options={"jac": "fwd"},
            )
        loss = 0.5 * jnp.sum(residuals(solution.value, args) ** 2)
        done = solution.result == optx.RESULTS.successful
        return Solutions(solution.value, loss, done, solution.stats["num_steps"])

    # One after the other: on a CPU a batch is no faster, and would run until its slowest start is done.
    return jax.lax.map(lambda each: one(*each), (starts, places))
