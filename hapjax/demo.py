"""The demonstration: grasp in real time, record, fit, and compare with the truth."""

import time
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console

from .errors import InputError
from .extras import need
from .progress import each_tick, following
from .scene import cast
from .scene_file import save_scene

_FREE = (
    "object.cube.surface.mu",
    "object.cube.surface.stiffness",
    "torsion.critical_area",
    "object.cube.body.mass",
    "object.cube.body.inertia",
)


def run_demo(out: Path, seed: int) -> int:
    """Run both tasks on virtual devices at 1 kHz, fit the cube's numbers, and write everything to the folder `out`.

    Returns 0 if every truth lies inside its 99 % interval, and mu and stiffness within 1 % of it, else 1.

    **Raises:** `InputError` if the folder cannot be made or the seed is below 0.
    """
    if seed < 0:
        raise InputError(f"--seed is {seed}; allowed: 0 or above")
    try:
        out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(
            f"{out}: cannot be made ({error.strerror}); allowed: a folder for the results"
        ) from None
    console = Console()
    need("hapjax_fitting", "fitting")
    recordings = _record(console, out, seed)
    with jax.enable_x64(True):
        return _identify(console, out, seed, recordings)


def _record(console: Console, out: Path, seed: int) -> dict[str, Any]:
    """Both tasks in real time; their recordings by name."""
    servo, tasks = need("hapjax_devices", "devices"), need("hapjax_devices.demo", "devices")
    save_scene(tasks.scene(), out / "truth.toml")
    recordings, told = {}, set()
    for name, build in (
        ("three_finger_lift", tasks.three_finger_lift),
        ("two_finger_swing", tasks.two_finger_swing),
    ):
        task = build(seed)
        console.print(
            f"{name.replace('_', ' ')}: {task.duration:g} s at 1 kHz, {len(task.devices)} virtual devices"
        )
        with following(task.duration, apart=True) as advance:
            result = servo.run(
                task.scene,
                task.devices,
                task.duration,
                force_sensor=task.sensors.force,
                pose_tracker=task.sensors.pose,
                stopped=each_tick(advance, "in real time", 1000.0),
            )
        for sentence in set(result.refused) - told:
            console.print(f"  {sentence}")
        told.update(result.refused)
        late = result.summary()["lateness_us"]
        console.print(
            f"  late by {late['p50']:.1f} us (p50), {late['p99.9']:.0f} us (p99.9); "
            f"missed ticks: {result.missed} of {len(result.lateness_us)}"
        )
        result.recording.save(out / f"{name}.npz")
        recordings[name] = result.recording
    return recordings


def _identify(console: Console, out: Path, seed: int, recordings: dict[str, Any]) -> int:
    fitting = need("hapjax_fitting", "fitting")
    parameters = need("hapjax_fitting.parameters", "fitting")
    truth = cast(need("hapjax_devices.demo", "devices").scene(), jnp.float64)
    free = parameters.free_parameters(truth, _FREE)
    values = np.asarray(parameters.values_of(truth, free))
    # Every number is doubled or halved; which, is the seed's choice. Inertia as a whole, to stay a real body's.
    factors = 2.0 ** np.random.default_rng(seed).choice([-1, 1], len(free))
    factors[-3:] = factors[-1]
    wrong = parameters.with_values(truth, free, jnp.asarray(values * factors))
    save_scene(wrong, out / "start.toml")
    console.print(f"fitting {len(free)} numbers to {len(recordings)} recordings, from starts a factor 2 off")
    began = time.perf_counter()
    result = fitting.fit(
        wrong,
        list(recordings.values()),
        _FREE,
        names=list(recordings),
        starts=4,
        spread=2.0,
        seed=seed,
        progress=True,
    )
    truths = {p.name: float(v) for p, v in zip(free, values, strict=True)}
    console.print(fitting.table(result, truths))
    result.save_json(out / "fit.json")
    save_scene(result.scene, out / "fitted.toml")
    page = fitting.write_report(result, out, truths)
    inside = [_inside(result.parameters[name], value) for name, value in truths.items()]
    console.print(
        f"{sum(inside)} of {len(inside)} truths inside their 99 % interval; "
        f"{result.starts_at_best} of {result.starts} starts ended at the best loss; {time.perf_counter() - began:.0f} s"
    )
    console.print(f"report: {page}", markup=False)
    # A fit that failed has wide intervals, which may well hold every truth.
    close = [_close(result.parameters[name], truths[name]) for name in _FREE[:2]]
    return 0 if all(inside) and all(close) else 1


def _inside(estimate: Any, truth: float) -> bool:
    return estimate.identified and estimate.interval99[0] <= truth <= estimate.interval99[1]


def _close(estimate: Any, truth: float) -> bool:
    return estimate.identified and abs(estimate.estimate - truth) <= 0.01 * truth
