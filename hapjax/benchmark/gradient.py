"""What gradients of a rollout cost: time beside the forward pass, compile time, and memory against the number of steps."""

import os
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from ..errors import InputError
from ..files import write_json
from ..progress import Advance, following
from ..scene import Scene, dtype_of
from ..simulate import State, init, rollout
from . import _grip
from .error_scene import operator
from .gradient_settings import AS_IT_IS, ROUNDS, Programs, others, side_by_side

STEPS, LENGTHS, PARAMETERS, LIFT = 1000, (250, 1000, 4000), (1, 4, 10), 0.02


def measure(
    scene: Scene | None,
    fingers: int,
    steps: int = STEPS,
    lengths: Sequence[int] = LENGTHS,
    settings: Mapping[str, Mapping[str, str]] | None = None,
) -> dict[str, Any]:
    """The cost of gradients of the sum of squares of all objects' places at the end, in the scene's numbers.

    `times`: under the settings of this process and of each of `settings` (`None`: what `others` names), of each program
    `run_s`, the least of several runs, its `ratio` to that of the forward pass under the same setting, `compile_s`.
    `reverse` is in all numbers; `reverse, checkpoint` is that of `rollout(..., checkpoint=True)`; `forward, n` is in the
    scale of n of them at once. `memory`: bytes that the compiled reverse gradient takes beside what goes in and comes
    out, for each of `lengths` steps, and the `exponent` of their growth. `scene` `None`: three fingers lift a cube.

    **Raises:** `InputError` for a number of fingers outside 1 to 100, or a scene with no object for them to lift.
    """
    if not 1 <= fingers <= 100:
        raise InputError(f"fingers is {fingers}; allowed: 1 to 100")
    path, beside = _path(scene, fingers), others() if settings is None else settings
    with following(float(1 + len(beside) + ROUNDS + 2 * len(lengths)), apart=True) as advance:
        times = side_by_side(_programs, (scene, fingers, steps), beside, advance)
        scene = _grip.scene() if scene is None else scene
        memory = {
            "without checkpoint": _memory(scene, path, lengths, False, advance),
            "checkpoint": _memory(scene, path, lengths, True, advance),
        }
    return {
        "device": str(jax.devices()[0]),
        "dtype": str(dtype_of(scene)),
        "xla_flags": os.environ.get("XLA_FLAGS", ""),
        "nproc": os.environ.get("NPROC", ""),
        "fingers": path(1).shape[1],
        "steps": steps,
        "integrator": type(scene.integrator).__name__,
        "times": times,
        "memory": memory,
    }


def report(scene: Scene | None, fingers: int, file: Path | None) -> None:
    """Measure, print the tables, and write the figures as JSON where a file is given."""
    figures = measure(scene, fingers)
    for shown in (_time_table(figures), *fastest(figures), _memory_table(figures)):
        Console().print(shown)
    if file is not None:
        write_json(file, figures)


def _programs(scene: Scene | None, fingers: int, steps: int) -> Programs:
    """Ready to run: the forward pass, and its gradients."""
    hips = _path(scene, fingers)(steps)
    scene = _grip.scene() if scene is None else scene
    start, reverse = init(scene, hips[0], _gimbals(scene, hips, 1)), jax.grad(_end, allow_int=True)
    functions = {"forward pass": (_end, False), "reverse": (reverse, False)}
    functions["reverse, checkpoint"] = (reverse, True)
    functions |= {f"forward, {count}": (_scaled(scene, count), False) for count in PARAMETERS}
    programs = {}
    for name, (function, checkpoint) in functions.items():
        program, compile_s = _compiled(function, scene, start, hips, checkpoint)
        programs[name] = partial(program, scene, start, hips), compile_s
    return programs


def _path(scene: Scene | None, fingers: int) -> Callable[[int], jax.Array]:
    """The fingers' motion in any number of steps, (T, F, 3) m."""
    if scene is None:
        if fingers != 3:
            raise InputError(f"fingers is {fingers} without a scene; allowed: 3")
        return lambda steps: jnp.asarray(_grip.grip(steps, LIFT), _grip.precision())
    lift, dtype = operator(scene, fingers, 1000.0), dtype_of(scene)
    return lambda steps: jnp.asarray(lift[np.linspace(0, len(lift) - 1, steps).astype(int)], dtype)


def _gimbals(scene: Scene, hips: jax.Array, dimensions: int) -> jax.Array | None:
    needed = scene.torsion is not None and scene.torsion.needs_gimbal
    return jnp.zeros(hips.shape[2 - dimensions : 2], hips.dtype) if needed else None


def _end(scene: Scene, state: State, hips: jax.Array, checkpoint: bool) -> jax.Array:
    end, _ = rollout(scene, state, hips, None, _gimbals(scene, hips, 2), checkpoint=checkpoint)
    return sum((jnp.sum(m.position**2) for m in end.motion.values()), jnp.zeros((), hips.dtype))


def _scaled(scene: Scene, count: int):
    """Forward-mode derivatives in the scale of `count` of the scene's numbers, those of few entries first."""
    leaves, build = jax.tree.flatten(scene)
    wanted = sorted(
        (i for i, x in enumerate(leaves) if eqx.is_inexact_array(x)), key=lambda i: leaves[i].size
    )

    def slopes(scene, state, hips, checkpoint):
        def loss(scales):
            parts = jax.tree.leaves(scene)
            for i, scale in zip(wanted[:count], scales, strict=False):
                parts[i] = parts[i] * scale
            return _end(jax.tree.unflatten(build, parts), state, hips, checkpoint)

        return jax.jacfwd(loss)(jnp.ones(count, hips.dtype))

    return slopes


def _compiled(function, scene: Scene, state: State, hips: jax.Array, checkpoint: bool):
    """The compiled function, and s to trace and compile it."""
    began = time.perf_counter()
    program = jax.jit(function, static_argnums=3).lower(scene, state, hips, checkpoint).compile()
    return program, time.perf_counter() - began


def _memory(scene: Scene, path, lengths: Sequence[int], checkpoint: bool, advance: Advance) -> dict[str, Any]:
    taken = []
    for steps in lengths:
        hips = path(steps)
        start = init(scene, hips[0], _gimbals(scene, hips, 1))
        program, _ = _compiled(jax.grad(_end, allow_int=True), scene, start, hips, checkpoint)
        analysis = program.memory_analysis()
        if analysis is None:
            raise InputError(
                f"{jax.devices()[0]} does not tell memory; allowed: a device that does, a CPU say"
            )
        taken.append(analysis.temp_size_in_bytes)
        advance(f"memory of {steps} steps", 1.0)
    exponent = float(np.polyfit(np.log(lengths), np.log(taken), 1)[0])
    return {"steps": list(lengths), "bytes": taken, "exponent": exponent}


def _time_table(figures: dict[str, Any]) -> Table:
    """A row for each program: ms, and in brackets forward passes, under each setting."""
    title = (
        f"gradients of {figures['steps']} steps, ms (forward passes): {figures['fingers']} fingers, "
        f"{figures['integrator']}, {figures['dtype']}, {figures['device']}"
    )
    times = figures["times"]
    table = Table(title=title, title_justify="left", box=SIMPLE, padding=(0, 1, 0, 0))
    for heading in ("what", *times):
        table.add_column(heading, no_wrap=True)
    for program in times[AS_IT_IS]:
        rows = (setting[program] for setting in times.values())
        cells = (f"{row['run_s'] * 1e3:.2f} ({row['ratio']:.1f})" for row in rows)
        table.add_row(program, *cells)
    return table


def fastest(figures: dict[str, Any]) -> Iterator[str]:
    """A sentence for each program: under which setting it takes the least time."""
    times = figures["times"]
    for program in times[AS_IT_IS]:
        best = min(times, key=lambda name: times[name][program]["run_s"])
        row = times[best][program]
        yield (
            f"{program}: least with {best}, {row['run_s'] * 1e3:.2f} ms, {row['ratio']:.1f} of its passes; "
            f"compiled in {row['compile_s']:.1f} s."
        )


def _memory_table(figures: dict[str, Any]) -> Table:
    rows = figures["memory"]
    steps = next(iter(rows.values()))["steps"]
    table = Table("kB of the reverse gradient", *(f"{n} steps" for n in steps), "exponent")
    for name, row in rows.items():
        table.add_row(name, *(f"{b / 1e3:.0f}" for b in row["bytes"]), f"{row['exponent']:.2f}")
    return table
