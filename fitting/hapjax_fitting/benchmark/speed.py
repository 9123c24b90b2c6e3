"""How long a fit takes: a minute of stroking beside the same fit by hand, a grasp, and ever more recordings."""

import time
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from hapjax import Object, Plane, Recording, Scene, Surface

from ..fit import fit
from . import by_hand
from .cases import CASES, DT, Case, shake, stroke

TRUTH, START = (0.6, 800.0), (0.9, 500.0)
_NOISE = 0.02  # N
_STROKE, _SHORT = 1200, 300  # steps
COUNTS = (10, 100, 1000)
_ROUNDS, _TIMES = 3, {"fit": 2, "one start": 5}  # in turn, and how often each then


def minute(seconds: float, seed: int = 0) -> dict[str, Any]:
    """mu and stiffness from strokes at 1 kHz over a fixed floor: s of a fit, compiled before, with the starts that it
    takes unasked and with one, and of the fit by hand, which has one; of the same data and first start, in turn."""
    recording = strokes(max(1, round(seconds / DT / _STROKE)), seed)
    assert recording.hip is not None and recording.force is not None
    path, force = recording.hip[:, 0], recording.force[:, 0]
    paths = ("object.floor.surface.mu", "object.floor.surface.stiffness")
    runs: dict[str, Callable[[], Any]] = {
        "fit": _ready(lambda: fit(floor(*START), recording, paths)),
        "one start": _ready(lambda: fit(floor(*START), recording, paths, starts=1)),
        "by hand": lambda: by_hand.fit(path, force, _NOISE, START),
    }
    least, found = dict.fromkeys(runs, np.inf), {}
    for _ in range(_ROUNDS):
        for name, run in runs.items():
            taken, found[name] = _least(run, _TIMES.get(name, 1))
            least[name] = min(least[name], taken)
    return {
        "fit_s": least["fit"],
        "starts": found["fit"].starts,
        "one_start_s": least["one start"],
        "by_hand_s": least["by hand"],
        "seconds": len(path) * DT,
        "samples": len(path),
        "ratio": least["by hand"] / least["one start"],
        "estimates": [found["one start"].parameters[name].estimate for name in paths],
        "by_hand": found["by hand"].tolist(),
    }


def grasp(seconds: float, seed: int = 0) -> dict[str, Any]:
    """s of a fit of mass and principal inertia from a grasp at 1 kHz, compiled before."""
    case = CASES["mass, centre, inertia"]
    long = Case(case.scene, case.free, partial(shake, steps=round(seconds / DT)), case.noise)
    recording, start = long.recorded(seed), long.truth()
    free = ("object.cube.body.mass", "object.cube.body.inertia")

    def ours():
        return fit(start, recording, free, noise=case.noise)

    taken, result = _least(_ready(ours), 1)
    return {"seconds": seconds, "fit_s": taken, "starts": result.starts, "converged": result.converged}


def numbers(counts: tuple[int, ...] = COUNTS) -> dict[str, Any]:
    """s of fits of so many recordings of 0.3 s at once, and the exponent of their growth over the last step."""
    free = ("object.floor.surface.mu", "object.floor.surface.stiffness")
    taken = []
    for count in counts:
        recordings = [strokes(1, seed, _SHORT) for seed in range(count)]
        run = _ready(lambda recordings=recordings: fit(floor(*START), recordings, free))
        taken.append(_least(run, 2)[0])
    exponent = np.log(taken[-1] / taken[-2]) / np.log(counts[-1] / counts[-2])
    return {"recordings": list(counts), "fit_s": taken, "exponent": float(exponent)}


def strokes(count: int, seed: int, steps: int = _STROKE) -> Recording:
    """So many strokes over a floor at 1 kHz, of so many steps each, with white noise on the force."""
    random = np.random.default_rng(seed)
    path = stroke(random, count, steps)
    force = by_hand.forces(*TRUTH, path[:, 0])[:, None]
    t = DT * np.arange(len(path))
    return Recording(hip=path, hip_t=t, force=force + _NOISE * random.standard_normal(force.shape), force_t=t)


def floor(mu: float, stiffness: float) -> Scene:
    """A fixed floor."""
    return Scene(object={"floor": Object(Plane(), Surface(stiffness, mu=mu))})


def _ready(run: Callable[[], Any]) -> Callable[[], Any]:
    run()
    return run


def _least(run: Callable[[], Any], times: int) -> tuple[float, Any]:
    """The least s of several runs, and what it gave."""
    best, found = np.inf, None
    for _ in range(times):
        began = time.perf_counter()
        found = run()
        best = min(best, time.perf_counter() - began)
    return float(best), found
