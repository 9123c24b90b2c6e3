"""The steps of a long fit on the terminal."""

from collections.abc import Iterator
from contextlib import contextmanager

from hapjax.progress import following as shown_by

from .solve import Trace, listen


@contextmanager
def following(trace: Trace, max_steps: int) -> Iterator[Trace]:
    """Show, on stderr if it is a terminal, the solver's steps, the best loss so far and the time left while the block
    runs."""
    with shown_by(1.0) as advance:
        before = 0.0

        def on_step(start: int, step: int, loss: float) -> None:
            nonlocal before
            best = min(min(losses.values()) for losses in trace.losses.values())
            now = done(trace, max_steps) / trace.expected
            advance(f"start {start + 1} of {trace.expected}, step {step}, loss {best:.6g}", now - before)
            before = now

        trace.on_step = on_step
        trace.on_stage = lambda stage: advance(stage, 0.0)
        with listen(trace):
            yield trace


def done(trace: Trace, max_steps: int) -> float:
    """How many of the starts are done; of the one that runs, the part that its steps are of those that others took.

    The first one has only the most that it may take to go by.
    """
    *finished, running = (max(losses) for losses in trace.losses.values())
    typical = sum(finished) / len(finished) if finished else max_steps
    return len(finished) + min(running / max(typical, 1), 0.95)
