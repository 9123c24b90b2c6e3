"""The steps of a long fit on the terminal."""

from contextlib import contextmanager

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from .solve import Trace, listen


@contextmanager
def following(trace: Trace, max_steps: int):
    """Show, on stderr if it is a terminal, the solver's steps, the best loss so far and the time left while the block
    runs."""
    console = Console(stderr=True)
    columns = (
        TextColumn("{task.description}"),
        BarColumn(bar_width=20),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(elapsed_when_finished=False),
    )
    with Progress(*columns, console=console, transient=True, disable=not console.is_terminal) as bar:
        task = bar.add_task("compiling", total=None)

        def on_step(start: int, step: int, loss: float) -> None:
            best = min(min(losses.values()) for losses in trace.losses.values())
            bar.update(
                task,
                total=trace.expected,
                completed=done(trace, max_steps),
                description=f"start {start + 1} of {trace.expected}, step {step}, loss {best:.6g}",
            )

        trace.on_step = on_step
        trace.on_stage = lambda stage: bar.update(task, description=stage)
        with listen(trace):
            yield trace


def done(trace: Trace, max_steps: int) -> float:
    """How many of the starts are done; of the one that runs, the part that its steps are of those that others took.

    The first one has only the most that it may take to go by.
    """
    *finished, running = (max(losses) for losses in trace.losses.values())
    typical = sum(finished) / len(finished) if finished else max_steps
    return len(finished) + min(running / max(typical, 1), 0.95)
