"""Fit friction, inertia and loss of a real cube from tracked tosses, by multiple shooting.

    python examples/cube_toss.py FILE [--tosses N] [--plot PNG] [--json F]

A toss is a row of hard impacts; a small error before the first is a large one after the last. So of each toss a short window
about an impact is cut, all of the same length, and each window is a recording with a first state of its own
(`start.cube...`), which is fitted together with what all share: friction and loss of the contact, inertia and centre of mass
of the cube, the box that stands for it (its edges are rounded), height and tilt of the floor. Every fifth toss is held out.
There the model predicts what each touch does to the cube, one sample ahead and more, with the fitted numbers and with the
published ones.

docs/cube_toss.md says what is assumed, and what comes out.
"""

import argparse
import sys
from dataclasses import asdict
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure
from rich.console import Console
from rich.markup import escape
from rich.table import Column, Table
from scipy.optimize import root_scalar
from tosses import Toss, read

import hapjax
from hapjax import rotation
from hapjax.files import replacing, write_json
from hapjax_fitting import FitResult, Start, fit
from hapjax_fitting.start import begun

STIFFNESS = 1e5  # N/m of each corner: an impact is over within one sample, as in the recordings
SUBSTEPS = 16  # of a sample
GRAVITY = 9.67  # m/s^2, of the recorded free flight; air and the tracker's scale take their part
# Samples of a window before the cube first sinks into the floor, and of the whole window.
BEFORE, LENGTH = 4, 10
NOISE = {"position": 2e-4, "angle": 6e-3}  # m, rad: what such a model leaves, not what the tracker adds
HELD_OUT = 5  # every so many tosses
AHEAD = 6  # samples that are predicted over each touch
PUBLISHED_MU, PUBLISHED_INERTIA, PUBLISHED_RESTITUTION = 0.18, 8.1e-4, 0.125
IMPACT = 1.1  # m/s, of a corner at the typical first impact: there the restitution is taken
AWAY = np.full((1, 3), 9.0)  # m, of the finger that every scene has

SHARED = ["contact.floor.mu", "contact.floor.damping", "object.cube.body.inertia", "object.cube.body.centre"]
SHARED += ["object.cube.size", "object.floor.position[2]", "object.floor.orientation[1]"]
SHARED += ["object.floor.orientation[2]"]
OWN = [f"start.cube.{part}" for part in ("position", "rotation", "velocity", "spin")]


def scene(toss: Toss, mu: float, damping: float, inertia: float, size: float | None = None) -> hapjax.Scene:
    """A cube and the floor that it falls on; `size` (m) of the box that stands for it, its own if not given."""
    box = hapjax.Box((toss.side if size is None else size,) * 3)
    cube = hapjax.Object(box, None, hapjax.Body(toss.mass, (inertia,) * 3, (0.0, 0.0, 0.0)))
    lift = 0.0 if size is None else (toss.side - size) / 2
    return hapjax.Scene(
        {"cube": cube, "floor": hapjax.Object(hapjax.Plane(), position=(0.0, 0.0, lift))},
        {"floor": hapjax.Contact(STIFFNESS, mu=mu, damping=damping, between=("cube", "floor"))},
        world=hapjax.World(gravity=(0.0, 0.0, -GRAVITY)),
        integrator=hapjax.SemiImplicit(dt=1 / toss.rate, substeps=SUBSTEPS),
    )


def windows(tosses: list[Toss]) -> list[hapjax.Recording]:
    """Of each toss a window about its first impact."""
    found = []
    for toss in tosses:
        begin, t = max(toss.first_impact() - BEFORE, 0), np.arange(LENGTH) / toss.rate
        pose = np.concatenate([toss.position, toss.orientation], axis=1)[begin : begin + LENGTH, None]
        if len(pose) == LENGTH:
            found.append(hapjax.Recording(hip=np.tile(AWAY, (LENGTH, 1, 1)), hip_t=t, pose=pose, pose_t=t))
    return found


def identify(tosses: list[Toss]) -> FitResult:
    """The fit of all windows together. It begins at a box with its edges taken off, and at no published number."""
    cut = windows(tosses)
    if not cut:
        raise hapjax.InputError(
            "no toss touches the floor; allowed: a corner below z = 0 m, and samples after it"
        )
    first = scene(tosses[0], mu=0.3, damping=2.0, inertia=1e-3, size=tosses[0].side - 0.01)
    return fit(first, cut, SHARED + OWN, each=OWN, noise=NOISE, starts=1, max_steps=30)


def published(toss: Toss, like: hapjax.Scene | None = None) -> hapjax.Scene:
    """The scene of the published numbers; with the box, centre and floor of another one, if given."""
    found = scene(toss, PUBLISHED_MU, damping_of(PUBLISHED_RESTITUTION, IMPACT), PUBLISHED_INERTIA)
    if like is None:
        return found
    cube, centre = like.object["cube"], like.object["cube"].body.centre  # pyright: ignore
    body = hapjax.Body(found.object["cube"].body.mass, found.object["cube"].body.inertia, centre)  # pyright: ignore
    objects = {"cube": hapjax.Object(cube.shape, None, body), "floor": like.object["floor"]}
    return hapjax.Scene(objects, found.contact, world=found.world, integrator=found.integrator)


def damping_of(restitution: float, speed: float) -> float:
    """The Hunt-Crossley damping c (s/m) of an impact at `speed` (m/s) with this restitution, 0.05 to 0.99.

    With f = k d (1 + c d') and m v dv = -f dd, a mass that comes with v and leaves with v' has c (v + v') =
    log((1 + c v) / (1 - c v')).
    """
    after = restitution * speed
    return root_scalar(_unbalanced, (speed, after), bracket=(1e-3 / after, (1 - 1e-9) / after)).root


def restitution_of(damping: float, speed: float) -> float:
    """The inverse of `damping_of`."""

    def off(after):
        return _unbalanced(damping, speed, after)

    return root_scalar(off, bracket=(0.0, min(speed, (1 - 1e-12) / damping))).root / speed


def _unbalanced(damping: float, speed: float, after: float) -> float:
    return damping * (speed + after) - np.log1p(damping * speed) + np.log1p(-damping * after)


def errors(model: hapjax.Scene, tosses: list[Toss]) -> np.ndarray:
    """How far the cube's corners are from where the model has them, root mean square (m), 1 to AHEAD samples after the last
    sample before each touch: (touches, AHEAD)."""
    before, after = (
        jax.tree.map(lambda *x: jnp.concatenate(x), *each)
        for each in zip(*(toss.touches(AHEAD, GRAVITY) for toss in tosses), strict=True)
    )
    place, turn = (np.asarray(x) for x in _off(model, before, after))
    # A small turn by a moves eight corners by a root mean square of a side / sqrt(2).
    return np.hypot(place, turn * tosses[0].side / np.sqrt(2))


@jax.jit
def _off(model: hapjax.Scene, before: tuple[jax.Array, ...], after: jax.Array) -> tuple[jax.Array, jax.Array]:
    body = model.object["cube"].body
    assert body is not None and body.centre is not None
    centre = body.centre
    away = jnp.broadcast_to(AWAY, (AHEAD, 1, 3))

    def turned(measured, said):
        off = rotation.product(rotation.conjugate(measured), said)
        return jnp.linalg.norm(rotation.to_rotation_vector(off))

    def one(start: tuple[jax.Array, ...], seen: jax.Array):
        position, turn, velocity, spin = start
        matrix = rotation.to_matrix(rotation.from_rotation_vector(turn))
        velocity = velocity + jnp.cross(spin, rotation.turn(matrix, centre))
        state = begun(model, {"cube": Start(position, turn, velocity, spin)}, away[0], None)
        pose = hapjax.rollout(model, state, away)[1].pose[:, 0]
        place = jnp.linalg.norm(pose[:, :3] - seen[:, :3], axis=1)
        return place, jax.vmap(turned)(seen[:, 3:], pose[:, 3:])

    return jax.vmap(one)(before, after)


def plot(path: Path, found: dict[str, np.ndarray]) -> None:
    """The errors over how far ahead they are."""
    figure = Figure(figsize=(6, 3.6), layout="constrained")
    axes = figure.subplots()
    for name, values in found.items():
        axes.plot(np.arange(1, AHEAD + 1), 1e3 * rms(values), marker="o", label=name)
    axes.set_xlabel("samples ahead, from the last one before a touch")
    axes.set_ylabel("error of the corners, rms, mm")
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
    axes.legend(loc="upper left", fontsize="small")
    with replacing(path, "wb") as file:
        figure.savefig(file, format="png", dpi=120)


def rms(values: np.ndarray) -> np.ndarray:
    """Root mean squares of columns."""
    return np.sqrt(np.mean(values**2, axis=0))


def show(result: FitResult, found: dict[str, np.ndarray]) -> None:
    """Print what all windows share, and the errors."""
    table = Table(Column("number", no_wrap=True), "fitted", "95 % interval", "published")
    known = {"contact.floor.mu": "0.15 to 0.22", "object.cube.body.inertia": f"{PUBLISHED_INERTIA:g}"}
    for name, p in result.parameters.items():
        if not name.startswith("start."):
            low, high = (f"{x:.3g}" if x is not None else "" for x in p.interval95)
            value = "not identified" if p.estimate is None else f"{p.estimate:.3g}"
            table.add_row(escape(name), value, f"{low} to {high}", known.get(name.split("[")[0], ""))
    Console().print(table)
    damping = result.parameters["contact.floor.damping"].estimate
    if damping is not None:
        e = restitution_of(damping, IMPACT)
        print(f"restitution at {IMPACT:g} m/s: {e:.2f} (published: {PUBLISHED_RESTITUTION:g})")
    ahead = (1, 2, AHEAD)
    table = Table("corners, rms, mm, on tosses held out", *(f"{n} ahead" for n in ahead))
    for name, values in found.items():
        table.add_row(name, *(f"{1e3 * rms(values)[n - 1]:.2f}" for n in ahead))
    Console().print(
        table, f"{len(found['fitted'])} touches; samples ahead from the last one before the touch"
    )


def arguments(argv: list[str] | None) -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(
        description="Fit friction, inertia and loss of a cube from tracked tosses.",
        epilog="FILE is an NPZ of state (position m, quaternion w x y z, velocity m/s, angular velocity rad/s in the "
        "cube's frame), offset, rate (Hz), mass (kg) and side (m). Exit code 2: bad input, said in one sentence.",
    )
    parser.add_argument("file", metavar="FILE", type=Path, help="recorded tosses, NPZ in SI units")
    parser.add_argument(
        "--tosses", metavar="N", type=int, default=20, help="tosses to fit (default %(default)s)"
    )
    parser.add_argument("--plot", metavar="PNG", type=Path, help="also plot how well touches are predicted")
    parser.add_argument("--json", metavar="F", type=Path, help="also write the figures to this file as JSON")
    return parser.parse_args(argv)


def main(argv: list[str] | None = None) -> int:
    """Run the command; its exit code."""
    given = arguments(argv)
    jax.config.update("jax_enable_x64", True)
    try:
        tosses = read(given.file)
        held_out = tosses[::HELD_OUT]
        rest = [toss for i, toss in enumerate(tosses) if i % HELD_OUT]
        if not 1 <= given.tosses <= len(rest):
            raise hapjax.InputError(f"--tosses is {given.tosses}; allowed: 1 to {len(rest)}")
        result = identify(rest[:: len(rest) // given.tosses][: given.tosses])
        models = {
            "fitted": result.scene,
            "published, on the fitted box and floor": published(tosses[0], result.scene),
            "published": published(tosses[0]),
        }
        found = {name: errors(model, held_out) for name, model in models.items()}
        show(result, found)
        if given.plot is not None:
            plot(given.plot, found)
        if given.json is not None:
            figures = {k: asdict(p) for k, p in result.parameters.items() if not k.startswith("start.")}
            ahead = {name: rms(values).tolist() for name, values in found.items()}
            said = {"parameters": figures, "errors_ahead": ahead}
            write_json(given.json, said | {"residual_rms": dict(result.residual_rms)})
    except hapjax.InputError as error:
        print(" ".join(str(error).split()), file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
