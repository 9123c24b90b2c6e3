"""How many steps and gradients a second a batch does, beside MuJoCo's steps, and how far a held object creeps in both."""

import os
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float
from rich.console import Console
from rich.table import Table

from ..errors import InputError
from ..extras import need
from ..files import write_json
from ..integrate import METHODS
from ..progress import following
from ..scene import Scene
from ..simulate import State, init, rollout
from . import _grip
from ._mujoco import NOSLIP_ITERATIONS

SIZES, STEPS, THREADS = (1, 16, 128, 1024), 200, 2
HEIGHT, SETTLE, HELD = 0.02, 1.0, 60.0  # m over the floor; s before creep counts, and s that it counts
TILTS = (0.0, 0.3)  # rad, of gravity
HIGH = 1.0  # m, so that the floor does not stop what creeps


def measure(
    sizes: Sequence[int] = SIZES, steps: int = STEPS, held: float = HELD, integrators: Sequence[str] = ()
) -> dict[str, Any]:
    """Steps a second of batches of three-finger grips, and creep in m of one that is held for `held` s.

    `batches`: of each of `sizes`, `one_call` of a vmapped rollout, `two_threads`, each of which runs half, and `mujoco`'s
    rollout on two threads; the best of several runs that take turns. `gradients`: so many rollouts a second with the
    reverse-mode gradient of each in every number of the scene. `ratio`: hapjax's best over MuJoCo's best.
    `creep`: of each of `integrators` (none: all), of MuJoCo and of MuJoCo with its pass against slip, for each of `TILTS`.
    """
    mujoco = need("mujoco", "bench")
    batches, creep, names = [], {}, integrators or METHODS
    with following(float(len(sizes) + len(names) + 2), apart=True) as advance:
        for size in sizes:
            batches.append(_batch(size, steps))
            advance(f"batches of {size}", 1.0)
        for name in names:
            creep[name] = _creep(METHODS[name](dt=_grip.DT), held)
            advance(f"creep with {name}", 1.0)
        for label, noslip in (("MuJoCo", 0), ("MuJoCo noslip", NOSLIP_ITERATIONS)):
            creep[label] = [_creep_mujoco(held, noslip, tilt) for tilt in TILTS]
            advance(f"creep in {label}", 1.0)
    ours = max(max(b["one_call"], b["two_threads"]) for b in batches)
    theirs = max(b["mujoco"] for b in batches)
    first = _creep_mujoco(1.0, 0, 0.0)
    return {
        "device": str(jax.devices()[0]),
        "dtype": str(_grip.precision()),
        "xla_flags": os.environ.get("XLA_FLAGS", ""),
        "mujoco": mujoco.__version__,
        "steps": steps,
        "batches": batches,
        "ratio": ours / theirs,
        "held_s": held,
        "creep": creep,
        "mujoco_first_second": first,
    }


def report(scene: Scene | None, fingers: int, file: Path | None) -> None:
    """Measure, print the tables, and write the figures as JSON where a file is given.

    **Raises:** `InputError` for a scene, or other than three fingers: MuJoCo has no like one.
    """
    if scene is not None:
        raise InputError("scene is given; allowed with batch: none, for it has one that MuJoCo runs too")
    if fingers != 3:
        raise InputError(f"fingers is {fingers}; allowed with batch: 3")
    figures = measure()
    console = Console()
    console.print(_batch_table(figures))
    console.print(f"hapjax at its best over MuJoCo at its best: {figures['ratio']:.1f}")
    console.print(_creep_table(figures))
    first = figures["mujoco_first_second"]
    console.print(
        f"MuJoCo in the first second: {first * 1e6:.4g} um; beyond about 30 mm the cube is out of the fingers"
    )
    if file is not None:
        write_json(file, figures)


def _batch(size: int, steps: int) -> dict[str, Any]:
    whole, compile_s = _rollouts(size, steps)
    half = whole if size == 1 else _rollouts(size // 2, steps)[0]
    gradients, gradient_compile_s = _gradients(size, steps)
    with ThreadPoolExecutor(THREADS) as pool:

        def halves():
            return list(pool.map(lambda _: jax.block_until_ready(half()), range(THREADS)))

        runs = {
            "one_call": (lambda: jax.block_until_ready(whole()), size),
            "two_threads": (halves, THREADS * max(size // 2, 1)),
            "gradients": (lambda: jax.block_until_ready(gradients()), size),
        }
        with need("mujoco.rollout", "bench").Rollout(nthread=THREADS) as theirs:
            runs["mujoco"] = (_mujoco_rollouts(theirs, size, steps), size)
            rates = _rates(runs, steps)
    rates["gradients"] /= steps
    return {"size": size, **rates, "compile_s": compile_s, "gradient_compile_s": gradient_compile_s}


def _rates(runs: dict[str, tuple[Callable[[], Any], int]], steps: int, rounds: int = 5) -> dict[str, float]:
    """Steps a second, the best of runs that take turns; the first round is not counted."""
    taken = np.empty((rounds + 1, len(runs)))
    for row in taken:
        for i, (run, _) in enumerate(runs.values()):
            began = time.perf_counter()
            run()
            row[i] = time.perf_counter() - began
    best = taken[1:].min(axis=0)
    return {name: float(n * steps / s) for (name, (_, n)), s in zip(runs.items(), best, strict=True)}


def _grips(size: int, steps: int) -> tuple[Scene, State, Float[Array, "N T 3 3"]]:
    """A batch of grips, each pressed a little differently."""
    scene = _grip.scene()
    hips = jnp.asarray(_grip.grip(steps, 0.0), _grip.precision())
    shift = jnp.linspace(-1e-4, 1e-4, size, dtype=hips.dtype)
    paths = hips[None] + shift[:, None, None, None]
    return scene, jax.vmap(lambda path: init(scene, path[0]))(paths), paths


def _rollouts(size: int, steps: int) -> tuple[Callable[[], Any], float]:
    """A compiled batch of grips, and s to compile it."""
    scene, start, paths = _grips(size, steps)

    def ends(state, paths):
        def one(state, path):
            end, reply = rollout(scene, state, path)
            return end.motion, reply.force[-1]

        return jax.vmap(one)(state, paths)

    began = time.perf_counter()
    program = jax.jit(ends).lower(start, paths).compile()
    return lambda: program(start, paths), time.perf_counter() - began


def _gradients(size: int, steps: int) -> tuple[Callable[[], Any], float]:
    """The compiled gradients of a batch of grips, each in all of the scene's numbers, and s to compile them."""
    scene, start, paths = _grips(size, steps)

    def place(scene, state, path):
        return jnp.sum(rollout(scene, state, path)[0].motion["cube"].position ** 2)

    began = time.perf_counter()
    slopes = jax.vmap(jax.grad(place, allow_int=True), in_axes=(None, 0, 0))
    program = jax.jit(slopes).lower(scene, start, paths).compile()
    return lambda: program(scene, start, paths), time.perf_counter() - began


def _mujoco_rollouts(threads: Any, size: int, steps: int) -> Callable[[], Any]:
    mujoco = need("mujoco", "bench")
    model, data = _grip.mujoco_model(0.0)
    full = mujoco.mjtState.mjSTATE_FULLPHYSICS
    mujoco.mj_step(model, data, nstep=round(SETTLE / _grip.DT))
    start = np.empty(mujoco.mj_stateSize(model, full))
    mujoco.mj_getState(model, data, start, full)
    starts = np.tile(start, (size, 1))
    control = np.broadcast_to(_grip.PRESS, (size, steps, len(_grip.PRESS))).copy()
    state = np.empty((size, steps, len(start)))
    sensors = np.empty((size, steps, model.nsensordata))
    workers = [mujoco.MjData(model) for _ in range(THREADS)]
    return lambda: threads.rollout(model, workers, starts, control, state=state, sensordata=sensors)


def _creep(integrator, held: float) -> list[float]:
    """How far the cube moves in `held` s, m, for each of TILTS."""
    scene = _grip.raised(_grip.scene(integrator), HEIGHT)
    first, count = round(SETTLE / _grip.DT), round((SETTLE + held) / _grip.DT)
    hip = jnp.asarray(_grip.grip(1, 0.0)[0] + [0, 0, HEIGHT], _grip.precision())

    @jax.jit
    def places(scene):
        hips = jnp.broadcast_to(hip, (count, *hip.shape))
        return rollout(scene, init(scene, hip), hips)[1].pose[:, 0, :3]

    moved = []
    for tilt in TILTS:
        gravity = jnp.asarray(_grip.tilted(tilt), _grip.precision())
        path = np.asarray(places(eqx.tree_at(lambda s: s.world.gravity, scene, gravity)))
        moved.append(float(np.linalg.norm(path[-1] - path[first - 1])))
    return moved


def _creep_mujoco(held: float, noslip: int, tilt: float) -> float:
    mujoco = need("mujoco", "bench")
    model, data = _grip.mujoco_model(HIGH, noslip, tilt)
    mujoco.mj_step(model, data, nstep=round(SETTLE / _grip.DT))
    before = data.body("cube").xpos.copy()
    mujoco.mj_step(model, data, nstep=round(held / _grip.DT))
    return float(np.linalg.norm(data.body("cube").xpos - before))


def _batch_table(figures: dict[str, Any]) -> Table:
    title = f"thousand steps a second: {figures['dtype']}, {figures['device']}, MuJoCo {figures['mujoco']}"
    columns = ("batch", "one call", "two threads", "MuJoCo, two threads", "compile s")
    more = (f"gradients a second of {figures['steps']} steps", "compile s")
    table = Table(*columns, *more, title=title)
    for row in figures["batches"]:
        rates = (f"{row[name] / 1e3:.0f}" for name in ("one_call", "two_threads", "mujoco"))
        gradients = (f"{row['gradients']:.4g}", f"{row['gradient_compile_s']:.1f}")
        table.add_row(str(row["size"]), *rates, f"{row['compile_s']:.1f}", *gradients)
    return table


def _creep_table(figures: dict[str, Any]) -> Table:
    title = f"creep of a cube held by three fingers for {figures['held_s']:g} s"
    table = Table(
        "integrator", *("um" if not t else f"um, gravity tilted by {t:g} rad" for t in TILTS), title=title
    )
    for name, moved in figures["creep"].items():
        table.add_row(name, *(f"{x * 1e6:.4g}" for x in moved))
    return table
