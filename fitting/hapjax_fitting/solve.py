"""Nonlinear least squares from several starts at once: optimistix's Levenberg-Marquardt."""

from collections.abc import Callable
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Bool, Float, Int

_WORTH = 1e-3  # of a residual's variance, for each number: what there is to gain from going on
_ROUNDING = 10  # times the rounding error of one number: that of a sum of squares

Residuals = Callable[[Float[Array, " p"], Any], Any]
Reduced = Callable[[Float[Array, " p"], Any], tuple[Float[Array, "m p"], Float[Array, " m"]]]


class Solutions(eqx.Module):
    """Where each start ended: `free` (S, p), its `loss` (S,), whether the solver met its tolerances, after how many
    `steps`; of the start with the lowest loss also the `jacobian` (m, p), as it was reduced.

    The loss is half the sum of the squared residuals at `free` itself, not the solver's last word.
    """

    free: Float[Array, "*S p"]
    loss: Float[Array, "*S"]
    converged: Bool[Array, "*S"]
    steps: Int[Array, "*S"]
    jacobian: Float[Array, "*m p"]

    @property
    def best(self) -> int:
        """The start with the lowest loss."""
        return int(jnp.argmin(jnp.where(jnp.isfinite(self.loss), self.loss, jnp.inf)))

    @property
    def slopes(self) -> Float[np.ndarray, "*m p"]:
        """The Jacobian, or 0 where it is not finite.

        A wild simulation may have a loss, but derivatives beyond what numbers hold: none is to be claimed by these.
        """
        jacobian = np.asarray(self.jacobian)
        return jacobian if np.isfinite(jacobian).all() else np.zeros_like(jacobian)

    @property
    def at_best(self) -> "Solutions":
        """The start with the lowest loss alone."""
        one = slice(self.best, self.best + 1)
        return Solutions(self.free[one], self.loss[one], self.converged[one], self.steps[one], self.jacobian)

    def joined(self, other: "Solutions") -> "Solutions":
        """These starts and the other ones."""
        of_best = other if other.loss[other.best] < self.loss[self.best] else self
        return Solutions(
            free=jnp.concatenate([self.free, other.free]),
            loss=jnp.concatenate([self.loss, other.loss]),
            converged=jnp.concatenate([self.converged, other.converged]),
            steps=jnp.concatenate([self.steps, other.steps]),
            jacobian=of_best.jacobian,
        )


@dataclass
class Trace:
    """What the solver tells while it runs: for each start, the loss at each of its steps, and its best numbers.

    `expected`: how many starts there will be, as far as is known; `should_stop` is asked at each step;
    `interrupted`: the search was ended by Ctrl-C.
    """

    on_step: Callable[[int, int, float], None] | None = None
    on_stage: Callable[[str], None] | None = None
    losses: dict[int, dict[int, float]] = field(default_factory=dict)
    best: dict[int, tuple[float, np.ndarray]] = field(default_factory=dict)
    expected: int = 0
    should_stop: Callable[[], bool] | None = None
    interrupted: bool = False

    def add(self, start: int, step: int, loss: float, free: np.ndarray) -> None:
        """Note one step of one start."""
        self.losses.setdefault(start, {})[step] = loss
        self.keep(start, loss, free)
        if self.on_step is not None:
            self.on_step(start, step, loss)

    def keep(self, start: int, loss: float, free: np.ndarray) -> None:
        """Remember the numbers of a start if they are its best."""
        if loss < self.best.get(start, (float("inf"),))[0]:
            self.best[start] = loss, free


_listening: list[Trace] = []


@contextmanager
def listen(trace: Trace):
    """Let `trace` hear the solver's steps inside the block."""
    _listening.append(trace)
    try:
        yield trace
    finally:
        if not trace.interrupted:
            jax.effects_barrier()
        _listening.remove(trace)


def tell(stage: str) -> None:
    """Say what is being done before the solver has steps to tell of."""
    for trace in _listening:
        if trace.on_stage is not None:
            trace.on_stage(stage)


def keep(start: int, loss: float, free: np.ndarray) -> None:
    """Have numbers that a start came to before the solver runs to go by, should the search end there."""
    for trace in _listening:
        trace.keep(start, loss, free)


def expect(starts: int) -> None:
    """Say how many starts there will be, those included that are done."""
    for trace in _listening:
        trace.expected = starts


def _bits(numbers: Float[Array, " n"]) -> Int[Array, "*n"]:
    """Floats as whole numbers of 32 bits: the thread of a callback may not know that 64 bits are on, and would round."""
    return jax.lax.bitcast_convert_type(numbers, jnp.int32)


def _floats(bits: Int[Array, "*n"]) -> Float[np.ndarray, " n"]:
    numbers = np.array(bits)
    return numbers.view(np.float32 if numbers.ndim == 1 else np.float64).ravel()


def _hear(start: Array, step: Array, bits: Int[Array, "*n"]) -> None:
    loss, *free = _floats(bits)
    for trace in _listening:
        trace.add(int(start), int(step), float(loss), np.array(free))
        if trace.should_stop is not None and trace.should_stop():
            raise RuntimeError("interrupted")


def jacobian(residuals: Residuals, free: Float[Array, " p"], args: Any) -> tuple[Any, Any]:
    """The Jacobian and the residuals. Forward mode: the parameters are few, the samples many."""

    def twice(x):
        found = residuals(x, args)
        return found, found

    return jax.jacfwd(twice, has_aux=True)(free)


def _told_whole(reduced: Reduced) -> Residuals:
    """The residuals, with the whole Jacobian as their derivative.

    A linearised rollout would keep all its steps' intermediate values for as long as the solver keeps the
    Jacobian; this keeps the m x p matrix alone, and computes it with all directions side by side.
    """

    @jax.custom_jvp
    def told(free, args):
        return reduced(free, args)[1]

    @told.defjvp
    def _(primals, tangents):
        matrix, found = reduced(*primals)
        return found, jnp.matmul(matrix, tangents[0], precision="highest")

    return told


def solve(
    residuals: Residuals,
    starts: Float[Array, "S p"],
    places: Int[Array, " S"],
    args: Any,
    rtol: float,
    atol: float,
    max_steps: int,
    reduced: Reduced | None = None,
) -> Solutions:
    """Minimise half the sum of the squared residuals from each start; `places` number them in a `Trace`.

    `reduced(free, args)` gives the Jacobian and the residuals in fewer rows, with the same inner products of columns;
    `None`: all rows. Both must be the same function objects from call to call, else each call compiles anew.
    """
    # Compiled apart from the solver, which then has a single copy of the residuals in it.
    found = [with_loss(residuals, start, args) for start in starts]
    totals, worth = jnp.stack([2 * loss for loss, _ in found]), _WORTH * starts.shape[1] / len(found[0][1])
    reduced = eqx.Partial(jacobian, residuals) if reduced is None else reduced
    return _solve(
        reduced, starts, places, totals, args, rtol, atol, max_steps, jnp.asarray(worth, starts.dtype)
    )


@eqx.filter_jit
def with_loss(
    residuals: Residuals, free: Float[Array, " p"], args: Any
) -> tuple[Float[Array, ""], Float[Array, " n"]]:
    """The loss, half the sum of the squared residuals, and those."""
    found = residuals(free, args)
    return 0.5 * jnp.sum(found**2), found


def so_far(reduced: Reduced, args: Any, trace: Trace) -> Solutions:
    """Where each start of a search that was ended had got to."""
    losses, found = zip(*(trace.best[start] for start in sorted(trace.best)), strict=True)
    free, loss = jnp.stack([jnp.asarray(x) for x in found]), jnp.asarray(losses, found[0].dtype)
    matrix, _ = eqx.filter_jit(reduced)(free[jnp.argmin(loss)], args)
    steps = jnp.array([max(trace.losses.get(start, (0,))) for start in sorted(trace.best)])
    return Solutions(free, loss, jnp.zeros(len(loss), bool), steps, matrix)


class _Search(optx.ClassicalTrustRegion):
    """Which steps are taken: also one too small for rounding to tell whether it makes the loss smaller.

    Refused, such a step would be tried again, smaller and smaller, until chance takes it.
    """

    def step(self, first_step, y, y_eval, f_info, f_eval_info, state):
        """The new step size, whether the step is taken, and what is remembered."""
        size, accept, result, after = super().step(first_step, y, y_eval, f_info, f_eval_info, state)
        loss = f_info.as_min()
        rounding = _ROUNDING * jnp.finfo(loss.dtype).eps * loss
        expected = self.predict_reduction(y_eval - y, f_info)
        level = (jnp.abs(expected) < rounding) & (jnp.abs(f_eval_info.as_min() - loss) < rounding)
        size = jnp.where(level & ~accept, state.step_size, size)
        return size, accept | level, result, eqx.tree_at(lambda s: s.step_size, after, size)


class _Solver(optx.LevenbergMarquardt):
    """Which search ends: also one whose step was refused where next to nothing is left to gain.

    A god-object that begins to slide a step earlier bends the loss. Close to the least loss such bends lead a search on,
    smaller and smaller, by far less than the noise; among many recordings there is always one that has some. What is
    left is told by the linear model: half the square of the part of the residuals that the Jacobian's columns span.
    """

    worth: Array = eqx.field(kw_only=True)  # a share of the loss

    def __init__(self, *args, worth: Array, **options):
        super().__init__(*args, **options)
        self.worth, self.search = worth, _Search()

    def terminate(self, fn, y, args, options, state, tags):
        """Whether to stop, and how it went."""
        done, result = super().terminate(fn, y, args, options, state, tags)

        def is_spent():
            residuals = state.f_info.residual
            basis = jnp.linalg.qr(state.f_info.jac.as_matrix())[0]
            left = jnp.matmul(residuals, basis, precision="highest")
            return jnp.sum(left**2) < self.worth * jnp.sum(residuals**2)

        refused = state.num_steps_since_acceptance > 0
        return done | jax.lax.cond(refused, is_spent, lambda: jnp.zeros((), bool)), result


@eqx.filter_jit
def _solve(
    reduced: Reduced, starts, places, totals, args, rtol, atol, max_steps: int, worth: Array
) -> Solutions:
    told = _told_whole(reduced)

    def one(start, place, total):
        def tell(num_steps, loss_this_step, y, **_):
            numbers = jnp.concatenate([(loss_this_step[1] * total)[None], y[1]])
            jax.debug.callback(_hear, place, num_steps[1], _bits(numbers))

        # Levenberg-Marquardt begins with a damping of 1: right for a problem of about that size.
        scale = jax.lax.rsqrt(jnp.maximum(total, jnp.finfo(start.dtype).tiny))
        solver = _Solver(rtol=rtol, atol=atol, verbose=tell, worth=worth)
        with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
            solution = optx.least_squares(
                lambda x, _: scale * told(x, args),
                solver,
                start,
                max_steps=max_steps,
                throw=False,
                options={"jac": "fwd"},
            )
        at_end = solution.state.f_info  # of the last step that was accepted, so of the value
        loss = 0.5 * jnp.sum((at_end.residual / scale) ** 2)
        done = solution.result == optx.RESULTS.successful
        return Solutions(
            solution.value, loss, done, solution.stats["num_steps"], at_end.jac.as_matrix() / scale
        )

    def next_start(best, item):
        end = one(*item)
        better = end.loss < best[0]
        best = jax.tree.map(lambda x, y: jnp.where(better, x, y), (end.loss, end.jacobian), best)
        return best, (end.free, end.loss, end.converged, end.steps)

    # One after the other: on a CPU a batch is no faster, and would run until its slowest start is done.
    count = jax.eval_shape(told, starts[0], args).shape[0]
    none = jnp.asarray(jnp.inf, starts.dtype), jnp.zeros((count, starts.shape[1]), starts.dtype)
    best, ends = jax.lax.scan(next_start, none, (starts, places, totals))
    return Solutions(*ends, best[1])
