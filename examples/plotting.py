"""What the examples share: fingers at rest, a scene played through, and the one plot that each of them writes."""

import argparse
import os
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from matplotlib.figure import Figure

import hapjax

G = 9.81


def begin(description: str) -> Path:
    """Read the command line, make its folder, and compute with 64-bit numbers."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument(
        "--out", type=Path, default=Path(), metavar="DIR", help="folder of the plot (default: here)"
    )
    folder = parser.parse_args().out
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        parser.error(f"--out {folder} cannot be made ({error.strerror}); allowed: a folder for the plot")
    if not os.access(folder, os.W_OK):
        parser.error(f"--out {folder} cannot be written to; allowed: a folder for the plot")
    jax.config.update("jax_enable_x64", True)
    return folder


def at_rest(hip, steps: int) -> jax.Array:
    """Fingers (F, 3) m that stay where they are for a number of steps: (steps, F, 3) m."""
    hip = jnp.asarray(hip)
    return jnp.broadcast_to(hip, (steps, *hip.shape))


def smoothly(start, end, steps: int) -> np.ndarray:
    """From 0 to 1 as a smooth step between the times `start` and `end`, given as parts of the whole: (steps, 1, 1)."""
    part = np.clip((np.linspace(0, 1, steps) - start) / (end - start), 0, 1)
    return (part**2 * (3 - 2 * part))[:, None, None]


def play(scene: hapjax.Scene, hips, gimbals=None, state=None) -> hapjax.Reply:
    """Every reply of a scene along a path of fingers, from its own start or another state."""
    hips = jnp.asarray(hips)
    if state is None:
        state = hapjax.init(scene, hips[0], None if gimbals is None else gimbals[0])
    return jax.tree.map(np.asarray, hapjax.rollout(scene, state, hips, gimbals=gimbals)[1])


def turn_about(axis: int, pose) -> np.ndarray:
    """The angle in rad about the x, y or z axis of poses (T, 7) that turn about no other."""
    pose = np.asarray(pose)
    return np.unwrap(2 * np.arctan2(pose[:, 4 + axis], pose[:, 3]), period=2 * np.pi)


def save(path: Path, xlabel: str, *panels) -> None:
    """Write a plot: each panel is (ylabel, {label: (x, y)}), or has an xlabel of its own behind."""
    figure = Figure(figsize=(7, 2.4 * len(panels)), layout="constrained")
    for place, (ylabel, curves, *own) in zip(np.ravel(figure.subplots(len(panels))), panels, strict=True):
        for label, (x, y) in curves.items():
            place.plot(x, y, label=label)
        place.set_ylabel(ylabel)
        if own:
            place.set_xlabel(own[0])
        place.grid(alpha=0.3)
        place.legend(loc="best", fontsize="small")
    figure.axes[-1].set_xlabel(xlabel)
    figure.savefig(path, dpi=120)
