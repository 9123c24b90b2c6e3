"""Error against run time: work-precision diagrams of every integrator, beside MuJoCo's, on cases with a known truth."""

import csv
import json
import os
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import jax
import numpy as np
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from ..errors import InputError
from ..files import replacing
from ..integrate import METHODS
from . import _mujoco, _sweep
from ._order import equal_time, fitted_order
from ._sweep import FULL, QUICK, Point, Sweep
from .cases import CASES, Case, Mujoco

ROUNDING = 1e-12  # in the case's unit: nothing below is told apart from 0
SOLVED = 1e-11  # to what an independent program knows its truth


def chosen(kind: str, names: Sequence[str] | None, known: Sequence[str]) -> list[str]:
    """The names, or all. **Raises:** `InputError` for one that is not known."""
    for name in names or ():
        if name not in known:
            raise InputError(f"--{kind} has {name!r}; allowed: {', '.join(known)}")
    return list(known) if names is None else [name for name in known if name in names]


def measure(
    cases: Sequence[str], integrators: Sequence[str], quick: bool, console: Console
) -> dict[str, Any]:
    """All figures, as they are written: by case, the points of each curve, its order, and who is ahead at equal time."""
    sweep = QUICK if quick else FULL
    missing = _missing()
    with _progress(console) as progress:
        task = progress.add_task("", total=len(cases) * (len(integrators) + len(_mujoco.INTEGRATORS)))
        found = {}
        for name in cases:

            def told(integrator, name=name):
                progress.update(task, description=f"{name}: {integrator}")

            found[name] = _case(
                CASES[name], integrators, sweep, missing, told, lambda: progress.advance(task)
            )
    return {
        "device": str(jax.devices()[0]),
        "dtype": "float64",
        "xla_flags": os.environ.get("XLA_FLAGS", ""),
        "mujoco": missing or _mujoco.need("mujoco", "bench").__version__,
        "cases": found,
    }


def report(
    cases: Sequence[str] | None, integrators: Sequence[str] | None, quick: bool, out: Path, file: Path | None
) -> None:
    """Measure, print the tables, and write CSV, pictures and the page to the folder `out`."""
    from . import _error_page as page

    console = Console()
    names, methods = chosen("cases", cases, list(CASES)), chosen("integrators", integrators, list(METHODS))
    make_folder(out)
    figures = measure(names, methods, quick, console)
    for table in page.tables(figures):
        console.print(table)
    for sentence in page.sentences(figures):
        console.print(sentence, markup=False, highlight=False)
    write_points(figures, out / "error.csv")
    written = page.write(figures, out)
    if file is not None:
        with replacing(file) as stream:
            json.dump(figures, stream, indent=2)
            stream.write("\n")
    console.print(f"report: {written}", markup=False)


def make_folder(out: Path) -> None:
    """**Raises:** `InputError` where there can be no such folder."""
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{out}: cannot be made ({error.strerror}); allowed: a folder for the results"
        ) from None


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


def _progress(console: Console) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TimeRemainingColumn(),
        console=console,
        transient=True,
    )


def _case(case: Case, integrators, sweep: Sweep, missing: str | None, told, done) -> dict[str, Any]:
    if case.truth is None:
        told("truth")
        truth, floor = _sweep.extrapolated(case, sweep)
    else:
        truth, floor = case.truth(), SOLVED if "DOP853" in case.known else ROUNDING
    law = truth if case.law is None else case.law()
    curves: dict[str, Any] = {}
    ours: dict[str, list[Point]] = {}
    theirs: dict[str, list[Point]] = {}
    for name in integrators:
        told(name)
        points, compile_s = _sweep.curve(case, name, truth, law, sweep)
        ours[name], order = points, case.order(name)
        curves[name] = {
            "compile_s": compile_s,
            **_fit(points, case.seconds, floor),
            "theory": order.value,
            "reason": order.reason,
            "points": [asdict(p) for p in points],
        }
        done()
    runs = isinstance(case.mujoco, Mujoco) and missing is None
    for name in _mujoco.INTEGRATORS:
        if runs:
            told(f"MuJoCo {name}")
            counts = _sweep.steps_of(case.seconds, sweep.mujoco_dts)
            points = _mujoco.curve(case, name, counts, law, sweep)
            theirs[name] = points
            dts, errors = [p.dt for p in points], [p.law_error for p in points]
            curves[f"MuJoCo {name}"] = {
                "order": fitted_order(dts, errors, case.seconds, floor),
                "points": [asdict(p) for p in points],
            }
        done()
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


def _fit(points: Sequence[Point], seconds: float, floor: float) -> dict[str, float | None]:
    dts = [p.dt for p in points]
    return {
        "order": fitted_order(dts, [p.error for p in points], seconds, floor),
        "gradient_order": fitted_order(dts, [p.gradient_error for p in points], seconds, SOLVED),
    }


def worst(case: dict[str, Any]) -> dict[str, Any] | None:
    """The run time at which hapjax is least ahead of MuJoCo, or farthest behind."""
    return max(case["equal_time"], key=lambda row: row["factor"], default=None)


def at(points: Sequence[dict[str, Any]], dt: float) -> dict[str, Any] | None:
    """The point nearest to a dt, within 20 %."""
    near = min(points, key=lambda p: abs(np.log(p["dt"] / dt)), default=None)
    return near if near is not None and abs(np.log(near["dt"] / dt)) < 0.2 else None
