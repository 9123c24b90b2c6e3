"""What the stability maps leave behind: tables for the terminal, CSV, PNG, and one page complete in itself."""

import base64
import csv
import io
from collections import Counter
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from rich.box import SIMPLE
from rich.table import Table

from ..errors import InputError
from ..files import replacing
from .error_scene import unsure
from .stability_cells import BLOWN_UP, LATEST, QUIET, RINGING, SECONDS, SETTLED, WILD
from .stability_loop import HELD, Limit
from .stability_maps import Cell, Map
from .stability_scene import Choice, Wall, cheapest

PRESSED = (
    "Pressed: two fingers close on each moving object that they feel, from opposite sides, in half a second; "
    "settled if from 0.9 s to 1 s the energy of all motion stays under 0.0001 m g L, blown up and ringing as above, "
    "without the start's energy."
)
_STYLE = """body{font:15px/1.5 sans-serif;max-width:1150px;margin:2em auto;padding:0 1em;color:#222}
table{border-collapse:collapse;margin:1em 0}th,td{border:1px solid #ccc;padding:.25em .7em;text-align:left}
img{max-width:100%}h2{margin-top:2em}"""

WHAT = (
    f"A cell is settled if over the last {SECONDS - LATEST:.1f} s of {SECONDS:g} s the energy of the normal motion and that "
    f"of the tilt stay under {QUIET:g} m g L, blown up if the energy of its motion and height ever is above {WILD:g} "
    "times that of the start plus m g L, or ends there while it falls, or a step was lost; ringing otherwise. L is the "
    "object's size."
)
BASE_CASE = (
    "Where the map does not say otherwise: a uniform cube of 50 g and 40 mm, tilted by 0.3 rad about no edge, is let go "
    "with its lowest corner 10 mm above a floor of k = 10 kN/m a corner, mu = 0.5, c = 1 s/m, gravity 9.81 m/s^2. Spin is "
    "about the vertical. A mass ratio is that of a cube of 30 mm dropped on one of 40 mm that stands on the floor, their "
    "geometric mean 50 g. An inertia ratio of r makes the moment about one horizontal axis smaller by r. Dashed: the time "
    "step 2 / w of the fastest swing on a face, w^2 = 6 k / m, times the inertia ratio, beyond which no explicit "
    "integrator is stable."
)
LOOP = (
    "A device of mass m and damping b is pressed with 1 N on a wall that hapjax steps at the rate, on positions that "
    "are late by whole samples. Lines: the stiffest passive wall, b > K T / 2 (Colgate and Schenkel 1997), with a delay of "
    "d samples b > K T (1/2 + d), whoever holds the device. Marks: the stiffest stable one in simulation, of the device "
    f"alone. In a hand: of the device in one of {HELD.mass:g} kg, {HELD.stiffness:g} N/m and {HELD.damping:.3g} N s/m, over "
    "what is passive with that hand's damping too."
)


def counts(cells: Sequence[Cell]) -> tuple[list[str], list[list[str]]]:
    """Settled, ringing and blown-up cells of each map and integrator: the header, and a row of each."""
    dtypes = list(dict.fromkeys(c.dtype for c in cells))
    kinds = list(dict.fromkeys((c.map, c.integrator) for c in cells))
    tally = Counter((c.map, c.integrator, c.dtype, c.verdict) for c in cells)

    def cell(kind, dtype):
        return " / ".join(str(tally[(*kind, dtype, v)]) for v in (SETTLED, RINGING, BLOWN_UP))

    return ["map", "integrator", *dtypes], [[*kind, *(cell(kind, d) for d in dtypes)] for kind in kinds]


def loop_rows(limits: Sequence[Limit]) -> tuple[list[str], list[list[str]]]:
    """By rate and delay, how the stable stiffness is to the passive one: the header, and a row of each."""
    rows = []
    for rate, delay in dict.fromkeys((x.rate, x.delay) for x in limits):
        some = [x for x in limits if (x.rate, x.delay) == (rate, delay)]
        borders = [x.stable / x.passive for x in some], [x.held / x.passive_held for x in some]
        measured = [f"{min(each):.3f} to {max(each):.3f}" for each in borders]
        rows.append([f"{rate:g}", str(delay), f"{some[0].passive / some[0].damping:g}", *measured])
    header = ["rate, Hz", "samples late", "passive, N/m for each N s/m", "stable over passive", "in a hand"]
    return header, rows


def choice_rows(choices: Sequence[Choice], rate: float) -> tuple[list[str], list[list[str]]]:
    """The integrators and substeps that were tried on the user's scene, cheapest first."""
    rows = [
        [
            *(c.integrator, str(c.substeps), f"{c.step_us:.1f}"),
            *("yes" if c.settles else "no", f"{c.margin:g}", c.pressed or "not felt"),
            *([] if c.error is None else ["blown up" if np.isinf(c.error) else f"{c.error:.1e}"]),
        ]
        for c in choices
    ]
    header = [
        "integrator",
        "substeps",
        f"us a step\nat {rate:g} Hz",
        "settles",
        "up to\nstiffness\ntimes",
        "pressed",
    ]
    return [*header, "error, m"] if any(c.error is not None for c in choices) else header, rows


def wall_rows(walls: Sequence[Wall]) -> tuple[list[str], list[list[str]]]:
    """The damping that devices need on the user's surfaces."""
    rows = [[w.name, f"{w.stiffness:g}", f"{w.damping:.3g}", f"{w.damping_one_late:.3g}"] for w in walls]
    return ["surface", "N/m", "device's damping, N s/m, above", "one sample late, above"], rows


def advice(choices: Sequence[Choice], rate: float, within: float | None = None, floor: float = 0.0) -> str:
    """The recommendation in one sentence; of what is also `within` (m) of a truth known to `floor`, if that is asked for."""
    best = cheapest(choices)
    if best is None:
        return f"At {rate:g} Hz the scene settles with none of the integrators and substeps tried."
    if within is None:
        return f"At {rate:g} Hz the cheapest that settles is {_described(best)}."
    good, doubt = cheapest(choices, within), unsure(floor, within)
    if good is None:
        return (
            f"At {rate:g} Hz nothing that settles stays within {within:g} m; the cheapest that settles is "
            f"{_described(best)}.{doubt}"
        )
    return f"At {rate:g} Hz the cheapest that settles and stays within {within:g} m is {_described(good)}.{doubt}"


def _described(choice: Choice) -> str:
    off = "" if choice.error is None else f"{choice.error:.1e} m off at the end, "
    pressed = "also between two fingers, " if choice.pressed else ""
    return (
        f"{choice.integrator} with substeps = {choice.substeps}: {choice.step_us:.1f} us a step, {off}"
        f"{pressed}and contacts up to {choice.margin:g} times as stiff settle too"
    )


def table(title: str, header: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    """A table for the terminal, in a narrow one too: headings fold between words, cells not at all."""
    made = Table(title=title, title_justify="left", box=SIMPLE, padding=0)
    for name, *cells in zip(header, *rows, strict=True):
        made.add_column(name, min_width=max(map(len, [*name.split(), *cells])))
    for row in rows:
        made.add_row(*row)
    return made


def write(
    folder: Path,
    maps: Mapping[str, Map],
    cells: Sequence[Cell],
    limits: Sequence[Limit],
    tables: Mapping[str, tuple[list[str], list[list[str]]]],
    sentences: Sequence[str],
) -> Path:
    """Write `stability.csv`, `loop.csv`, a PNG of each map, and `stability.html`; returns the page's path.

    **Raises:** `InputError` where the folder cannot be made or written.
    """
    from . import stability_pictures as pictures  # matplotlib takes long to import

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: no such folder can be made: {error.strerror or error}") from error
    drawn = {name: pictures.of_map(one, [c for c in cells if c.map == name]) for name, one in maps.items()}
    if cells:
        _write_csv(folder / "stability.csv", Cell._fields, cells)
    if limits:
        _write_csv(folder / "loop.csv", Limit._fields, limits)
        drawn["loop"] = pictures.of_loop(limits)
    for name, png in drawn.items():
        with replacing(folder / f"stability_{name}.png", "wb") as file:
            file.write(png)
    page = folder / "stability.html"
    with replacing(page) as file:
        file.write(_page(drawn, tables, sentences))
    return page


def _write_csv(path: Path, header: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    with replacing(path) as file:
        file.write(text.getvalue())


def _page(drawn: Mapping[str, bytes], tables, sentences: Sequence[str]) -> str:
    parts = [f"<p>{escape(sentence)}</p>" for sentence in sentences]
    for title, (header, rows) in tables.items():
        head = "".join(f"<th>{escape(name)}</th>" for name in header)
        body = "".join("<tr>" + "".join(f"<td>{escape(x)}</td>" for x in row) + "</tr>" for row in rows)
        parts.append(f"<h2>{escape(title)}</h2><table><tr>{head}</tr>{body}</table>")
    for name, png in drawn.items():
        data = base64.b64encode(png).decode()
        parts.append(f'<h2>{escape(name)}</h2><img alt="{escape(name)}" src="data:image/png;base64,{data}">')
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>hapjax stability</title><style>{_STYLE}</style></head><body>\n<h1>Stability</h1>\n"
        + "\n".join(parts)
        + "\n</body></html>\n"
    )
