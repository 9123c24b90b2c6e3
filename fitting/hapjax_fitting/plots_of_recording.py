"""Plots of one recording: measured beside predicted, residuals, stick and slip, the friction cone."""

import numpy as np

from .canvas import BLUE, GREEN, GREY, ORANGE, RED, Image, dress, finish, rows, shade, thinned
from .replay import Compared, Replay, Touching, relative_turns
from .result import FitResult

_AXES = (("x", BLUE), ("y", ORANGE), ("z", GREEN))


def of_recording(result: FitResult, played: Replay) -> list[Image]:
    """All plots of a recording that was played through the fitted scene."""
    images = []
    force, pose = played.channels.get("force"), played.channels.get("pose")
    if force is not None:
        fingers = [f"finger {i + 1}" for i in range(force.measured.shape[1])]
        images += _pair(force, fingers, "force (N)", result.noise.get("force"), "Force on the fingers")
    for touching in played.touching:
        if touching.normal.any():
            images += [_spells(touching), _cone(touching)]
    if pose is not None:
        images += _of_pose(result, pose)
    return images


def _of_pose(result: FitResult, pose: Compared) -> list[Image]:
    names, noise = result.scene.moving(), result.noise
    place = Compared(pose.time, 1e3 * pose.measured[..., :3], 1e3 * pose.predicted[..., :3])
    first = pose.measured[0, :, 3:]
    turned = (np.degrees(relative_turns(first, p[..., 3:])) for p in (pose.measured, pose.predicted))
    off = 1e3 * noise["position"] if "position" in noise else None
    turned_off = float(np.degrees(noise["angle"])) if "angle" in noise else None
    return [
        *_pair(place, names, "position (mm)", off, "Position"),
        *_pair(
            Compared(pose.time, *turned), names, "turn (degrees)", turned_off, "Turn since the first sample"
        ),
    ]


def _pair(series: Compared, names: list[str], label: str, noise: float | None, title: str) -> list[Image]:
    return [
        _compare(series, names, label, f"{title}: measured and predicted"),
        _residuals(series, names, label, noise, f"{title}: residuals, predicted minus measured"),
    ]


def _compare(series: Compared, names: list[str], label: str, title: str) -> Image:
    figure, grid = rows(len(names), 2.1, sharex=True)
    for i, axes in enumerate(grid[:, 0]):
        for j, (name, colour) in enumerate(_AXES):
            measured = thinned(series.time, series.measured[:, i, j])
            axes.plot(*measured, color=colour, alpha=0.35, lw=3, label=f"{name} measured")
            predicted = thinned(series.time, series.predicted[:, i, j])
            axes.plot(*predicted, color=colour, lw=0.9, label=f"{name} predicted")
        dress(axes, names[i], y=label)
    grid[-1, 0].set_xlabel("time (s)")
    return finish(figure, grid[0, 0], title)


def _residuals(series: Compared, names: list[str], label: str, noise: float | None, title: str) -> Image:
    figure, grid = rows(len(names), 2.1, 2, sharey="row", width_ratios=(4, 1))
    residuals = series.predicted - series.measured
    known = residuals[np.isfinite(residuals).all(axis=(1, 2))]  # where the model was not lost
    for i, (axes, histogram) in enumerate(grid):
        for j, (name, colour) in enumerate(_AXES):
            axes.plot(*thinned(series.time, residuals[:, i, j]), color=colour, lw=0.7, label=name)
        histogram.hist(
            known[:, i], bins=60, orientation="horizontal", histtype="step", color=[c for _, c in _AXES]
        )
        if noise is not None:
            axes.axhline(2 * noise, color="black", lw=0.8, ls="--", label="twice the noise, either way")
            axes.axhline(-2 * noise, color="black", lw=0.8, ls="--")
        dress(axes, names[i], y=label)
        dress(histogram)
    grid[-1, 0].set_xlabel("time (s)")
    grid[-1, 1].set_xlabel("samples")
    return finish(figure, grid[0, 0], title)


def _spells(touching: Touching) -> Image:
    """|f_t| against what the cone allows, finger by finger; a contact's points are taken together."""
    fingers = touching.path.startswith("object.")
    shown = touching if fingers else touching.taken_together()
    figure, grid = rows(shown.normal.shape[1], 1.8, sharex=True)
    for i, axes in enumerate(grid[:, 0]):
        slips, touches = shown.slipping[:, i], shown.normal[:, i] > 0
        shade(axes, shown.time, slips, ORANGE, "slips")
        shade(axes, shown.time, touches & ~slips, GREEN, "sticks")
        if shown.limit is not None:
            limit = thinned(shown.time, shown.limit[:, i])
            axes.plot(*limit, color=RED, lw=1.4, ls="--", label=r"$\mu f_n$")
        else:
            axes.plot(*thinned(shown.time, shown.normal[:, i]), color=GREY, lw=1.2, label="$f_n$")
        axes.plot(*thinned(shown.time, shown.tangential[:, i]), color=BLUE, lw=1.2, label="$|f_t|$")
        axes.set_ylim(bottom=0)
        dress(axes, f"finger {i + 1}" if fingers else "all its points together", y="force (N)")
    grid[-1, 0].set_xlabel("time (s)")
    return finish(figure, grid[0, 0], f"Stick and slip on {touching.path}, in the fitted model")


def _cone(touching: Touching) -> Image:
    figure, grid = rows(1, 4.0)
    axes = grid[0, 0]
    if touching.measured is not None and len(touching.measured):
        points = touching.measured[:: max(1, len(touching.measured) // 20_000)]
        axes.plot(*points.T, ".", color=GREY, ms=2, alpha=0.5, label="measured")
    for slips, colour, label in ((False, GREEN, "model, sticks"), (True, ORANGE, "model, slips")):
        chosen = (touching.slipping == slips) & (touching.normal > 0)
        axes.plot(touching.normal[chosen], touching.tangential[chosen], ".", color=colour, ms=3, label=label)
    end = np.array([0.0, 1.05 * touching.normal.max()])
    for (label, mu), style in zip(touching.mu.items(), ("-", "--", "-.", ":", "-", "--"), strict=False):
        axes.plot(end, mu * end, color=RED, lw=1.2, ls=style, label=f"{label} = {mu:.4g}")
    axes.set_xlim(0, end[1])
    axes.set_ylim(bottom=0)
    dress(axes, x="normal force $f_n$ (N)", y="tangential force $|f_t|$ (N)")
    return finish(figure, axes, f"Friction on {touching.path} and the cone's edge")
