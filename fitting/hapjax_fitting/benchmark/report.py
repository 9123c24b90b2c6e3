"""The measurements of the fit, as tables and files."""

import csv
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from rich.box import SIMPLE
from rich.console import Console
from rich.table import Table

from hapjax import InputError, Scene
from hapjax.files import check_makeable, replacing, write_json
from hapjax.progress import following

from ..parameters import free_parameters
from . import beside_mujoco, efficiency, speed, starts
from .cases import CASES

DRAWS = {
    "mu, stiffness": 1000,
    "static, kinetic, viscous": 1000,
    "critical area": 200,
    "mass, centre, inertia": 200,
}
FROM_AFAR = dict.fromkeys(DRAWS, 100)
_QUICK = 50  # times fewer recordings
_MINUTE, _GRASP = 60.0, 20.0  # s


def report(scene: Scene | None, quick: bool, out: Path | None, file: Path | None) -> None:
    """Measure, print the tables, and write the figures as JSON and all estimates as CSV where these are given."""
    if scene is not None:
        raise InputError("--scene is given; allowed: none, for the fit is measured on scenes of its own")
    if out is not None:
        check_makeable(out)
    console, shorter = Console(), _QUICK if quick else 1
    figures: dict[str, Any] = {"cores": os.cpu_count(), "quick": quick, "efficiency": []}
    with jax.enable_x64(True):
        draws = {name: count // shorter for name, count in DRAWS.items()}
        with following(float(sum(draws.values())), apart=True) as advance:
            for name, count in draws.items():
                row, estimates = efficiency.measure(name, count, advance=advance)
                figures["efficiency"].append(row)
                if out is not None:
                    _write(out, name, estimates)
        console.print(efficiency_table(figures["efficiency"]))
        fits = {name: -(-count // shorter) for name, count in FROM_AFAR.items()}
        with following(float(sum(fits.values())), apart=True) as advance:
            figures["starts"] = [starts.from_afar(*each, advance=advance) for each in fits.items()]
        console.print(starts_table(figures["starts"]))
        figures["beside_mujoco"] = beside(max(1, beside_mujoco.RECORDINGS // shorter))
        console.print(beside_table(figures["beside_mujoco"]), markup=False)
        figures |= times(_MINUTE / shorter, _GRASP / shorter, speed.COUNTS[:2] if quick else speed.COUNTS)
    for table in (speed_table(figures), numbers_table(figures["recordings"])):
        console.print(table)
    figures["load"] = os.getloadavg()
    if file is not None:
        write_json(file, figures)


def _write(folder: Path, name: str, estimates: np.ndarray) -> None:
    """All estimates of a case, a line each."""
    case = CASES[name]
    names = [p.name for p in free_parameters(case.truth(), case.free)]
    folder.mkdir(parents=True, exist_ok=True)
    with replacing(folder / f"{name.replace(', ', '_').replace(' ', '_')}.csv") as file:
        lines = csv.writer(file, lineterminator="\n")
        lines.writerow(["recording", "parameter", "estimate", "low95", "high95"])
        for i, of_one in enumerate(estimates.tolist()):
            lines.writerows([i, key, *row] for key, row in zip(names, of_one, strict=True))


def efficiency_table(rows: Sequence[dict[str, Any]]) -> Table:
    """Errors beside the least possible ones."""
    table = Table(
        "parameter", "fits", "rms error", "of least", "95 % hold", "least", title="estimates", box=SIMPLE
    )
    for row in rows:
        for p in row["parameters"]:
            fits = (
                str(row["draws"]) if p["identified"] == row["draws"] else f"{p['identified']}/{row['draws']}"
            )
            part = p["name"].split(".", 2)[-1]
            hold = f"{100 * p['cover']:.1f} %"
            table.add_row(part, fits, f"{p['rmse']:.3g}", f"{p['ratio']:.3f}", hold, p["held_against"])
        table.add_section()
    return table


def starts_table(rows: Sequence[dict[str, Any]]) -> Table:
    """Where fits end that begin far away."""
    title = f"starts a factor {starts.FACTOR:g} off in every number"
    table = Table(
        "numbers", "fits", "end at the best", "else say so", "else hide it", title=title, box=SIMPLE
    )
    for row in rows:
        table.add_row(*(str(row[key]) for key in ("case", "fits", "at_best", "said", "hidden")))
    return table


def beside(recordings: int) -> dict[str, Any]:
    """The figures beside `mujoco.sysid`, or what is `missing` for them."""
    try:
        with following(float(recordings), apart=True) as advance:
            return beside_mujoco.measure(recordings, advance)
    except InputError as error:
        return {"missing": str(error)}


def times(minute: float, grasp: float, counts: tuple[int, ...]) -> dict[str, Any]:
    """How long fits take: of so many seconds of stroking and of a grasp, and of so many recordings."""
    with following(3.0, apart=True) as advance:
        figures: dict[str, Any] = {"minute": speed.minute(minute)}
        advance("times of a minute", 1.0)
        figures["grasp"] = speed.grasp(grasp)
        advance("times of a grasp", 1.0)
        figures["recordings"] = speed.numbers(counts)
        advance("times of many", 1.0)
    return figures


def beside_table(figures: dict[str, Any]) -> Table | str:
    """The fit beside `mujoco.sysid`, or why there is none."""
    if "missing" in figures:
        return f"Not beside mujoco.sysid: {figures['missing']}"
    count = figures["recordings"]
    table = Table(
        "", *figures["programs"], title=f"mu and mass of a pushed block, {count} recordings", box=SIMPLE
    )
    for said, key, form in (
        ("rms error of mu and mass, over the least", "error", "{:.2f}"),
        ("width of 95 % intervals, over the least", "width", "{:.2f}"),
        ("95 % intervals that hold", "hold", "{:.0%}"),
    ):
        table.add_row(
            said, *(", ".join(form.format(x) for x in p[key]) for p in figures["programs"].values())
        )
    arrived = (f"{p['arrived']} of {count}" for p in figures["programs"].values())
    table.add_row("starts up to a factor 10 off that end at the truth", *arrived)
    for said, key in (("s from there, median", "warm_s"), ("s of the first fit", "first_s")):
        table.add_row(said, *(f"{p[key]:.2f}" for p in figures["programs"].values()))
    return table


def speed_table(figures: dict[str, Any]) -> Table:
    """Times of fits."""
    minute, grasp = figures["minute"], figures["grasp"]
    table = Table(
        "what", "s", title=f"times of fits, compiled before, on {figures['cores']} cores", box=SIMPLE
    )
    length = f"mu and stiffness, {minute['seconds']:.3g} s at 1 kHz"
    table.add_row(f"{length}, {minute['starts']} starts", f"{minute['fit_s']:.3f}")
    table.add_row(f"{length}, one start", f"{minute['one_start_s']:.3f}")
    table.add_row(f"{length}, by hand, one start", f"{minute['by_hand_s']:.3f}")
    table.add_row("  of which one start here takes a part", f"1 / {minute['ratio']:.1f}")
    table.add_row(f"mass and inertia, {grasp['seconds']:.3g} s of grasp", f"{grasp['fit_s']:.3f}")
    return table


def numbers_table(figures: dict[str, Any]) -> Table:
    """Time against the number of recordings."""
    table = Table("recordings", "s", title=f"time grows with the power {figures['exponent']:.2f}", box=SIMPLE)
    for count, taken in zip(figures["recordings"], figures["fit_s"], strict=True):
        table.add_row(str(count), f"{taken:.3f}")
    return table
