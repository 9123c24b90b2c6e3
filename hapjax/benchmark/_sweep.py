"""hapjax's side of a work-precision diagram: one compiled program a case and integrator, for any dt."""

import dataclasses
import time
from collections.abc import Callable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..errors import InputError
from ..integrate import METHODS
from ..scene import Scene
from ..simulate import State, init, step
from .cases import Case

REPEATS, LONG = 3, 0.3  # runs shorter than LONG s are repeated, and the best counts
ROUND = 0.01  # s that a timed call takes at least
MORE = 4
HUGE = 1e3  # an error above it is that of a run that has blown up
WITNESSES = ("lie_midpoint", "implicit", "semi_implicit")  # by which a truth is extrapolated
AGREED, LONGEST = 1e-3, 10.0  # in the case's unit, to which two have to agree; s of the longest run for it


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


@dataclasses.dataclass(frozen=True)
class Sweep:
    """How much is run: hapjax's and MuJoCo's `dts` (s), `around` further numbers of steps whose errors are averaged
    with each, up to MORE times as many where runs are short, the `most` steps of a run, and whether `gradients` are run too.

    Steps are counted, not timed: which dt are run, and so the orders, do not depend on the machine. A derivative scatters
    more than a state by where in a step a touch begins, so it is averaged over more runs, each of a tenth of the steps.
    Where an error does not scatter one run of each dt is enough, which may have as many steps as any.
    """

    dts: Sequence[float]
    mujoco_dts: Sequence[float]
    around: int
    most: int
    gradients: bool = True

    def longest(self, integrator: str, scatters: bool = True) -> int:
        """The most steps of a run; of `implicit`, a step of which takes long, a fifth where several are averaged."""
        return self.most // 5 if integrator == "implicit" and scatters else self.most

    def has_gradient(self, integrator: str, steps: int, scatters: bool) -> bool:
        """Whether the derivative of so many steps is run."""
        most = self.longest(integrator, scatters)
        return self.gradients and steps <= (most // 10 if scatters and integrator != "implicit" else most)

    def runs(self, integrator: str, steps: int, scatters: bool) -> list[int]:
        """The numbers of steps whose errors are averaged: more of them where they are short."""
        if not scatters:
            return [steps]
        number = self.around * self.longest(integrator) / steps
        return neighbours(steps, int(np.clip(number, self.around, MORE * self.around)))


FULL = Sweep([*np.logspace(-2, -6, 17)], [*np.logspace(-2, -4.5, 11)], 6, 300_000)
QUICK = Sweep([*np.logspace(-2, -13 / 3, 8)], [*np.logspace(-2, -4, 5)], 0, 60_000, gradients=False)


def when(integrator: str) -> float:
    """At which part of a step an integrator wants the fingers' place: the midpoint rule in the middle."""
    return 0.5 if integrator == "lie_midpoint" else 1.0


def final_state(
    case: Case, integrator: str, substeps: int | None = None
) -> tuple[Scene, Callable[[Scene, Any, Any], tuple[State, Any]]]:
    """A case's scene and the function (scene, dt, steps) of the last state, and whether a step was lost.

    The number of steps may be traced. With `substeps` a step is cut into so many, and fed the fingers' place at its end.
    """
    scene = case.scene(METHODS[integrator](substeps=substeps or 1))
    part = when(integrator) if substeps is None else 1.0

    def final(scene: Scene, dt: Any, steps: Any) -> tuple[State, Any]:
        scene = eqx.tree_at(lambda s: s.integrator.dt, scene, dt)
        later = None if case.change is None else case.change(scene)
        begin = (part - 1) * dt
        state = case.start(init(scene, case.hip(begin), None if case.gimbal is None else case.gimbal(begin)))

        def body(i, carry):
            state, lost = carry
            now = (
                scene
                if later is None
                else jax.tree.map(lambda a, b: jnp.where(2 * i < steps, a, b), scene, later)
            )
            t = (i.astype(dt.dtype) + part) * dt
            gimbal = None if case.gimbal is None else case.gimbal(t)
            state, reply = step(now, state, case.hip(t), gimbal=gimbal)
            return state, lost | reply.lost

        return jax.lax.fori_loop(0, steps, body, (state, jnp.zeros((), bool)))

    return scene, final


class Program:
    """A compiled case with one integrator, for any dt; see `final_state` for `substeps`."""

    def __init__(self, case: Case, integrator: str, substeps: int | None = None):
        self.case = case
        self.scene, final = final_state(case, integrator, substeps)

        def measured(scene, dt, steps):
            state, lost = final(scene, dt, steps)
            return jnp.where(lost, jnp.nan, case.measure(state))

        def repeated(scene, dt, steps, rounds):
            # Each round waits for the one before, so that none is left out; no value is so large that it changes dt.
            first = jax.tree.map(
                lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(measured, scene, dt, steps)
            )

            def body(_, before):
                return measured(scene, jnp.where(jnp.max(before) == jnp.inf, 0.5 * dt, dt), steps)

            return jax.lax.fori_loop(0, rounds, body, first)

        def slope(scene, dt, steps):
            assert case.gradient is not None
            where = case.gradient.where

            def at(leaf):
                return measured(eqx.tree_at(where, scene, leaf), dt, steps)

            leaf = where(scene)
            along = jnp.broadcast_to(jnp.asarray(case.gradient.along, leaf.dtype), leaf.shape)
            return jax.jvp(at, (leaf,), (along,))[1]

        self._slope = slope
        began = time.perf_counter()
        self._repeated = jax.jit(repeated).lower(*self._arguments(self.scene, 1), jnp.int32(1)).compile()
        self.compile_s = time.perf_counter() - began

    def _arguments(self, scene: Scene, steps: int):
        dtype = jax.tree.leaves(scene)[0].dtype
        return scene, jnp.asarray(self.case.seconds / steps, dtype), jnp.asarray(steps, jnp.int32)

    def run(self, steps: int, rigid: bool = False, rounds: int = 1) -> tuple[np.ndarray, float]:
        """What is compared, and s of a run, of the scene or of its `rigid` form."""
        scene = self.scene
        if rigid and self.case.rigid is not None:
            scene = self.case.rigid(scene, self.case.seconds / steps)
        arguments = (*self._arguments(scene, steps), jnp.int32(rounds))
        began = time.perf_counter()
        value = jax.block_until_ready(self._repeated(*arguments))
        return np.asarray(value), (time.perf_counter() - began) / rounds

    def timed(self, steps: int) -> float:
        """The least s of a run, of several; short ones go round in one call, so that the call does not count."""
        first = self.run(steps)[1]
        if first >= LONG:
            return first
        rounds = int(min(max(np.ceil(ROUND / first), 1), 1000))
        return min(self.run(steps, rounds=rounds)[1] for _ in range(REPEATS))

    def compile_gradient(self) -> Callable[[int], np.ndarray]:
        """The program of the derivative in the case's leaf, by forward mode, for a number of steps."""
        program = jax.jit(self._slope).lower(*self._arguments(self.scene, 1)).compile()
        return lambda steps: np.asarray(program(*self._arguments(self.scene, steps)))


def steps_of(seconds: float, dts: Sequence[float]) -> list[int]:
    """Numbers of steps at about these dt, coarsest first; even, so that half time is between two steps."""
    return sorted({2 * max(round(seconds / dt / 2), 1) for dt in dts})


def neighbours(steps: int, number: int) -> list[int]:
    """Numbers of steps within 10 % of one, even: where in a step a touch begins is chance, so errors are averaged."""
    spread = np.linspace(-0.1, 0.1, number) if number else ()
    return sorted({steps, *(2 * max(round(steps * (1 + part) / 2), 1) for part in spread)})


def curve_of_substeps(
    case: Case, integrator: str, truth: np.ndarray, sweep: Sweep
) -> tuple[list[Point], float]:
    """As `curve`, of a case that has `ticks`: each point is what a loop with so many substeps gets."""
    assert case.ticks is not None
    points, compile_s = [], 0.0
    for steps in steps_of(case.seconds, sweep.dts):
        if points and steps > sweep.longest(integrator):
            break
        program = Program(case, integrator, round(steps / case.ticks))
        compile_s += program.compile_s
        error = difference(program.run(case.ticks)[0], truth)
        points.append(Point(case.seconds / steps, program.timed(case.ticks) / case.seconds, error, error))
    return points, compile_s


def difference(value: np.ndarray, truth: np.ndarray) -> float:
    """The norm of the difference; infinite where a run has blown up."""
    error = float(np.linalg.norm(np.asarray(value, float) - truth))
    return error if error < HUGE else float("inf")


def mean_square(errors: Sequence[float]) -> float:
    """The root of the mean square."""
    return float(np.sqrt(np.mean(np.square(errors))))


def curve(
    case: Case, integrator: str, truth: np.ndarray | None, law: np.ndarray, sweep: Sweep
) -> tuple[list[Point], float]:
    """The points of one integrator, coarsest first, up to the sweep's most steps; and s to compile."""
    program, points = Program(case, integrator), []
    slope, known, size = None, None, 1.0
    if case.gradient is not None and sweep.gradients:
        slope, known = program.compile_gradient(), case.gradient.truth()
        size = float(np.linalg.norm(known))
    scatters = case.scatters(integrator)
    for steps in steps_of(case.seconds, sweep.dts):
        if points and steps > sweep.longest(integrator, scatters):
            break
        around = sweep.runs(integrator, steps, scatters)
        values = [program.run(n)[0] for n in around]
        laws = [program.run(n, rigid=True)[0] for n in around] if case.rigid else values
        slopes = None
        if slope is not None and known is not None and sweep.has_gradient(integrator, steps, not case.smooth):
            averaged = sweep.runs(integrator, steps, not case.smooth)
            slopes = [difference(slope(n) / size, known / size) for n in averaged]
        points.append(
            Point(
                case.seconds / steps,
                program.timed(steps) / case.seconds,
                None if truth is None else mean_square([difference(v, truth) for v in values]),
                mean_square([difference(v, law) for v in laws]),
                None if slopes is None else mean_square(slopes),
            )
        )
    return points, program.compile_s


def extrapolated(case: Case, sweep: Sweep) -> tuple[np.ndarray, float]:
    """The truth by Richardson's extrapolation of an integrator's finest steps with which another's agrees, and its
    uncertainty.

    Rigid-stiff contacts forbid some integrators any step that can be run, so each is refined by itself, and only those
    count that converge without a lost step.

    **Raises:** `InputError` where no two agree to AGREED.
    """
    found: dict[str, tuple[np.ndarray, float]] = {}
    for name in WITNESSES:
        value, floor = _refined(case, name, steps_of(case.seconds, sweep.dts)[-1])
        if not floor <= AGREED:
            found[name] = value, floor
            continue
        for known, known_floor in found.values():
            apart = difference(value, known)
            if known_floor <= AGREED and apart <= AGREED:
                pair = [(known_floor, known, floor), (floor, value, known_floor)]
                own, best, others = min(pair, key=lambda item: item[0])
                return best, max(own, apart - others)
        found[name] = value, floor
    said = ", ".join(f"{name} to {floor:.0e}" for name, (_, floor) in found.items())
    raise InputError(
        f"{case.name}: no truth to compare with, for its end by finer and finer steps is certain {said} {case.unit}; "
        f"allowed: a motion that two integrators know to {AGREED:g} {case.unit}, so softer contacts or a shorter one"
    )


def _refined(case: Case, integrator: str, steps: int) -> tuple[np.ndarray, float]:
    """What an integrator's runs converge to, extrapolated, and how far the last refinement moved that.

    It starts at about `steps`, or fewer where a step takes long, and goes on as long as the end is not certain to AGREED
    and a run takes less than LONGEST s.
    """
    program, order = Program(case, integrator), case.order(integrator).value or 1
    program.run(2)  # the first call is slower
    taken = program.run(max(steps // 64, 2))[1] / max(steps // 64, 2)
    steps = max(int(min(steps, LONGEST / 4 / taken)) // 8 * 8, 8)
    values = [program.run(n)[0] for n in (steps, 2 * steps, 4 * steps)]
    while True:
        better = [b + (b - a) / (2**order - 1) for a, b in zip(values, values[1:], strict=False)]
        floor = difference(better[1], better[0])
        steps *= 2
        if floor <= AGREED or 4 * steps * taken > LONGEST:
            return better[1], floor
        values = [*values[1:], program.run(4 * steps)[0]]
