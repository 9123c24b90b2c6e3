"""The same recordings of a pushed block to `fit` and to `mujoco.sysid`, in turn."""

import time
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from hapjax import cast
from hapjax.progress import Advance

from ..fit import fit
from . import mujoco_sysid, pushed

RECORDINGS = 20
_NEAR, _FAR = 0.03, 10.0  # starts: off by a share, and by a factor, up to this
_ARRIVED = 0.02  # as near the truth, as a share, counts as having ended there
_NORMAL = 1.959964

Found = tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]


def measure(recordings: int, advance: Advance = lambda doing, steps: None) -> dict[str, Any]:
    """Of each program: `error` of mu and mass, root mean square, and mean `width` of 95 % intervals, both over those of
    the bound of Cramer and Rao, and how often they `hold` the truth, from starts up to 3 % off; how many searches from
    starts up to a factor 10 off `arrived` within 2 % of the truth, the median s of those (`warm_s`), and the s of the
    first fit of all (`first_s`). **Raises:** `InputError` without `mujoco.sysid`."""
    mujoco_sysid.programs()
    programs: dict[str, Callable[..., Found]] = {"hapjax": _ours, "mujoco.sysid": mujoco_sysid.fit}
    truth, random = np.array(pushed.TRUTH), np.random.default_rng(0)
    seen = [pushed.recorded(seed) for seed in range(recordings)]
    near = truth * (1 + _NEAR * random.uniform(-1, 1, (recordings, 2)))
    far = truth * _FAR ** random.uniform(-1, 1, (recordings, 2))
    first = {name: _timed(program, seen[0], near[0])[1] for name, program in programs.items()}
    found = {name: {"near": [], "far": [], "s": []} for name in programs}
    for recording, close, away in zip(seen, near, far, strict=True):
        for name, program in programs.items():
            found[name]["near"].append(_timed(program, recording, close)[0])
            end, taken = _timed(program, recording, away)
            found[name]["far"].append(end)
            found[name]["s"].append(taken)
            advance(name, 1.0 / len(programs))
    bound = pushed.least_errors()
    return {
        "recordings": recordings,
        "bound": bound.tolist(),
        "programs": {name: _figures(bound, **f) | {"first_s": first[name]} for name, f in found.items()},
    }


def _figures(bound: np.ndarray, near: list[Found], far: list[Found], s: list[float]) -> dict[str, Any]:
    truth = np.array(pushed.TRUTH)
    values, widths = (np.array(x) for x in zip(*near, strict=True))
    ends = np.array([end for end, _ in far])
    return {
        "error": (np.sqrt(np.mean((values - truth) ** 2, axis=0)) / bound).tolist(),
        "width": (widths.mean(axis=0) / (_NORMAL * bound)).tolist(),
        "hold": np.mean(np.abs(values - truth) <= widths, axis=0).tolist(),
        "arrived": int(np.sum(np.all(np.abs(ends / truth - 1) < _ARRIVED, axis=1))),
        "warm_s": float(np.median(s)),
    }


def _timed(program: Callable[..., Found], recording, start: np.ndarray) -> tuple[Found, float]:
    began = time.perf_counter()
    found = program(recording, tuple(start.tolist()))
    return found, time.perf_counter() - began


def _ours(recording, start: tuple[float, float]) -> Found:
    scene = cast(pushed.scene(*start), jnp.float64)
    result = fit(scene, recording, pushed.FREE, noise=pushed.NOISE, starts=1)
    estimates = list(result.parameters.values())
    if not all(p.identified for p in estimates):
        return np.full(2, np.nan), np.full(2, np.nan)
    ends = np.array([p.interval95 for p in estimates], float)
    return np.array([p.estimate for p in estimates], float), np.diff(ends)[:, 0] / 2
