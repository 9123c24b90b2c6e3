"""Fit a board's Coulomb friction from pushes of an object that stands on it on small feet.

    python examples/planar_push.py FILE... [--arm] [--json F] [--stiffness K]

A point tool pushes the object slowly; its place and the force at its tip are recorded throughout, the
object's pose only before and after each push. The feet are contacts on a plane under known loads
carried along the object's motion, and the total wrench of their friction is compared with that of the push
(`hapjax_fitting.fit_drags`). With `--arm` how far out the feet stand is fitted as well, by a factor on their
layout: what the pushes tell of the torsional arm, the sum of load times distance from the centre of mass, over the
weight.

What is assumed, and docs/planar_push.md weighs:

- The motion is quasi-static, and the feet's loads stay as they are at rest.
- The tool touches the object from the first sample of at least half the push's typical force to the last one,
  and goes straight at constant speed.
- Between the two poses the object turns in proportion to the tool's travel, and the tool's point on the
  object runs straight from where it met the object to where it left it.
- The feet do not give: the god-objects' tangential stiffness is so high that they break away within microns.
"""

import argparse
import math
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from pushes import load
from rich.console import Console
from rich.markup import escape
from rich.table import Table

import hapjax
import hapjax_fitting
from hapjax import InputError
from hapjax.files import write_json
from hapjax_fitting import Drags, fit_drags

STIFFNESS = 1e5


@dataclass(frozen=True)
class Estimate:
    """A number above 0, its standard error and 95 % interval."""

    estimate: float
    standard_error: float
    interval95: tuple[float, float]


@dataclass(frozen=True)
class Fit(Estimate):
    """mu; how many pushes; how many of the starts ended at the best; the torsional arm (m), where it was fitted."""

    pushes: int
    starts: int
    starts_at_best: int
    arm: Estimate | None


def fit(files: tuple[Drags, ...], name: str, stiffness: float = STIFFNESS, with_arm: bool = False) -> Fit:
    """mu of the board under all the files, and with `with_arm` the torsional arm."""
    board = hapjax.Surface(stiffness, mu=0.2)
    free = ("surface.mu", "arms") if with_arm else ("surface.mu",)
    found = fit_drags(board, files, free, name=name)
    mu, *factor = (_estimate(found.parameters[path], 1.0) for path in free)
    arm = _estimate(found.parameters["arms"], torsional_arm(files)) if factor else None
    return Fit(
        **asdict(mu), pushes=found.drags, starts=found.starts, starts_at_best=found.starts_at_best, arm=arm
    )


def torsional_arm(drags: tuple[Drags, ...]) -> float:
    """Load times distance from the centre of mass, over the weight (m), of the feet where they are; a push counts once."""
    arms = [float(d.loads @ jnp.linalg.norm(d.arms[0, 0], axis=-1) / jnp.sum(d.loads)) for d in drags]
    return float(np.average(arms, weights=[len(d.arms) for d in drags]))


def _estimate(of: hapjax_fitting.Estimate, size: float) -> Estimate:
    """In the unit of `size`, of which the estimate is a factor."""
    assert of.estimate is not None and of.standard_error is not None
    low, high = of.interval95
    assert low is not None and high is not None
    return Estimate(size * of.estimate, size * of.standard_error, (size * low, size * high))


def show(fits: dict[str, Fit]) -> None:
    """Print a table, one line a fit, and one of the arms where they were fitted."""
    table = _table("mu", "95 % interval", "pushes", "starts at best")
    for name, f in fits.items():
        low, high = f.interval95
        starts = f"{f.starts_at_best} of {f.starts}"
        table.add_row(escape(name), f"{f.estimate:.4f}", f"{low:.4f} to {high:.4f}", str(f.pushes), starts)
    Console().print(table)
    arms = {name: f.arm for name, f in fits.items() if f.arm is not None}
    table = _table("torsional arm, mm", "95 % interval")
    for name, arm in arms.items():
        low, high = (1e3 * x for x in arm.interval95)
        table.add_row(escape(name), f"{1e3 * arm.estimate:.1f}", f"{low:.1f} to {high:.1f}")
    if arms:
        Console().print(table)


def _table(*titles: str) -> Table:
    table = Table()
    table.add_column("file", overflow="fold")
    for title in titles:
        table.add_column(title, justify="right", no_wrap=True)
    return table


def fit_all(paths: list[Path], stiffness: float, with_arm: bool) -> tuple[dict[str, Fit], Fit]:
    """The fit of each file by its name, and of all together."""
    if len({path.resolve() for path in paths}) < len(paths):
        raise InputError("a file is given twice; its pushes would count twice")
    names = [path.name for path in paths]
    if len(set(names)) < len(names):
        names = [str(path) for path in paths]
    files = []
    for path in paths:
        pushes, skipped = load(path)
        files.append(pushes)
        for line in skipped:
            print(line, file=sys.stderr)
    fits = {name: fit((f,), name, stiffness, with_arm) for name, f in zip(names, files, strict=True)}
    return fits, fit(tuple(files), "all files", stiffness, with_arm) if len(files) > 1 else fits[names[0]]


def arguments(argv: list[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        description="Fit a board's Coulomb friction mu from pushes of an object on small feet.",
        epilog="A FILE is an NPZ of t (s), tip (m), force (N), offset, com_before and com_after (m, m, rad), "
        "support_points (m) and support_load (N). Exit code 2: bad input, said in one sentence.",
    )
    parser.add_argument(
        "files", metavar="FILE", nargs="+", type=Path, help="recorded pushes, NPZ in SI units"
    )
    parser.add_argument(
        "--arm", action="store_true", help="fit the torsional arm too: how far out the feet stand"
    )
    parser.add_argument("--json", metavar="F", type=Path, help="also write the figures to this file as JSON")
    parser.add_argument(
        "--stiffness",
        metavar="K",
        type=float,
        default=STIFFNESS,
        help="tangential stiffness of each foot, N/m, above 0 (default %(default)g: practically rigid)",
    )
    return parser.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    """Run the command; its exit code."""
    given = arguments(argv)
    jax.config.update("jax_enable_x64", True)  # a foot breaks away after 14 um, 1e-5 of where it is
    try:
        if not (math.isfinite(given.stiffness) and given.stiffness > 0):
            raise InputError(f"--stiffness is {given.stiffness:g}; allowed: above 0 N/m")
        fits, together = fit_all(given.files, given.stiffness, given.arm)
        show(fits | {"all files together": together} if len(fits) > 1 else fits)
        if given.json is not None:
            figures = {"files": {name: asdict(f) for name, f in fits.items()}, "all": asdict(together)}
            write_json(given.json, figures)
    except InputError as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
