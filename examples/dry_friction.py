"""Fit friction laws to half of the recordings of a banded friction damper, and predict the other half.

    python examples/dry_friction.py [--data FILE] [--plot PNG] [--json F]

The damper is driven to and fro at different strokes and speeds; force and place are recorded, the normal force is not.
So each law is that of a surface under a load of 1, on which its mu are forces in N (`hapjax.drag`). What the
laws do not have is put around them:

- `bias` and `skew`: a band brake holds more in the one direction than in the other. A law by itself has a
  force added, which makes its two limits differ; one behind backlash has its force scaled by 1 + skew in the one
  direction and 1 - skew in the other, too.
- `hardening`: the backlash. The band gives easily between its stops and stiffens as it nears them, so the
  law's spring is no straight one: its force f becomes F sinh(c f / F) / sinh(c), with F the sliding force.

Tests 0, 2, 4, ... are fitted, every so many samples of each so that all have as many; the error is that of all samples.
"""

import argparse
import sys
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from matplotlib.figure import Figure
from npz_arrays import arrays_of
from rich.console import Console
from rich.table import Table

import hapjax
from hapjax import InputError
from hapjax.files import write_json

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "dry_friction.npz"
SAMPLES = 448  # of each test in the fit: 64 a turn
SHOWN = 7  # the test in the plot, one of those held out
Numbers = dict[str, jax.Array]


@dataclass(frozen=True)
class Trial:
    """One recording: t (s), force (N), place (m)."""

    t: np.ndarray
    force: np.ndarray
    place: np.ndarray


@dataclass(frozen=True)
class Model:
    """A law: its numbers where the search starts, and the surface that they make.

    Numbers above 0 are searched by their logarithm, those in `SIGNED` as they are, in thousands of N or 1.
    """

    start: dict[str, float]
    surface: Callable[[Numbers], hapjax.Surface]


@dataclass(frozen=True)
class Found:
    """The numbers, and the RMS error over the RMS force of each test that was fitted and that was not."""

    numbers: dict[str, float]
    train: dict[str, float]
    test: dict[str, float]

    def mean(self, which: str) -> float:
        """The root of the mean square over `train` or `test`: each recording counts once, however long."""
        return float(np.sqrt(np.mean(np.square(list(getattr(self, which).values())))))


SIGNED = ("bias", "skew")
FORCE = {"stiffness": 2e6, "force": 15e3, "bias": -2.0}
CURVE = {"extra": 0.3, "velocity": 0.1, "viscous": 1000.0}
BACKLASH = {"hardening": 2.0, "skew": -0.1}


def coulomb(n: Numbers) -> hapjax.Surface:
    """One sliding force."""
    return hapjax.Surface(n["stiffness"], n["force"])


def dahl(n: Numbers) -> hapjax.Surface:
    """One sliding force, neared little by little."""
    return hapjax.Surface(n["stiffness"], n["force"], friction=hapjax.Dahl())


def stribeck(n: Numbers) -> hapjax.Surface:
    """`extra` is how much more it takes to break away, as a share of the sliding force."""
    law = hapjax.Stribeck(n["velocity"], n["viscous"])
    static = n["force"] * (1 + n["extra"])
    return hapjax.Surface(n["stiffness"], mu_static=static, mu_kinetic=n["force"], friction=law)


def lugre(n: Numbers) -> hapjax.Surface:
    """LuGre's six."""
    law = hapjax.LuGre(n["bristles"], n["viscous"], n["velocity"])
    static = n["force"] * (1 + n["extra"])
    return hapjax.Surface(n["stiffness"], mu_static=static, mu_kinetic=n["force"], friction=law)


MODELS = {
    "Coulomb": Model(FORCE, coulomb),
    "Stribeck": Model(FORCE | CURVE, stribeck),
    "Dahl": Model(FORCE, dahl),
    "LuGre": Model(FORCE | CURVE | {"bristles": 1000.0}, lugre),
    "Coulomb behind backlash": Model(FORCE | BACKLASH, coulomb),
    "Stribeck behind backlash": Model(FORCE | CURVE | BACKLASH, stribeck),
}


def read(path: Path) -> dict[str, Trial]:
    """The recordings of a file by name, in the order of their numbers."""
    arrays = arrays_of(path)
    tests = {}
    for name in sorted(arrays, key=lambda name: (len(name), name)):
        columns = arrays[name]
        if columns.dtype.kind != "f":
            raise InputError(f"{path}, {name}: expected real numbers, found others")
        if columns.ndim != 2 or columns.shape[1] != 4:
            raise InputError(
                f"{path}, {name}: shape {columns.shape}; expected (samples, 4) of t, force, place and velocity"
            )
        if len(columns) <= SAMPLES or not np.all(np.isfinite(columns)):
            raise InputError(f"{path}, {name}: expected more than {SAMPLES} finite samples")
        t, force, place, _ = columns.astype(float).T
        if np.any(np.diff(t) <= 0) or np.ptp(np.diff(t)) > 1e-3 * t[1]:
            raise InputError(f"{path}, {name}: expected times that rise by equal steps")
        tests[name] = Trial(t, force, place)
    if len(tests) < 2:
        raise InputError(f"{path}: {len(tests)} tests; expected at least 2, one to fit and one to predict")
    return tests


def numbers_of(model: Model, free: Numbers) -> Numbers:
    """The numbers from what is searched."""
    return {name: x if name in SIGNED else jnp.exp(x) for name, x in free.items()}


def predict(model: Model, free: Numbers, place: jax.Array, dt: jax.Array) -> jax.Array:
    """The force (T,) N at places (T,) m that are dt s apart."""
    n = numbers_of(model, free)
    way = jnp.stack([place, 0 * place, 0 * place], axis=-1)[:, None]
    force = -hapjax.drag(model.surface(n), way, jnp.ones(1), dt)[:, 0, 0]
    if "hardening" in n:
        bent = jnp.sinh(n["hardening"] * force / n["force"]) / jnp.sinh(n["hardening"])
        force = n["force"] * bent * (1 + n["skew"] * jnp.sign(force))
    return force + 1e3 * n["bias"]


def fit(model: Model, tests: list[Trial]) -> Numbers:
    """The searched numbers that explain the tests best, by Levenberg-Marquardt."""
    strides = [(len(test.t) - 1) // SAMPLES for test in tests]
    place = jnp.stack([test.place[::s][:SAMPLES] for test, s in zip(tests, strides, strict=True)])
    force = jnp.stack([test.force[::s][:SAMPLES] for test, s in zip(tests, strides, strict=True)])
    dt = jnp.asarray([s * test.t[1] for test, s in zip(tests, strides, strict=True)])
    size = jnp.sqrt(jnp.mean(force**2, axis=1, keepdims=True))

    def error(free, _):
        return (jax.vmap(lambda x, t: predict(model, free, x, t))(place, dt) - force) / size

    start = {name: jnp.asarray(x if name in SIGNED else np.log(x)) for name, x in model.start.items()}
    solver = optx.LevenbergMarquardt(rtol=1e-4, atol=1e-4)
    options = {"jac": "fwd"}
    return optx.least_squares(error, solver, start, options=options, max_steps=40, throw=False).value


def predicted(model: Model, free: Numbers, tests: list[Trial]) -> list[np.ndarray]:
    """The force at every sample of each test (N); the shorter ones rest at their ends meanwhile, to share a program."""
    longest = max(len(test.t) for test in tests)
    place = jnp.asarray([np.pad(test.place, (0, longest - len(test.t)), mode="edge") for test in tests])
    dt = jnp.asarray([test.t[1] - test.t[0] for test in tests])
    force = jax.jit(jax.vmap(lambda x, t: predict(model, free, x, t)))(place, dt)
    return [np.asarray(f)[: len(test.t)] for f, test in zip(force, tests, strict=True)]


def judge(model: Model, tests: dict[str, Trial]) -> tuple[Found, list[np.ndarray]]:
    """A law fitted to every other test, its errors on all, and its force in each."""
    free = fit(model, list(tests.values())[::2])
    forces = predicted(model, free, list(tests.values()))
    errors = {
        name: float(np.sqrt(np.mean((f - test.force) ** 2) / np.mean(test.force**2)))
        for (name, test), f in zip(tests.items(), forces, strict=True)
    }
    names = list(errors)
    found = {name: float(x) for name, x in numbers_of(model, free).items()}
    train, held_out = ({n: errors[n] for n in names[first::2]} for first in (0, 1))
    return Found(found, train, held_out), forces


def show(results: dict[str, Found]) -> None:
    """Print the table."""
    table = Table()
    table.add_column("law")
    for title in ("numbers", "fitted tests", "held-out tests"):
        table.add_column(title, justify="right", no_wrap=True)
    for name, found in results.items():
        means = (f"{found.mean(which):.3f}" for which in ("train", "test"))
        table.add_row(name, str(len(found.numbers)), *means)
    Console().print("RMS error over RMS force")
    Console().print(table)


def draw(test: Trial, name: str, forces: dict[str, np.ndarray], path: Path) -> None:
    """The force of one test over time, place and speed, as recorded and as each law predicts it."""
    figure = Figure(figsize=(14, 4.5), layout="constrained")
    axes = figure.subplots(1, 3, sharey=True)
    speed = np.gradient(test.place, test.t)
    half = slice(len(test.t) * 3 // 7, len(test.t) * 5 // 7)  # two turns of seven
    for ax, across, title in zip(
        axes, (test.t, 1e3 * test.place, 1e3 * speed), ("time, s", "place, mm", "speed, mm/s"), strict=True
    ):
        ax.plot(across[half], test.force[half] / 1e3, color="0.6", lw=2, label="recorded")
        for law, force in forces.items():
            ax.plot(across[half], force[half] / 1e3, lw=1, label=law)
        ax.set_xlabel(title)
        ax.grid(alpha=0.3)
    axes[0].set_ylabel("force, kN")
    axes[0].set_title(f"{name}, not fitted", fontsize=10)
    axes[1].legend(fontsize=8)
    try:
        figure.savefig(path, format="png", dpi=120)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error


def arguments(argv: list[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        description="Fit friction laws to half of the recordings of a friction damper; predict the others.",
        epilog="FILE is an NPZ of one array (samples, 4) a test: t (s), force (N), place (m), velocity (m/s). "
        "Exit code 2: bad input, said in one sentence.",
    )
    parser.add_argument("--data", metavar="FILE", type=Path, default=DATA, help="the recordings, NPZ")
    parser.add_argument("--plot", metavar="PNG", type=Path, help="plot one held-out test to this file")
    parser.add_argument("--json", metavar="F", type=Path, help="also write all figures to this file as JSON")
    return parser.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    """Run the command; its exit code."""
    given = arguments(argv)
    jax.config.update("jax_enable_x64", True)
    try:
        tests = read(given.data)
        results, forces = {}, {}
        shown = min(SHOWN, len(tests) - 1 - len(tests) % 2)
        for name, model in MODELS.items():
            results[name], felt = judge(model, tests)
            forces[name] = felt[shown]
        show(results)
        if given.plot is not None:
            name = list(tests)[shown]
            drawn = {law: forces[law] for law in ("Coulomb", "LuGre", "Stribeck behind backlash")}
            draw(tests[name], name, drawn, given.plot)
        if given.json is not None:
            write_json(given.json, {name: asdict(found) for name, found in results.items()})
    except InputError as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
