"""How fast a step is: inside a compiled loop, called from Python, in the servo loop, and how long it compiles."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np
from rich.console import Console
from rich.table import Table

from ..errors import InputError
from ..extras import need
from ..files import write_json
from ..packed import PackedStep, pack
from ..progress import each_tick, following
from ..scene import Scene, dtype_of
from ._timing import compiled, felt, step_us

ROUNDS, CALLS = 10, 500  # in which the two take turns, so that a busy moment hits both alike
RATE = 1000.0  # Hz, of the servo loop
TURN = 15.0  # s that it runs at a time, at most: what else the machine does goes on for longer


def measure(scene: Scene | None, fingers: int, seconds: float) -> dict[str, Any]:
    """All figures in us, but `compile_s`. `scene` `None`: the demo's, felt by its three fingers as in its lift.

    `scan_step`: one step inside a compiled loop, the median over repetitions; `packed_call` and `empty_call`: p50,
    p99, p99.9 and max of a call from Python and of one with the same arguments that does next to nothing; `loop` and
    `empty_loop`: the servo loop's lateness, work in a tick, the call in that, ticks and missed ticks at 1 kHz, with
    either call.

    **Raises:** `InputError` for a number of fingers outside 1 to 100 or a time outside 0 to 3600 s.
    """
    if not 1 <= fingers <= 100:
        raise InputError(f"fingers is {fingers}; allowed: 1 to 100")
    if not 0 < seconds <= 3600:
        raise InputError(f"seconds is {seconds}; allowed: above 0, at most 3600")
    servo = need("hapjax_devices", "devices")
    scene, devices = felt(scene, fingers)
    hip = np.stack([np.asarray(device.path[0]) for device in devices])
    gimbal = np.zeros(fingers) if scene.torsion is not None and scene.torsion.needs_gimbal else None
    with following(2 * seconds + 2.0, apart=True) as advance:
        packed = pack(scene, hip, 1 / RATE, gimbal)
        advance("compiling", 1.0)
        loop_of_steps, scan_compile = compiled(scene, hip, gimbal)
        advance("steps inside a scan", 1.0)
        (scan_step,) = step_us([loop_of_steps])
        inputs = [x.astype(packed.dtype) for x in (hip, gimbal) if x is not None]
        empty = replace(packed, call=_empty(packed, inputs))
        told = each_tick(advance, "servo loop", RATE)

        def felt_through(step: PackedStep, turn: float) -> Any:
            return servo.run(scene, devices, turn, RATE, packed=step, stopped=told)

        loops, refused = _loops(felt_through, {"loop": packed, "empty_loop": empty}, seconds)
        advance("calls", 0.0)
        packed_call, empty_call = _calls([packed.call, empty.call], packed, inputs)
    return {
        "device": str(jax.devices()[0]),
        "dtype": str(dtype_of(scene)),
        "fingers": len(devices),
        "scan_step_us": scan_step,
        "packed_call_us": _percentiles(packed_call),
        "empty_call_us": _percentiles(empty_call),
        "compile_s": {"step": packed.compile_s, "rollout": scan_compile},
        **loops,
        "refused": refused,
    }


def report(scene: Scene | None, fingers: int, seconds: float, file: Path | None) -> None:
    """Measure, print the table, and write the figures as JSON where a file is given."""
    figures = measure(scene, fingers, seconds)
    console = Console()
    for sentence in figures["refused"]:
        console.print(sentence)
    console.print(_table(figures))
    if file is not None:
        write_json(file, figures)


def _loops(
    felt_through: Callable[[PackedStep, float], Any], steps: dict[str, PackedStep], seconds: float
) -> tuple[dict[str, Any], list[str]]:
    """What the servo loop did with each step, for so many `seconds` in turns, and what it had to do without."""
    turns = int(np.ceil(seconds / TURN))
    results = {name: [] for name in steps}
    for _ in range(turns):
        for name, step in steps.items():
            results[name].append(felt_through(step, seconds / turns))

    def spread(of: str, own: list[Any]) -> dict[str, float]:
        return _percentiles(np.concatenate([getattr(result, of) for result in own]))

    figures = {
        name: {
            **{of: spread(of, own) for of in ("lateness_us", "compute_us", "step_us")},
            "ticks": sum(len(result.compute_us) for result in own),
            "missed": sum(result.missed for result in own),
        }
        for name, own in results.items()
    }
    return figures, list(results["loop"][0].refused)


def _empty(packed: PackedStep, inputs: list[np.ndarray]) -> partial[Any]:
    """A compiled call with the packed step's arguments and result that does next to nothing.

    The scene's numbers are among the arguments. It adds nothing times one number of each, since a call that only hands
    its argument back would not be made at all.
    """
    shapes = [jax.ShapeDtypeStruct(x.shape, x.dtype) for x in inputs]

    def empty(given, memory, *inputs):
        return memory + 0 * sum(x.ravel()[0] for x in jax.tree.leaves((given, inputs)))

    return partial(
        jax.jit(empty).lower(*packed.call.args, packed.start, *shapes).compile(), *packed.call.args
    )


def _calls(
    calls: Sequence[Callable[..., Any]], packed: PackedStep, inputs: list[np.ndarray]
) -> Iterator[np.ndarray]:
    """us of the calls of each program, forces read."""
    taken = np.empty((len(calls), ROUNDS, CALLS))
    for turn in range(ROUNDS):
        for call, times in zip(calls, taken[:, turn], strict=True):
            memory = packed.start
            for i in range(-100, CALLS):  # the first hundred are not counted
                began = time.perf_counter_ns()
                memory = call(memory, *inputs)
                packed.force(memory)
                times[max(i, 0)] = (time.perf_counter_ns() - began) * 1e-3
    return (times.ravel() for times in taken)


def _percentiles(values: np.ndarray) -> dict[str, float]:
    p50, p99, p999 = np.percentile(values, [50, 99, 99.9]).tolist()
    return {"p50": p50, "p99": p99, "p99.9": p999, "max": float(values.max())}


def _table(figures: dict[str, Any]) -> Table:
    columns = ("p50", "p99", "p99.9", "max")
    loops = {"servo loop at 1 kHz": figures["loop"], "the same with an empty call": figures["empty_loop"]}
    title = f"latency: {figures['fingers']} fingers, {figures['dtype']}, {figures['device']}"
    table = Table("what", *columns, "unit", title=title)

    def row(name: str, values: dict[str, float]) -> None:
        table.add_row(name, *(f"{values[c]:.1f}" for c in columns), "us")

    table.add_row("one step inside a scan", f"{figures['scan_step_us']:.1f}", "", "", "", "us")
    row("one packed call", figures["packed_call_us"])
    row("an empty call with the same arguments", figures["empty_call_us"])
    ratio = figures["packed_call_us"]["p50"] / figures["empty_call_us"]["p50"]
    table.add_row("packed over empty", f"{ratio:.2f}", "", "", "", "")
    for name, loop in loops.items():
        row(f"{name}, late by", loop["lateness_us"])
        row("work in a tick", loop["compute_us"])
        row("the call in that", loop["step_us"])
        table.add_row("missed ticks", f"{loop['missed']} of {loop['ticks']}", "", "", "", "")
    for name, seconds in figures["compile_s"].items():
        table.add_row(f"compile the {name}", f"{seconds:.2f}", "", "", "", "s")
    return table
