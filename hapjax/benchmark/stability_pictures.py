"""The stability maps and the closed loop as pictures, on matplotlib's Agg canvas without pyplot and its state."""

import io
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from PIL import Image

from .stability_cells import BLOWN_UP, RINGING, SETTLED
from .stability_loop import HELD, Limit
from .stability_maps import Cell, Map

# Okabe and Ito's colours, told apart by the colour-blind as well.
COLOURS = {SETTLED: "#0072b2", RINGING: "#f0e442", BLOWN_UP: "#d55e00"}
LINES = ("#0072b2", "#e69f00", "#009e73", "#d55e00", "#cc79a7", "#777777")


def of_map(one: Map, cells: Sequence[Cell]) -> bytes:
    """A map as PNG: a panel for each integrator and precision, the parameter to the right, the time step upwards."""
    methods, dtypes = (list(dict.fromkeys(getattr(c, f) for c in cells)) for f in ("integrator", "dtype"))
    values, dts = sorted({c.value for c in cells}), sorted({c.dt for c in cells})
    if one.values[0] > one.values[-1]:
        values.reverse()
    figure = Figure(
        figsize=(1.2 + 2.6 * len(methods), 1.6 + 2.0 * len(dtypes)), layout="constrained", dpi=100
    )
    panels = figure.subplots(len(dtypes), len(methods), squeeze=False, sharex=True, sharey=True)
    codes = {verdict: i for i, verdict in enumerate(COLOURS)}
    colours = ListedColormap(list(COLOURS.values()))
    norm = BoundaryNorm(np.arange(len(codes) + 1) - 0.5, len(codes))
    for row, dtype in zip(panels, dtypes, strict=True):
        for axes, method in zip(row, methods, strict=True):
            table = np.full((len(dts), len(values)), np.nan)
            for c in cells:
                if (c.integrator, c.dtype) == (method, dtype):
                    table[dts.index(c.dt), values.index(c.value)] = codes[c.verdict]
            axes.pcolormesh(table, cmap=colours, norm=norm, edgecolors="white", linewidth=0.4)
            if one.limit is not None:
                _limit(axes, one, values, dts)
            axes.set_title(f"{method}, {dtype}", fontsize=8)
    _ticks(panels, one, values, dts)
    legend = [Patch(color=colour, label=verdict) for verdict, colour in COLOURS.items()]
    figure.legend(handles=legend, loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    figure.suptitle(f"{one.label[0].upper()}{one.label[1:]} and time step", fontsize=10)
    return _png(figure)


def of_loop(limits: Sequence[Limit]) -> bytes:
    """The closed loop as PNG: a panel for each delay; stiffness over the device's damping, a colour for each rate."""
    delays, rates, masses = (sorted({getattr(x, f) for x in limits}) for f in ("delay", "rate", "mass"))
    figure = Figure(figsize=(1.0 + 3.6 * len(delays), 4.2), layout="constrained", dpi=100)
    panels = figure.subplots(1, len(delays), squeeze=False, sharey=True)[0]
    for axes, delay in zip(panels, delays, strict=True):
        for rate, colour in zip(rates, LINES, strict=False):
            some = [x for x in limits if (x.delay, x.rate) == (delay, rate)]
            one_mass = [x for x in some if x.mass == masses[0]]
            axes.plot(
                [x.damping for x in one_mass] + [x.damping + HELD.damping for x in one_mass],
                [x.passive for x in one_mass] + [x.passive_held for x in one_mass],
                color=colour,
                lw=1,
                label=f"{rate:g} Hz: passive",
            )
            for mass, marker in zip(masses, "ov^sd", strict=False):
                these = [x for x in some if x.mass == mass]
                axes.plot(
                    [x.damping for x in these],
                    [x.stable for x in these],
                    marker,
                    color=colour,
                    ms=4,
                    mfc="none",
                    label=f"{mass:g} kg: stable" if rate == rates[0] else None,
                )
            axes.plot(
                [x.damping + HELD.damping for x in some],
                [x.held for x in some],
                "x",
                color=colour,
                ms=4,
                label="in a hand: stable" if rate == rates[0] else None,
            )
        axes.set(xscale="log", yscale="log", xlabel="damping of device and hand, N s/m")
        axes.set_title(f"{delay} sample{'' if delay == 1 else 's'} late", fontsize=9)
        axes.grid(True, alpha=0.25)
    panels[0].set_ylabel("stiffness of the wall, N/m")
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    figure.suptitle(
        "The stiffest wall: passive by b > K T (1/2 + delay), and stable in simulation", fontsize=10
    )
    return _png(figure)


def _limit(axes: Axes, one: Map, values: Sequence[float], dts: Sequence[float]) -> None:
    """The line of explicit stability, where it lies between the first and the last time step."""
    assert one.limit is not None
    bounds = np.array([one.limit(value) for value in values])
    # From the time step to the place upwards; a cell's middle is half a place above its edge.
    high = np.interp(np.log(bounds), np.log(dts), np.arange(len(dts)) + 0.5, left=np.nan, right=np.nan)
    axes.plot(np.arange(len(values)) + 0.5, high, "k--", lw=1)


def _ticks(panels: np.ndarray, one: Map, values: Sequence[float], dts: Sequence[float]) -> None:
    every = max(1, (len(values) - 1) // 4)
    unit = f", {one.unit}" if one.unit else ""
    for axes in panels[-1]:
        axes.set_xticks(np.arange(0, len(values), every) + 0.5, [f"{v:.3g}" for v in values[::every]])
        axes.tick_params(labelsize=7)
        axes.set_xlabel(f"{one.parameter}{unit}", fontsize=8)
    for row in panels:
        row[0].set_yticks(np.arange(len(dts)) + 0.5, [f"{dt * 1e3:g}" for dt in dts])
        row[0].tick_params(labelsize=7)
        row[0].set_ylabel("time step, ms", fontsize=8)


def _png(figure: Figure) -> bytes:
    """In few colours, which makes it a third as large."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    file = io.BytesIO()
    Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]).quantize(48).save(file, "PNG", optimize=True)
    return file.getvalue()
