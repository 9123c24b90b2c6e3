"""The whole examination, said in a list and in figures."""

from collections.abc import Iterator
from pathlib import Path

from rich.console import Console
from rich.text import Text

from hapjax import InputError
from hapjax.files import write_json

from .check import Check
from .system import settings
from .timing import timings

_STYLES = {"good": "green", "poor": "yellow", "unknown": "dim"}


def examine(rate: float = 1000.0, seconds: float = 2.0) -> Iterator[Check]:
    """Look at this machine, one thing after the other: settings first, then three loops of `seconds` s at `rate` Hz.

    **Raises:** `InputError` for a rate outside 100 to 4000 Hz or a time outside 0.1 to 600 s.
    """
    if not 100 <= rate <= 4000:
        raise InputError(f"rate is {rate} Hz; allowed: 100 to 4000")
    if not 0.1 <= seconds <= 600:
        raise InputError(f"seconds is {seconds}; allowed: 0.1 to 600")
    return _examined(rate, seconds)


def report(rate: float, seconds: float, file: Path | None) -> None:
    """Examine, print what is found as it is found, and write it as JSON where a file is given."""
    console, checks = Console(), []
    for check in examine(rate, seconds):
        checks.append(check)
        head = Text(f"{check.state:8}", _STYLES[check.state])
        console.print(head, f"{check.name}: {check.sentence}", markup=False, soft_wrap=True)
        if check.advice:
            console.print(f"         -> {check.advice}", markup=False, soft_wrap=True)
    poor = [check.name for check in checks if check.state == "poor" and check.advice]
    console.print(f"to be mended: {', '.join(poor)}" if poor else "nothing to be mended", soft_wrap=True)
    if file is not None:
        write_json(file, {check.name: check._asdict() for check in checks})


def _examined(rate: float, seconds: float) -> Iterator[Check]:
    yield from settings()
    yield from timings(rate, seconds)
