"""Plots of the last seconds: force over time, and each finger in the plane of normal force and friction."""

from typing import Any

import numpy as np
from jaxtyping import Float

from .moments import Moments
from .stage import FINGERS

SECONDS, RATE = 5.0, 100.0  # s that are shown, Hz: what a screen can tell apart
PERIOD = 0.25  # s between two drawings: a browser on a slow computer has to keep up
PADDING = 10, 24, 0, 0  # pixels above, right of, below, left of a plot: an axis may have a number at its end
THIN = 1.5  # pixels, the thinnest curve
# At 0, seen neither in the plot nor in its legend: uPlot leaves room above curves by how far apart what it plots is, and
# none where forces are steady.
NOTHING = {"label": "", "stroke": "transparent", "class": "mantine-hidden-from-xs"}
APART = 0.01  # of the longer axis of the cone, by which dots are apart: to draw one takes long, where no GPU does it
NOWHERE = -1.0  # N, below the plot: what is not a number takes the axes with it


class Plots:
    """Two plots in the panel of a viser server.

    **Arguments:** `server`; how many `fingers`.
    """

    def __init__(self, server: Any, fingers: int):
        scales = {"x": {"time": False}, "y": {"range": (0.0, None)}}
        names = [f"finger {finger}" for finger in range(fingers)]
        # Each is thinner than those under it: of curves that are the same each is seen.
        widths = np.linspace(THIN + min(2.0 * (fingers - 1), 4.5), THIN, fingers)
        looks = [
            {"label": name, "stroke": f"#{r:02x}{g:02x}{b:02x}", "width": float(width)}
            for name, (r, g, b), width in zip(names, FINGERS[:fingers], widths, strict=True)
        ]
        empty = np.zeros(1)
        self._force = server.gui.add_uplot(
            (empty,) * (2 + fingers),
            ({"label": "s"}, *looks, NOTHING),
            title="force on the fingers",
            axes=({"label": "time (s)"}, {"label": "|f| (N)", "size": 60}),
            scales=scales,
            padding=PADDING,
            aspect=2.2,
        )
        dots = [
            {**look, "width": 0, "points": {"show": True, "size": 3 + look["width"], "fill": look["stroke"]}}
            for look in looks
        ]
        limits = [
            {**look, "label": f"mu f_n, {look['label']}", "dash": [6, 4], "points": {"show": False}}
            for look in looks
        ]
        self._cone = server.gui.add_uplot(
            (empty,) * (1 + 2 * fingers),
            ({"label": "f_n (N)"}, *dots, *limits),
            title="friction cone: |f_t| against f_n",
            axes=({"label": "f_n (N)"}, {"label": "|f_t| (N)", "size": 60}),
            scales=scales,
            padding=PADDING,
            legend={"show": False},
            aspect=2.0,
        )

    def show(self, window: Moments) -> None:
        """Plot these moments."""
        force = np.linalg.norm(window.force, axis=2)
        self._force.data = (window.time, *force.T, np.zeros(len(force)))
        self._cone.data = cone(window)


def cone(window: Moments) -> tuple[Float[np.ndarray, "N"], ...]:
    """Normal forces in rising order (N), of each finger its friction there, `NOWHERE` where a sample is of another finger,
    and of each the limit there, mu times the normal force, by its newest touch, `NOWHERE` where there was none. Of samples
    whose dots would hide each other there is one."""
    normal = window.of_deepest(window.normal_force)
    friction = window.of_deepest(np.linalg.norm(window.friction, axis=-1))
    limit = window.of_deepest(window.limit)
    fingers = normal.shape[1]
    most = 1.1 * max(0.5, normal.max(initial=0.0))
    limits = np.full((fingers, 1), np.nan)
    samples = [(np.zeros(0), np.zeros(0))] * fingers
    for finger in range(fingers):
        pressed = normal[:, finger] > 0
        if pressed.any():
            newest = np.flatnonzero(pressed)[-1]
            limits[finger] = limit[newest, finger] / normal[newest, finger]
        found = np.stack([normal[pressed, finger], friction[pressed, finger]])
        seen = np.unique(np.round(found / (APART * most)), axis=1, return_index=True)[1]
        samples[finger] = found[0, seen], found[1, seen]
    x = np.concatenate([[0.0], *(x for x, _ in samples), [most]])
    order, ends = np.argsort(x, kind="stable"), np.cumsum([1, *(len(x) for x, _ in samples)])
    dots = np.full((fingers, len(x)), NOWHERE)
    for finger, (_, y) in enumerate(samples):
        dots[finger, ends[finger] : ends[finger + 1]] = y
    return x[order], *dots[:, order], *np.nan_to_num(limits * x[order], nan=NOWHERE)
