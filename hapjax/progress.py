"""What takes long says how far it is."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

Advance = Callable[[str, float], Any]
"""Takes what is being done, in words, and how much of the whole is done since it was last called."""


@contextmanager
def following(total: float) -> Iterator[Advance]:
    """Show, on stderr if it is a terminal, what is being done and the time left while the block runs."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("compiling", total=total)

        def advance(doing: str, steps: float) -> None:
            bar.update(task, advance=steps, description=doing)

        yield advance
