"""`hapjax benchmark`."""

import inspect
from pathlib import Path
from typing import Literal

import jax
from tyro.conf import FlagCreatePairsOff, Positional

from ..extras import need
from ..files import check_apart, check_writable
from ..progress import following
from ..scene_file import load_scene


def benchmark(
    kind: Positional[Literal["latency", "scene", "stability", "error", "gradient", "batch", "fit"]],
    scene: Path | None = None,
    fingers: int = 3,
    seconds: float = 5.0,
    integrators: tuple[str, ...] = (),
    maps: tuple[str, ...] = (),
    rate: float = 1000.0,
    quick: FlagCreatePairsOff[bool] = False,
    cases: tuple[str, ...] = (),
    hip: Path | None = None,
    error: float | None = None,
    out: Path | None = None,
    json: Path | None = None,
) -> None:
    """Measure on this machine.

    latency: one step inside a compiled loop, one packed call beside an empty one, the servo loop's lateness and missed
    ticks at 1 kHz with either call, compile time. scene: equations, floating-point operations and time of a step of the
    scene, and of the scene with each part switched off in turn. stability: where each integrator settles, rings or
    blows up, and how stiff a wall a device can press on. error: error against run time of each integrator, beside
    MuJoCo's, on cases with a known truth. gradient: time and memory of gradients beside the forward pass. batch: steps
    and gradients a second of batches of rollouts, and how far a held object creeps, beside MuJoCo's. fit: errors of
    estimates beside the least possible, how often 95 % intervals hold the truth, how long fits take.
    Example: hapjax benchmark latency --json latency.json

    Args:
        kind: Which measurement.
        scene: Scene file (TOML); absent: the demo's, and of stability, error and gradient the built-in cases. Not of batch
            and fit.
        fingers: Number of fingers, 1 to 100.
        seconds: How long the servo loop of latency runs with each call, above 0 to 3600 s.
        integrators: Of stability and error: names as in scene files; none: all.
        maps: Of stability: stiffness mass mass_ratio mu penetration spin inertia loop; none: all.
        rate: Of stability and error: Hz at which --scene is to run, 10 to 100000.
        quick: Of stability: a coarse grid. Of error: fewer time steps, each run once, no gradients. Of fit: a fiftieth.
        cases: Of error: names of built-in cases; none: all.
        hip: Of error with --scene, and of stability with --error: recording (.npz, .csv) whose channel hip the fingers
            follow; absent: a virtual operator grips and lifts the first object that moves.
        error: Of error and stability with --scene: m that the recommended integrator may be off at the end, above 0;
            absent: of error 0.0001, of stability what settles is enough.
        out: Of stability and error: folder for the page, the pictures and the CSV files. Of fit: for all estimates as CSV.
        json: File for the figures; - is standard output.
    """
    options = locals()
    with following(None, doing="loading the library"):
        from ..at_once import compute_at_once
        from ..benchmark import _options, batch, gradient, latency, stability
        from ..benchmark import error as errors
        from ..benchmark import scene as parts

    defaults = {name: each.default for name, each in inspect.signature(benchmark).parameters.items()}
    given = {name: value for name, value in options.items() if value != defaults[name]}
    _options.check_options(kind, scene is not None, given)
    check_apart([json], [scene, hip])
    if json is not None:
        check_writable(json)
    if kind == "latency":
        compute_at_once()
    precise = kind == "error" or jax.config.read("jax_enable_x64")
    with following(None, doing="reading"), jax.enable_x64(precise):
        loaded = None if scene is None else load_scene(scene)
    if kind == "latency":
        latency.report(loaded, fingers, seconds, json)
    elif kind == "stability":
        stability.report(loaded, maps, integrators, quick, rate, fingers, error, hip, out, json)
    elif kind == "error":
        errors.report(
            loaded, hip, fingers, cases, integrators, quick, 1e-4 if error is None else error, rate, out, json
        )
    elif kind == "gradient":
        gradient.report(loaded, fingers, json)
    elif kind == "batch":
        batch.report(loaded, fingers, json)
    elif kind == "fit":
        need("hapjax_fitting.benchmark.report", "fitting").report(loaded, quick, out, json)
    else:
        parts.report(loaded, fingers, json)
