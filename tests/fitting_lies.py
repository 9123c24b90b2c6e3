"""Recordings whose truth is known, and what is found to be odd about them."""

from dataclasses import replace
from functools import cache

import numpy as np

from fitting_cases import floor, forces, held_cube, shaken_cube, stroke
from hapjax import Recording, Scene, cast, init, rollout
from hapjax_fitting.benchmark.cases import CASES
from hapjax_fitting.findings import lies

STEPS = 500


@cache
def strokes(length=0.02):
    """Two fingers on one floor, one after the other, which press differently: times, path and noiseless forces."""
    t, first = stroke(STEPS, length)
    second = np.roll(stroke(STEPS, -1.5 * length, depth=0.004)[1], 60, axis=0)
    path = np.concatenate([first, second + [0.1, 0.02, 0]], axis=1)
    return t, path, forces(floor(), path)


def on_floor(seed=0, sigma=0.02, length=0.02, every=1) -> Recording:
    t, path, clean = strokes(length)
    noise = sigma * np.random.default_rng(seed).standard_normal(clean.shape)
    return Recording(hip=path, hip_t=t, force=(clean + noise)[::every], force_t=t[::every])


@cache
def in_hand(seed=0) -> Recording:
    return shaken_cube(seed)


def found(recording, scene=None, friction=False):
    """The kinds and channels that are found, and in what words."""
    scene = scene or (floor() if recording.pose is None else held_cube())
    every = lies(cast(scene, np.float64), recording, friction)
    for finding in every:
        assert "\n" not in str(finding) and finding.sentence and finding.done == "only reported"
    return {(finding.kind, finding.channel) for finding in every}, " ".join(map(str, every))


@cache
def four_fingers() -> tuple[Scene, Recording]:
    """A cube that is held and shaken, with noisy poses and a surface that damps."""
    case = CASES["mass, centre, inertia"]
    return case.truth(), case.recorded(0)


def late(recording, by):
    return replace(recording, force_t=recording.force_t + by)


@cache
def lifted(seed=0, steps=1000) -> Recording:
    """A cube that two fingers, which press alike, lift slowly and move about; without noise of the force."""
    random, t = np.random.default_rng(seed), 1e-3 * np.arange(steps)
    phase, starts = random.uniform(0, 6.28, 4), np.clip(3 * (t - 0.3), 0, 1)
    squeeze = np.interp(t, [0, 0.15], [0.032, 0.026]) + 6e-4 * np.sin(9 * t + phase[0]) * (t > 0.15)
    up = 0.02 * np.clip((t - 0.3) / 0.5, 0, 1) + 2e-3 * np.sin(11 * t + phase[1]) * np.clip(
        5 * (t - 0.8), 0, 1
    )
    x, y = (a * np.sin(w * t + p) * starts for a, w, p in ((0.012, 5, phase[2]), (0.008, 7, phase[3])))
    ends = [np.stack([side * squeeze + x, y, 0.03 + up], axis=-1) for side in (-1, 0.97)]
    path, scene = np.stack(ends, axis=1), held_cube()
    _, reply = rollout(scene, init(scene, path[0]), path)
    pose = np.asarray(reply.pose)[4::5].copy()
    pose[..., :3] += 1e-4 * random.standard_normal(pose[..., :3].shape)
    force = np.asarray(reply.force)
    return Recording(hip=path, hip_t=t, force=force, force_t=t, pose=pose, pose_t=t[4::5] + 1e-3)
