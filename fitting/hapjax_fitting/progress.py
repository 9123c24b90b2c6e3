"""The steps of a long fit on the terminal."""

from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from .solve import Trace, listen


@contextmanager
def following(trace: Trace, starts: int, max_steps: int):
    """Show, on stderr if it is a terminal, the solver's steps and the best loss so far while the block runs."""
    console = Console(stderr=True)
    columns = (TextColumn("{task.description}"), BarColumn(), TimeElapsedColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("compiling", total=max_steps)

        def on_step(start: int, step: int, loss: float) -> None:
            best = min(min(losses.values()) for losses in trace.losses.values())
            bar.update(
                task,
                completed=step,
                description=f"{starts} starts, step {step} of at most {max_steps}, loss {best:.6g}",
            )

        trace.on_step = on_step
        trace.on_stage = lambda stage: bar.update(task, description=stage)
        with listen(trace):
            yield trace
