"""Error against run time: work-precision diagrams of every integrator, beside MuJoCo's, on cases with a known truth."""

import csv
import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console

from ..errors import InputError
from ..extras import need
from ..files import check_makeable, finite, replacing, write_json
from ..integrate import METHODS
from ..progress import Advance, following
from ..scene import Scene, cast
from . import _grip, _mujoco, _sweep
from . import error_scene as own
from ._order import equal_time, fitted_order
from ._sweep import FULL, QUICK, Point, Sweep
from ._timing import compiled, step_us
from .cases import CASES, Case, Mujoco
from .stability_maps import check_names

ROUNDING = 1e-12  # in the case's unit: nothing below is told apart from 0
SOLVED = 1e-11  # to what an independent program knows its truth


def measure(
    cases: Sequence[Case],
    integrators: Sequence[str],
    sweep: Sweep,
    advance: Advance = lambda doing, steps: None,
) -> dict[str, Any]:
    """All figures, as they are written: by case, the points of each curve, its order, and who is ahead at equal time.

    Needs 64-bit numbers on.
    """
    missing = _missing()
    return {
        "device": str(jax.devices()[0]),
        "dtype": "float64",
        "xla_flags": os.environ.get("XLA_FLAGS", ""),
        "mujoco": missing or _mujoco.need("mujoco", "bench").__version__,
        "cases": {case.name: _case(case, integrators, sweep, missing, advance) for case in cases},
    }


def report(
    scene: Scene | None,
    hip: Path | None,
    fingers: int,
    cases: Sequence[str],
    integrators: Sequence[str],
    quick: bool,
    error: float,
    rate: float,
    out: Path | None,
    file: Path | None,
) -> None:
    """Measure, print the tables, and write JSON, and a folder of CSV, pictures and a page, where they are asked for.

    No `cases` and no `integrators` stand for all. With a `scene` that alone is the case, its fingers along a recording's
    `hip`, or moved by a virtual operator; it ends with the cheapest integrator and substeps within `error` (m) at `rate`.

    **Raises:** `InputError` for names, numbers or a scene that cannot be.
    """
    from . import _error_page as page

    _check(fingers, cases, integrators, error, rate)
    if out is not None:
        need("matplotlib", "bench")
        check_makeable(out)
    methods = [name for name in METHODS if name in (integrators or METHODS)]
    with jax.enable_x64(True):
        if scene is None:
            chosen, sweep = (
                [c for c in CASES.values() if c.name in (cases or CASES)],
                QUICK if quick else FULL,
            )
        else:
            scene = cast(scene, jnp.float64)
            chosen, sweep = (
                [own.scene_case(scene, *own.motion_of(scene, hip, fingers, rate), rate)],
                own.sweep_at(rate),
            )
        curves = sum(len(methods) + len(_mujoco.variants(case)) for case in chosen)
        with following(float(curves), apart=True) as advance:
            figures = measure(chosen, methods, sweep, advance)
            if scene is None and {"semi_implicit", "implicit"} <= {*methods}:
                figures["step_us"] = implicit_cost()
    if scene is not None:
        of_scene = figures["cases"]["scene"]
        found = own.choices(of_scene, rate)
        figures["choices"] = [asdict(choice) for choice in found]
        figures["advice"] = own.advice(found, error, rate, of_scene["floor"])
    figures = finite(figures)
    console = Console()
    for table in page.tables(figures):
        console.print(table)
    for sentence in page.sentences(figures):
        console.print(sentence, markup=False, highlight=False)
    if file is not None:
        write_json(file, figures)
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        write_points(figures, out / "error.csv")
        console.print(f"report: {page.write(figures, out)}", markup=False)


def implicit_cost() -> dict[str, float]:
    """us of a step of `semi_implicit` and of `implicit` in a compiled loop: three fingers grip a cube on a floor."""
    loops = []
    for name in ("semi_implicit", "implicit"):
        scene = cast(_grip.scene(METHODS[name](dt=_grip.DT)), jnp.float64)
        loops.append(compiled(scene, _grip.grip(1, 0.0)[0], None)[0])
    return dict(zip(("semi_implicit", "implicit"), step_us(loops), strict=True))


def _check(fingers: int, cases, integrators, error: float, rate: float) -> None:
    check_names("cases", cases or list(CASES), list(CASES))
    check_names("integrators", integrators or list(METHODS), list(METHODS))
    if not 1 <= fingers <= 100:
        raise InputError(f"fingers is {fingers}; allowed: 1 to 100")
    if not 0 < error < np.inf:
        raise InputError(f"error is {error:g} m; allowed: above 0 and finite")
    if not 10 <= rate <= 1e5:
        raise InputError(f"rate is {rate:g} Hz; allowed: 10 to 100000")


def write_points(figures: dict[str, Any], path: Path) -> None:
    """Every run as a row."""
    with replacing(path) as stream:
        rows = csv.writer(stream, lineterminator="\n")
        rows.writerow(
            ["case", "curve", "dt_s", "run_s_per_s", "error", "law_error", "gradient_error_relative", "unit"]
        )
        for name, case in figures["cases"].items():
            for curve, data in case["curves"].items():
                for p in data["points"]:
                    cells = (p["dt"], p["run"], p["error"], p["law_error"], p["gradient_error"])
                    rows.writerow(
                        [name, curve, *("" if c is None else f"{c:.6g}" for c in cells), case["unit"]]
                    )


def _missing() -> str | None:
    """Why MuJoCo does not run, if it does not."""
    try:
        _mujoco.need("mujoco", "bench")
    except InputError as error:
        return str(error)
    return None


def _case(case: Case, integrators, sweep: Sweep, missing: str | None, advance: Advance) -> dict[str, Any]:
    advance(f"{case.name}: truth", 0.0)
    if case.truth is None:
        truth, floor = _sweep.extrapolated(case, sweep)
    else:
        truth, floor = case.truth(), SOLVED if "DOP853" in case.known else ROUNDING
    law = truth if case.law is None else case.law()
    curves: dict[str, Any] = {}
    ours: dict[str, list[Point]] = {}
    theirs: dict[str, list[Point]] = {}
    for name in integrators:
        advance(f"{case.name}: {name}", 0.0)
        if case.ticks is None:
            points, compile_s = _sweep.curve(case, name, truth, law, sweep)
        else:
            points, compile_s = _sweep.curve_of_substeps(case, name, truth, sweep)
        ours[name], order = points, case.order(name)
        # Of errors that scatter, and of which none are averaged, a slope says little.
        has_order = order.value is not None and (sweep.around > 0 or not case.scatters(name))
        curves[name] = {
            "compile_s": compile_s,
            **orders(points, case, name, floor, has_order),
            "theory": order.value,
            "gradient_theory": case.gradient_order(name),
            "reason": order.reason,
            "points": [asdict(p) for p in points],
        }
        advance(case.name, 1.0)
    runs = isinstance(case.mujoco, Mujoco) and missing is None
    for name in _mujoco.variants(case):
        if runs:
            advance(f"{case.name}: MuJoCo {name}", 0.0)
            counts = _sweep.steps_of(case.seconds, sweep.mujoco_dts)
            points = _mujoco.curve(case, name, counts, law, sweep)
            theirs[name] = points
            dts, errors = [p.dt for p in points], [p.law_error for p in points]
            curves[f"MuJoCo {name}"] = {
                "order": fitted_order(dts, errors, case.seconds, floor, case.gain),
                "points": [asdict(p) for p in points],
            }
        advance(case.name, 1.0)
    return {
        "title": case.title,
        "unit": case.unit,
        "seconds": case.seconds,
        "known": case.known,
        "floor": floor,
        "has_law": case.law is not None,
        "gradient": None if case.gradient is None else case.gradient.name,
        "mujoco": None if runs else (missing or case.mujoco),
        "curves": curves,
        "equal_time": equal_time(ours, theirs, ROUNDING),
    }


def orders(
    points: Sequence[Point], case: Case, name: str, floor: float, has_order: bool
) -> dict[str, float | None]:
    """The orders of an integrator; where theory has none, errors are rounding, or those of runs that blow up."""

    def fitted(errors: list[float | None], floor: float, scatters: bool) -> float | None:
        return fitted_order([p.dt for p in points], errors, case.seconds, floor, case.gain, scatters)

    return {
        "order": fitted([p.error for p in points], floor, case.scatters(name)) if has_order else None,
        "gradient_order": fitted([p.gradient_error for p in points], SOLVED, not case.smooth),
    }


def worst(case: dict[str, Any]) -> dict[str, Any] | None:
    """The run time at which hapjax is least ahead of MuJoCo, or farthest behind."""
    return max(case["equal_time"], key=lambda row: row["factor"], default=None)


def at(points: Sequence[dict[str, Any]], dt: float) -> dict[str, Any] | None:
    """The point nearest to a dt, within 20 %."""
    near = min(points, key=lambda p: abs(np.log(p["dt"] / dt)), default=None)
    return near if near is not None and abs(np.log(near["dt"] / dt)) < 0.2 else None
