"""Fit a board's Coulomb friction from pushes of an object that stands on it on small feet.

    python examples/planar_push.py FILE... [--arm] [--json F] [--stiffness K]

A point tool pushes the object slowly; its place and the force at its tip are recorded throughout, the
object's pose only before and after each push. The feet are contacts on a plane under known loads
(`hapjax.drag`), carried along the object's motion. The total wrench of their friction is compared with that
of the push. With `--arm` how far out the feet stand is fitted as well, by a factor on their layout: what the pushes
tell of the torsional arm, the sum of load times distance from the centre of mass, over the weight.

What is assumed, and docs/planar_push.md weighs:

- The motion is quasi-static, and the feet's loads stay as they are at rest.
- The tool touches the object from the first sample of at least half the push's typical force to the last one,
  and goes straight at constant speed.
- Between the two poses the object turns in proportion to the tool's travel, and the tool's point on the
  object runs straight from where it met the object to where it left it.
- The feet do not give: the god-objects' tangential stiffness is so high that they break away within microns.
"""

import argparse
import json
import math
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from pushes import Pushes, load
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from scipy.stats import t as student

import hapjax
from hapjax import InputError
from hapjax.files import replacing
from hapjax_fitting.solve import jacobian, solve
from hapjax_fitting.transform import Log

# mu, and the factor on how far out the feet stand.
STARTS = ((0.05, 1.0), (0.2, 0.5), (0.8, 2.0))


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


def unbalanced(free, pushes: Pushes) -> jax.Array:
    """The wrench of push and friction together (P, S, 3) N; a push counts once, however many spans it has.

    `free`: the logarithms of mu and, if it has two numbers, of the factor on how far out the feet stand.
    """
    board = hapjax.Surface(pushes.stiffness, mu=Log().value(free[0]))
    arms = pushes.arms if len(free) == 1 else Log().value(free[1]) * pushes.arms
    feet = pushes.feet - pushes.arms + arms
    force = jax.vmap(lambda feet: hapjax.drag(board, feet, pushes.loads))(feet)
    moment = jnp.sum(jnp.cross(arms, force)[..., 2], axis=-1) / pushes.gyration
    friction = jnp.concatenate([jnp.sum(force, axis=2)[..., :2], moment[..., None]], axis=-1)
    return (pushes.wrench + friction) / math.sqrt(force.shape[1])


def whitened(free, args) -> jax.Array:
    """What the solver makes small: all unbalanced wrenches over their noise, in one row."""
    files, variances = args
    both = zip(files, variances, strict=True)
    return jnp.concatenate([(unbalanced(free, f) * jax.lax.rsqrt(v)[None, None]).ravel() for f, v in both])


@eqx.filter_jit
def sums(free, pushes: Pushes) -> tuple[jax.Array, jax.Array, jax.Array]:
    """For each push and channel (P, 3), over its time: residual^2, slopes * residual (p,), slopes * slopes (p, p)."""
    slope, r = jacobian(unbalanced, free, pushes)
    return (
        jnp.sum(r * r, axis=1),
        jnp.einsum("psci,psc->pci", slope, r),
        jnp.einsum("psci,pscj->pcij", slope, slope),
    )


def variance(mean_square: np.ndarray) -> np.ndarray:
    """The noise (N^2) of fx and fy, which is one, and of the moment; no force sensor is better than 1 uN."""
    force = mean_square[..., :2].mean(axis=-1)
    return np.maximum(np.stack([force, force, mean_square[..., 2]], axis=-1), 1e-12)


def fit(files: tuple[Pushes, ...], name: str, with_arm: bool = False) -> Fit:
    """mu of the board under all the files, the noise of each file estimated from what remains."""
    starts, places = jnp.log(jnp.asarray(STARTS))[:, : 1 + with_arm], jnp.arange(len(STARTS))
    variances = tuple(jnp.ones(3) for _ in files)
    before = np.full(1 + with_arm, np.inf)
    for _ in range(50):
        problem = (files, variances)
        ended = solve(whitened, starts, places, problem, rtol=1e-10, atol=1e-10, max_steps=100)
        best = int(jnp.argmin(ended.loss))
        free = ended.free[best]
        per_push = [[np.asarray(x) for x in sums(free, f)] for f in files]
        variances = tuple(jnp.asarray(variance(square.mean(axis=0))) for square, _, _ in per_push)
        if np.abs(np.asarray(free) - before).max() < 1e-7:
            break
        before = np.asarray(free)
    else:
        raise InputError(f"{name}: mu and the noise do not settle; the forces do not fit one mu")
    left_out = np.concatenate([_without_one(i, per_push) for i in range(len(files))])
    count = len(left_out)
    errors = np.sqrt((count - 1) / count * np.sum((left_out - left_out.mean(axis=0)) ** 2, axis=0))
    if not np.all(errors < Log.widest):
        raise InputError(f"{name}: the pushes do not determine mu; expected forces that oppose friction")
    at_best = int(jnp.sum(jnp.all(jnp.abs(ended.free - free[None]) < 1e-4, axis=1)))
    mu, *factor = (_estimate(math.exp(float(x)), error, count) for x, error in zip(free, errors, strict=True))
    arm = _scaled(factor[0], torsional_arm(files)) if factor else None
    return Fit(**asdict(mu), pushes=count, starts=len(STARTS), starts_at_best=at_best, arm=arm)


def torsional_arm(files: tuple[Pushes, ...]) -> float:
    """Load times distance from the centre of mass, over the weight (m), of the feet where they are; a push counts once."""
    arms = [float(f.loads @ jnp.linalg.norm(f.arms[0, 0], axis=-1) / jnp.sum(f.loads)) for f in files]
    return float(np.average(arms, weights=[len(f.arms) for f in files]))


def _estimate(value: float, error: float, count: int) -> Estimate:
    """Of the error of the logarithm, by Student's t of the pushes."""
    wide = student.ppf(0.975, count - 1) * error
    return Estimate(value, value * float(error), (value * math.exp(-wide), value * math.exp(wide)))


def _scaled(factor: Estimate, size: float) -> Estimate:
    low, high = factor.interval95
    return Estimate(size * factor.estimate, size * factor.standard_error, (size * low, size * high))


def _without_one(i: int, per_push: list[list[np.ndarray]]) -> np.ndarray:
    """How far the logarithms move when each push of file i is left out: the jackknife, by one Gauss-Newton step.

    Pushes are independent of each other; the samples of one push are not, so only whole pushes are left out.
    """
    others = [_pull([x.sum(axis=0) for x in s], len(s[0])) for j, s in enumerate(per_push) if j != i]
    pull, weight = _pull([x.sum(axis=0) - x for x in per_push[i]], len(per_push[i][0]) - 1)
    pull, weight = pull + sum(p for p, _ in others), weight + sum(w for _, w in others)
    weight = weight + np.finfo(float).tiny * np.eye(weight.shape[-1])
    return -np.linalg.solve(weight, pull[..., None])[..., 0]


def _pull(totals: list[np.ndarray], count: int) -> tuple[np.ndarray, np.ndarray]:
    """The gradient and curvature of the whitened loss in the logarithms, from the sums over `count` pushes."""
    square, slope_residual, slope_square = totals
    noise = variance(square / count)
    return (
        np.sum(slope_residual / noise[..., None], axis=-2),
        np.sum(slope_square / noise[..., None, None], axis=-3),
    )


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
        pushes, skipped = load(path, stiffness)
        files.append(pushes)
        for line in skipped:
            print(line, file=sys.stderr)
    fits = {name: fit((f,), name, with_arm) for name, f in zip(names, files, strict=True)}
    return fits, fit(tuple(files), "all files", with_arm) if len(files) > 1 else fits[names[0]]


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
        default=1e5,
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
            with replacing(given.json) as file:
                json.dump(figures, file, indent=2, allow_nan=False)
                file.write("\n")
    except InputError as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
