"""hapjax's side of a work-precision diagram: one compiled program a case and integrator, for any dt."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..integrate import METHODS
from ..scene import Scene
from ..simulate import State, init, step
from .cases import Case

REPEATS, LONG = 3, 0.3  # runs shorter than LONG s are repeated, and the best counts


@dataclasses.dataclass(frozen=True)
class Point:
    """One run: `dt` s, s of run time a simulated second, and the errors; `None`: not known here.

    `law_error` is that against the rigid law, by which hapjax and MuJoCo are compared; `gradient_error` is relative.
    """

    dt: float
    run: float
    error: float | None
    law_error: float
    gradient_error: float | None = None


def when(integrator: str) -> float:
    """At which part of a step an integrator wants the fingers' place: the midpoint rule in the middle."""
    return 0.5 if integrator == "lie_midpoint" else 1.0


def final_state(case: Case, integrator: str) -> tuple[Scene, Callable[[Scene, Any, Any], State]]:
    """A case's scene and the function (scene, dt, steps) of the last state; the number of steps may be traced."""
    scene, part = case.scene(METHODS[integrator]()), when(integrator)

    def final(scene: Scene, dt: Any, steps: Any) -> State:
        scene = eqx.tree_at(lambda s: s.integrator.dt, scene, dt)
        later = None if case.change is None else case.change(scene)
        state = case.start(init(scene, case.hip((part - 1) * dt)))

        def body(i, state):
            now = (
                scene
                if later is None
                else jax.tree.map(lambda a, b: jnp.where(2 * i < steps, a, b), scene, later)
            )
            return step(now, state, case.hip((i.astype(dt.dtype) + part) * dt))[0]

        return jax.lax.fori_loop(0, steps, body, state)

    return scene, final


class Program:
    """A compiled case with one integrator: `run(dt)` gives what is compared and what the law speaks of."""

    def __init__(self, case: Case, integrator: str):
        self.case = case
        self.scene, final = final_state(case, integrator)

        def measured(scene, dt, steps):
            state = final(scene, dt, steps)
            value = case.measure(state)
            return value, (value if case.law_measure is None else case.law_measure(state))

        def slope(scene, dt, steps):
            assert case.gradient is not None
            where = case.gradient.where
            at = lambda leaf: measured(eqx.tree_at(where, scene, leaf), dt, steps)[0]  # noqa: E731
            return jax.jvp(at, (where(scene),), (jnp.ones_like(where(scene)),))[1]

        self._slope = slope
        example = self._arguments(1)
        began = time.perf_counter()
        self._measured = jax.jit(measured).lower(*example).compile()
        self.compile_s = time.perf_counter() - began

    def _arguments(self, steps: int):
        leaf = jax.tree.leaves(self.scene)[0]
        return self.scene, jnp.asarray(self.case.seconds / steps, leaf.dtype), jnp.asarray(steps, jnp.int32)

    def run(self, steps: int, repeats: int = REPEATS) -> tuple[np.ndarray, np.ndarray, float]:
        """What is compared, what the law speaks of, and the least s of a run."""
        arguments, best, value = self._arguments(steps), np.inf, None
        for _ in range(repeats):
            began = time.perf_counter()
            value = jax.block_until_ready(self._measured(*arguments))
            best = min(best, time.perf_counter() - began)
            if best > LONG:
                break
        assert value is not None
        return np.asarray(value[0]), np.asarray(value[1]), best

    def compile_gradient(self) -> Callable[[int], np.ndarray]:
        """The program of the derivative in the case's leaf, by forward mode, for a number of steps."""
        program = jax.jit(self._slope).lower(*self._arguments(1)).compile()
        return lambda steps: np.asarray(program(*self._arguments(steps)))


def steps_of(seconds: float, dts: Sequence[float], coarsest: float) -> list[int]:
    """Numbers of steps at about these dt, coarsest first; even, so that half time is between two steps."""
    return sorted({2 * max(round(seconds / dt / 2), 1) for dt in dts if dt <= coarsest * 1.0001})


def neighbours(steps: int, number: int) -> list[int]:
    """Numbers of steps within 4 % of one, even: where in a step a touch begins is chance, so errors are averaged."""
    return sorted({steps, *(2 * round(steps * (1 + 0.04 * j) / 2) for j in np.linspace(-1, 1, number))})


def difference(value: np.ndarray, truth: np.ndarray) -> float:
    """The norm of the difference; infinite where a run has left all numbers."""
    error = float(np.linalg.norm(np.asarray(value, float) - truth))
    return error if np.isfinite(error) else float("inf")


def mean_square(errors: Sequence[float]) -> float:
    """The root of the mean square."""
    return float(np.sqrt(np.mean(np.square(errors))))
