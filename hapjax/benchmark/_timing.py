"""What the measurements share: a scene that is felt by virtual devices, and the time of a step."""

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..errors import InputError
from ..extras import need
from ..progress import Advance
from ..scene import Scene, dtype_of
from ..simulate import init, rollout

SCAN_STEPS, RUNS = 2000, 9


def felt(scene: Scene | None, fingers: int) -> tuple[Scene, list[Any]]:
    """The scene that is measured, and the virtual devices that feel it."""
    if scene is None:
        if fingers != 3:
            raise InputError(
                f"fingers is {fingers} without a scene; allowed: 3, as the demo's scene is felt by"
            )
        task = need("hapjax_devices.demo", "devices").three_finger_lift(0)
        return task.scene, task.devices
    virtual = need("hapjax_devices", "devices").VirtualDevice
    # Apart from each other and from nearby objects: a step does the same arithmetic wherever the fingers are.
    return scene, [virtual(np.array([[0.1 * i, 0.0, 1.0]])) for i in range(fingers)]


def compiled(scene: Scene, hip: np.ndarray, gimbal: np.ndarray | None) -> tuple[Callable[[], Any], float]:
    """A compiled loop of SCAN_STEPS steps with the fingers at `hip` (F, 3) m, or along (T, F, 3); and s to compile it."""
    hips = jnp.asarray(np.broadcast_to(hip, (SCAN_STEPS, *hip.shape[-2:])), dtype_of(scene))
    gimbals = None if gimbal is None else jnp.asarray(np.broadcast_to(gimbal, hips.shape[:2]), hips.dtype)
    state = init(scene, hips[0], gimbal)
    began = time.perf_counter()
    program = rollout.lower(scene, state, hips, None, gimbals).compile()
    return partial(program, scene, state, hips, None, gimbals), time.perf_counter() - began


def step_us(
    loops: Sequence[Callable[[], Any]], runs: int = RUNS, advance: Advance = lambda doing, steps: None
) -> list[float]:
    """us of a step of each compiled loop: medians over runs that take turns, so that a busy moment hits all alike.

    A first run of each is not counted; `advance` is told of that, too.
    """
    taken = np.empty((runs + 1, len(loops)))
    for row in taken:
        for i, loop in enumerate(loops):
            began = time.perf_counter()
            jax.block_until_ready(loop())
            row[i] = (time.perf_counter() - began) / SCAN_STEPS * 1e6
        advance("timing", 1.0)
    return np.median(taken[1:], axis=0).tolist()
