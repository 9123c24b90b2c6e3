"""A fit for people: a table for the terminal, and one HTML page with plots that needs nothing else."""

import os
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

import numpy as np
from rich.box import SIMPLE
from rich.table import Table

from hapjax import InputError
from hapjax.files import replacing

from .result import Estimate, FitResult
from .section import Section, figure

_STYLE = """
:root { color-scheme: light dark; }
body { font: 16px/1.5 system-ui, sans-serif; margin: 0 auto; max-width: 76rem; padding: 0 1rem 3rem; }
h1 { font-size: 1.6rem; } h2 { font-size: 1.25rem; margin-top: 2.5rem; }
.wide { overflow-x: auto; } table { border-collapse: collapse; }
th, td { padding: .3rem .8rem; text-align: right; border-bottom: 1px solid #8886; white-space: nowrap; }
th:first-child, td:first-child { text-align: left; }
td.words { white-space: normal; min-width: 14rem; } th:last-child, td.words { text-align: left; }
figure { margin: 1rem 0; overflow-x: auto; background: #fff; border-radius: 4px; }
figure img { display: block; width: 100%; min-width: 36rem; }
.warn { border-left: 4px solid #d55e00; padding-left: .8rem; }
"""


def table(result: FitResult, truth: Mapping[str, float] | None = None, *, interval99: bool = False) -> Table:
    """The parameters as a table for the terminal; print it with rich.

    **Arguments:** `truth`, the true values by the parameters' names, where they are known; `interval99`: show
    99 % intervals instead of 95 %.

    **Raises:** `InputError` where `truth` names what was not free.
    """
    _check_truth(result, truth)
    caption = "\n".join(_warnings(result)) or None
    shown = Table(
        title="Fitted parameters", title_justify="left", caption=caption, caption_justify="left", box=SIMPLE
    )
    rows = [_row(name, estimate, truth, interval99) for name, estimate in result.parameters.items()]
    name, *truths, estimated, interval = _row_headings(truth, interval99)
    shown.add_column(name, no_wrap=True)
    for heading in truths:
        shown.add_column(heading, justify="right", no_wrap=True)
    for heading in (estimated, interval):  # these may break between their words on a narrow terminal
        shown.add_column(heading, justify="right")
    for row in rows:
        shown.add_row(*row)
    return shown


def _row_headings(truth: Mapping[str, float] | None, interval99: bool) -> list[str]:
    first, *truths, estimate, error, interval, _ = _headings(truth, interval99)
    return [first, *truths, f"{estimate} ± {error}", interval]


def _row(name: str, estimate: Estimate, truth: Mapping[str, float] | None, interval99: bool) -> list[str]:
    """The terminal's row: the cells, with fewer columns."""
    name, *truths, value, error, interval, words = _cells(name, estimate, truth, interval99)
    return (
        [name, *truths, f"{value} ± {error}", interval] if value else [name, *truths, "not identified", words]
    )


def write_report(
    result: FitResult,
    folder: str | os.PathLike[str],
    truth: Mapping[str, float] | None = None,
    sections: Sequence[Section] = (),
) -> Path:
    """Write `report.html` into a folder, which is made if need be, and return the file's path.

    The page is complete in itself, and it is written whole or not at all.

    **Arguments:** `truth` as for `table`; `sections`, what else is to stand in it: `section()` of a `Comparison`, a
    `Profile`, a `Suggestion`.

    **Raises:** `InputError` where the file cannot be written, or `truth` names what was not free.
    """
    from . import plots  # matplotlib takes long to import

    _check_truth(result, truth)
    path = Path(folder) / "report.html"
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder}: no such folder can be made: {error.strerror or error}") from error
    page = _page(result, truth, plots.figures(result, truth), "".join(part.html() for part in sections))
    with replacing(path) as file:
        file.write(page)
    return path


def _page(result: FitResult, truth: Mapping[str, float] | None, figures, more: str) -> str:
    sections = "".join(
        f"<section><h2>{escape(heading)}</h2>{''.join(figure(*f) for f in group)}</section>\n"
        for heading, group in figures.items()
    )
    return (
        '<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<title>hapjax fit</title><style>{_STYLE}</style></head><body>\n"
        f"<h1>Fit of {_count(len(result.parameters), 'parameter')} to "
        f"{_count(len(result.recordings), 'recording')}</h1>\n"
        f"{_html_table(result, truth)}\n{_summary(result)}\n{_findings(result)}{more}{sections}</body></html>\n"
    )


def _html_table(result: FitResult, truth: Mapping[str, float] | None) -> str:
    head = "".join(f"<th>{escape(h)}</th>" for h in _headings(truth, False))
    rows = []
    for name, estimate in result.parameters.items():
        *numbers, words = _cells(name, estimate, truth, False)
        cells = "".join(f"<td>{escape(c)}</td>" for c in numbers)
        rows.append(f'<tr>{cells}<td class="words">{escape(words)}</td></tr>')
    return f'<div class="wide"><table><tr>{head}</tr>{"".join(rows)}</table></div>'


def _summary(result: FitResult) -> str:
    rms = ", ".join(
        f"{channel} {value * scale:.3g} {unit} (noise {result.noise[key] * scale:.3g} {unit})"
        for channel, key, scale, unit in (
            ("force", "force", 1e3, "mN"),
            ("position", "position", 1e3, "mm"),
            ("angle", "angle", 180 / np.pi, "degrees"),
        )
        if (value := result.residual_rms.get("pose" if key == "position" else key)) is not None
    )
    lines = [
        f"<p>Residuals, root mean square: {rms}.</p>",
        f"<p>{result.starts_at_best} of {_count(result.starts, 'start')} ended at the best loss, "
        f"{result.loss:.6g}; it took {result.wall_s:.1f} s.</p>",
    ]
    return "\n".join(lines + [f'<p class="warn">{escape(w)}</p>' for w in _warnings(result)])


def _findings(result: FitResult) -> str:
    """What is odd about the recordings, as a section; nothing where nothing is."""
    items = "".join(f"<li>{escape(str(finding))}</li>" for finding in result.findings)
    return f'<section><h2>Findings</h2><ul class="warn">{items}</ul></section>\n' if items else ""


def _warnings(result: FitResult) -> list[str]:
    found = []
    if not result.converged:
        found.append(f"Not converged: {result.reason}. A better fit may exist.")
    if result.starts > 1 and result.starts_at_best == 1:
        found.append("Only one start ended at the best loss: a better one may have been missed.")
    found += [f"{name} is {p.reason}." for name, p in result.parameters.items() if p.identified and p.reason]
    found += result.adjusted
    if result.lost:
        dropped = ", ".join(f"{_count(n, 'sample')} of {name}" for name, n in result.lost.items())
        found.append(f"The model left the range of sense; dropped were {dropped}.")
    # Where a loss leaves outliers out, so does what is said of the residuals.
    explained = not any(finding.kind == "misfit" for finding in result.findings)
    sizes = {key: result.residual_rms["pose" if key == "position" else key] for key in result.noise}
    large = {key: rms / result.noise[key] for key, rms in sizes.items() if rms > 2 * result.noise[key]}
    if large and not explained:
        times = ", ".join(f"{key} {ratio:.1f} times" for key, ratio in large.items())
        found.append(
            f"The residuals are larger than the noise ({times}): the model as fitted does not explain the "
            "recordings, and the parameters may err by more than their intervals."
        )
    if not all(estimate.identified for estimate in result.parameters.values()):
        found.extend(result.identifiability)
    return found


def _headings(truth: Mapping[str, float] | None, interval99: bool) -> list[str]:
    width = "99" if interval99 else "95"
    truths = [] if truth is None else ["truth"]
    return ["parameter", *truths, "estimate", "standard error", f"{width} % interval", "identified"]


def _cells(name: str, estimate: Estimate, truth: Mapping[str, float] | None, interval99: bool) -> list[str]:
    """A row: the numbers to so many digits that the standard error has two."""
    error = estimate.standard_error
    truths = [] if truth is None else ["" if name not in truth else digits(truth[name], error)]
    if estimate.estimate is None or error is None:
        return [name, *truths, "", "", "", f"no: {in_words(estimate)}"]
    interval = estimate.interval99 if interval99 and estimate.interval99 else estimate.interval95
    ends = " to ".join(digits(end, error) for end in interval if end is not None)
    return [name, *truths, digits(estimate.estimate, error), f"{error:.2g}", ends, "yes"]


def in_words(estimate: Estimate) -> str:
    """What is known of a parameter that is not identified, and why it is no more."""
    low, high = estimate.interval95
    ends = (("at least", low), ("at most", high))
    known = [f"{word} {end:.3g}" for word, end in ends if end is not None]
    reason = estimate.reason or "not identified"
    return f"{' and '.join(known)}: {reason}" if known else reason


def digits(value: float, error: float | None) -> str:
    """A number to so many digits that its standard error has two."""
    if not error or not value:
        return f"{value:.6g}"
    digits = int(np.floor(np.log10(abs(value))) - np.floor(np.log10(error))) + 2
    return f"{value:#.{min(max(digits, 2), 15)}g}".rstrip(".")


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"


def _check_truth(result: FitResult, truth: Mapping[str, float] | None) -> None:
    for name in truth or {}:
        if name not in result.parameters:
            raise InputError(f"truth names {name}; allowed: {', '.join(result.parameters)}")
