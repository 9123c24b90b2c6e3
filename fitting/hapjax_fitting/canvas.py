"""Drawing on matplotlib's Agg canvas, without pyplot and its state: what all plots of a report share."""

import base64
import io

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image as Pixels

# Okabe and Ito's colours, told apart by the colour-blind as well.
BLUE, ORANGE, GREEN, RED, GREY = "#0072b2", "#e69f00", "#009e73", "#d55e00", "#777777"
WIDTH = 11.0  # inches; at 100 pixels an inch as wide as the page

Image = tuple[str, str]  # PNG in base64, caption


def rows(count: int, height: float, columns: int = 1, **options) -> tuple[Figure, np.ndarray]:
    """A figure with `count` rows of axes (count, columns), each `height` inches high."""
    figure = Figure(figsize=(WIDTH, 1.2 + height * count), layout="constrained")
    return figure, figure.subplots(count, columns, squeeze=False, **options)


def dress(axes: Axes, title: str = "", x: str = "", y: str = "") -> None:
    """Labels with units, and a faint grid."""
    axes.set_title(title, fontsize=10, loc="left")
    axes.set_xlabel(x)
    axes.set_ylabel(y)
    axes.grid(True, alpha=0.25)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def finish(figure: Figure, labelled: Axes | None, title: str) -> Image:
    """Title and legend, and the picture in few colours, which makes it a third as large."""
    figure.suptitle(title, fontsize=12)
    if labelled is not None:
        handles, labels = labelled.get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=6, fontsize=9, frameon=False)
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    picture = Pixels.fromarray(np.asarray(canvas.buffer_rgba())[..., :3]).quantize(96)
    file = io.BytesIO()
    picture.save(file, "PNG", optimize=True)
    return base64.b64encode(file.getvalue()).decode(), title


def shade(axes: Axes, time: np.ndarray, where: np.ndarray, colour: str, label: str) -> None:
    """Colour the background in spells."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], where, [False]]).astype(int)))
    step = time[1] - time[0]
    spells = [(float(time[a]), float(time[b - 1] + step - time[a])) for a, b in edges.reshape(-1, 2)]
    axes.broken_barh(
        spells, (0, 1), transform=axes.get_xaxis_transform(), color=colour, alpha=0.18, lw=0, label=label
    )


def thinned(time: np.ndarray, values: np.ndarray, most: int = 4000) -> tuple[np.ndarray, np.ndarray]:
    """A long series by the lowest and highest value of each of its pieces: it looks the same at a page's
    width."""
    if len(values) <= most:
        return time, values
    pieces = np.array_split(np.arange(len(values)), most // 2)
    picked = [sorted((p[np.argmin(values[p])], p[np.argmax(values[p])])) for p in pieces]
    index = np.unique(np.concatenate(picked))
    return time[index], values[index]
