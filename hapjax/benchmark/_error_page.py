"""The error report for people: tables, a picture a case, one HTML page that needs nothing else."""

import base64
import io
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any

from rich.box import SIMPLE
from rich.table import Table

from ..extras import need
from ..files import replacing
from .error import at, worst

_COLOURS = ("#0072b2", "#56b4e9", "#009e73", "#d55e00", "#cc79a7", "#e69f00")
_GREYS = {
    "MuJoCo Euler": "#999999",
    "MuJoCo implicitfast": "#666666",
    "MuJoCo RK4": "#000000",
    "MuJoCo noslip": "#b0a080",
}
_STYLE = """
:root { color-scheme: light dark; }
body { font: 16px/1.5 system-ui, sans-serif; margin: 0 auto; max-width: 76rem; padding: 0 1rem 3rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.2rem; margin-top: 2.5rem; }
.wide { overflow-x: auto; } table { border-collapse: collapse; }
th, td { padding: .2rem .7rem; text-align: right; border-bottom: 1px solid #8886; white-space: nowrap; }
th:first-child, td:first-child, td:last-child { text-align: left; } td:last-child { white-space: normal; }
figure { margin: 1rem 0; overflow-x: auto; background: #fff; border-radius: 4px; }
figure img { display: block; width: 100%; min-width: 36rem; }
"""
_ORDERS = (
    "case",
    "curve",
    "order",
    "theory",
    "of the\ngradient",
    "error\nat 1 ms",
    "us\na step",
    "why not the usual",
)
_EQUAL = (
    "case",
    "at run\ns/s",
    "hapjax\nerrs",
    "with",
    "MuJoCo\nerrs",
    "with",
    "over\nMuJoCo",
    "why",
)
_CHOICES = ("integrator", "substeps", "error", "us a step")


def order_rows(figures: dict[str, Any]) -> Iterator[list[str]]:
    """A row for each curve."""
    for name, case in figures["cases"].items():
        for curve, data in case["curves"].items():
            point = at(data["points"], 1e-3)
            theory = data.get("theory")
            yield [
                name,
                curve,
                _number(data["order"], ".2f"),
                "" if "theory" not in data else "none" if theory is None else f"{theory:g}",
                _gradient_order(data),
                "" if point is None else _error_of(point, curve in _GREYS, case["unit"]),
                "" if point is None else f"{point['run'] * point['dt'] * 1e6:.2f}",
                data.get("reason", ""),
            ]


def _gradient_order(data: dict[str, Any]) -> str:
    found, theory = data.get("gradient_order"), data.get("gradient_theory")
    return _number(found, ".2f") + (f" ({theory:g})" if found is not None and theory is not None else "")


def equal_rows(figures: dict[str, Any]) -> Iterator[list[str]]:
    """A row for each case that both express: where hapjax is least ahead."""
    for name, case in figures["cases"].items():
        row = worst(case)
        if row is None:
            continue
        ours, theirs = row["hapjax"], row["mujoco"]
        yield [
            name,
            f"{row['run']:.1e}",
            f"{ours['error']:.1e} {case['unit']}",
            f"{ours['integrator']}\n{_dt(ours['dt'])}",
            f"{theirs['error']:.1e}",
            f"{theirs['integrator']}\n{_dt(theirs['dt'])}",
            f"{row['factor']:.2g}",
            why(case, row),
        ]


def choice_rows(figures: dict[str, Any]) -> Iterator[list[str]]:
    """A row for each integrator and number of substeps of a user's scene, the cheapest first."""
    for row in figures.get("choices", ()):
        error = "blown up" if row["error"] is None else f"{row['error']:.1e} m"
        yield [row["integrator"], str(row["substeps"]), error, f"{row['step_us']:.2f}"]


def why(case: dict[str, Any], row: dict[str, Any]) -> str:
    """Why hapjax errs more than MuJoCo at a run time, where it does."""
    if row["factor"] <= 1:
        return "at or below"
    ours = row["hapjax"]
    points = case["curves"][ours["integrator"]]["points"]
    point = min(points, key=lambda p: abs(p["dt"] - ours["dt"]))
    if case["has_law"] and point["error"] is not None and point["error"] < 0.3 * point["law_error"]:
        return (
            f"hapjax's springs yield: it meets its own equations to {point['error']:.0e}, which are "
            f"{point['law_error']:.0e} from the rigid law"
        )
    theirs = case["curves"][f"MuJoCo {row['mujoco']['integrator']}"]["order"]
    order = case["curves"][ours["integrator"]]["order"]
    if order is not None and theirs is not None and theirs > order + 0.5:
        name = row["mujoco"]["integrator"]
        return f"MuJoCo's {name} converges here with order {theirs:.1f}, hapjax's best with {order:.1f}"
    if ours["dt"] > row["mujoco"]["dt"]:
        return (
            f"a step takes longer: {ours['dt'] / row['mujoco']['dt']:.1f} times MuJoCo's dt in the same time"
        )
    return f"its error is the larger, at {ours['dt'] / row['mujoco']['dt']:.2g} times MuJoCo's dt"


def tables(figures: dict[str, Any]) -> list[Table | str]:
    """The tables for a terminal, also a narrow one: each case a section, and what is remarked below the table."""
    shown: list[Table | str] = []
    for title, headings, rows in _tabled(figures):
        remarks: list[str] = []
        if headings[-1].startswith("why"):
            headings, rows = (*headings[:-1], ""), [_noted(row, remarks) for row in rows]
        if headings[0] == "case":
            headings, rows = headings[1:], list(_sections(rows))
        table = Table(title=title, title_justify="left", box=SIMPLE, padding=(0, 1, 0, 0))
        for heading in headings:
            table.add_column(heading, no_wrap=True)
        for row in rows:
            table.add_row(*row)
        shown += [table, *(f"({n}) {remark}" for n, remark in enumerate(remarks, 1))]
    return shown


def _noted(row: list[str], remarks: list[str]) -> list[str]:
    """The row with the number of its remark in the place of it."""
    *cells, remark = row
    if remark and remark not in remarks:
        remarks.append(remark)
    return [*cells, f"({remarks.index(remark) + 1})" if remark else ""]


def _sections(rows: list[list[str]]) -> Iterator[list[str]]:
    """Rows without their first cell, which is a heading over those that have it in common."""
    last = None
    for first, *cells in rows:
        if first != last:
            yield [f"[bold]{first}[/]"]
        last = first
        yield [f"  {cells[0]}", *cells[1:]]


def _tabled(figures: dict[str, Any]) -> list[tuple[str, tuple[str, ...], list[list[str]]]]:
    """The tables that have rows: title, headings, rows."""
    every = (
        ("Orders of convergence", _ORDERS, list(order_rows(figures))),
        ("At equal run time, where hapjax is least ahead of MuJoCo", _EQUAL, list(equal_rows(figures))),
        ("What each errs and costs on this scene", _CHOICES, list(choice_rows(figures))),
    )
    return [table for table in every if table[2]]


def sentences(figures: dict[str, Any]) -> list[str]:
    """What the tables leave out: cases that MuJoCo does not express, and under which flags all ran."""
    found = [f"MuJoCo does not run {n}: {c['mujoco']}." for n, c in figures["cases"].items() if c["mujoco"]]
    if not figures["mujoco"][0].isdigit():  # it is missing, and each case would say so
        found = [f"MuJoCo does not run: {figures['mujoco']}."]
    flags = figures["xla_flags"]
    loops = (
        f"XLA_FLAGS was {flags}."
        if flags
        else (
            "XLA_FLAGS was not set; with XLA_FLAGS=--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold"
            "=100000000 a loop of steps becomes one function, several times as fast."
        )
    )
    if "step_us" in figures:
        explicit, implicit = (figures["step_us"][name] for name in ("semi_implicit", "implicit"))
        found.append(
            f"On three fingers that grip a cube on a floor an implicit step costs {implicit / explicit:.1f} times a "
            f"semi-implicit one, {implicit:.1f} us against {explicit:.1f} us."
        )
    return [*found, loops, *([figures["advice"]] if "advice" in figures else [])]


def write(figures: dict[str, Any], out: Path) -> Path:
    """Write a picture for each case, and the page with all of them; returns the page's path."""
    need("matplotlib", "bench")
    pictures = {}
    for name, case in figures["cases"].items():
        pictures[name] = picture(name, case)
        with replacing(out / f"{name}.png", "wb") as file:
            file.write(pictures[name])
    path = out / "error.html"
    with replacing(path) as file:
        file.write(_page(figures, pictures))
    return path


def picture(name: str, case: dict[str, Any]) -> bytes:
    """Error over run time (both sides, by the law) and over dt (hapjax, by its own truth), as PNG."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    colours = dict(zip([c for c in case["curves"] if c not in _GREYS], _COLOURS, strict=False)) | _GREYS
    for curve, data in case["curves"].items():
        ours = curve not in _GREYS
        style = {"color": colours[curve], "marker": "o" if ours else "s", "ms": 3, "lw": 1.2, "label": curve}
        style |= {} if ours else {"linestyle": "--"}
        _line(left, data["points"], "run", "law_error", style)
        _line(right, data["points"], "dt", "error" if ours else "law_error", style)
    left.set(xlabel="run time / s per simulated second", ylabel=f"error / {case['unit']}")
    right.set(xlabel="dt / s", title="by each one's own equations" if case["has_law"] else "")
    left.set_title("by the rigid law" if case["has_law"] else "")
    for axes in (left, right):
        axes.grid(alpha=0.3)
    right.legend(fontsize=7)
    figure.suptitle(f"{name}: {case['title']}", fontsize=10)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=90)
    return stream.getvalue()


def _line(axes, points, x: str, y: str, style) -> None:
    """Errors of 0 lie on the rim of what numbers tell apart."""
    pairs = [(p[x], max(p[y], 1e-18)) for p in points if p[y] is not None and p[x] is not None]
    if pairs:
        axes.loglog(*zip(*pairs, strict=True), **style)


def _page(figures: dict[str, Any], pictures: dict[str, bytes]) -> str:
    sections = "".join(_section(name, case, pictures[name]) for name, case in figures["cases"].items())
    tabled = "".join(
        f"<h2>{escape(title)}</h2>{html_table(headings, rows)}" for title, headings, rows in _tabled(figures)
    )
    notes = "".join(f"<p>{escape(s)}</p>" for s in sentences(figures))
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>hapjax: error against run time</title><style>{_STYLE}</style></head><body>\n"
        f"<h1>Error against run time</h1>\n<p>{escape(figures['device'])}, {figures['dtype']}, "
        f"MuJoCo {escape(figures['mujoco'])}.</p>{notes}\n"
        f"{tabled}\n{sections}</body></html>\n"
    )


def _section(name: str, case: dict[str, Any], image: bytes) -> str:
    title, absent = escape(case["title"]), ""
    if case["mujoco"]:
        absent = escape(f" MuJoCo does not run it: {case['mujoco']}.")
    return (
        f"<section><h2>{escape(name)}: {title}</h2><p>Truth: {escape(case['known'])}.{absent}</p>"
        f'<figure><img alt="{title}" src="data:image/png;base64,{base64.b64encode(image).decode()}"></figure>'
        "</section>\n"
    )


def html_table(headings, rows) -> str:
    """A table as HTML."""
    head = "".join(f"<th>{escape(h)}</th>" for h in headings)
    body = "".join("<tr>" + "".join(f"<td>{escape(c)}</td>" for c in row) + "</tr>" for row in rows)
    return f'<div class="wide"><table><tr>{head}</tr>{body}</table></div>'


def _error_of(point: dict[str, Any], is_mujoco: bool, unit: str) -> str:
    """The error by the curve's own truth; MuJoCo has the law's alone."""
    error = point["law_error"] if is_mujoco else point["error"]
    return "blown up" if error is None else f"{error:.1e} {unit}"


def _number(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)


def _dt(dt: float) -> str:
    return f"{dt * 1e3:.3g} ms" if dt >= 1e-3 else f"{dt * 1e6:.3g} us"
