"""What takes long says how far it is."""

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from datetime import timedelta
from itertools import count
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeElapsedColumn
from rich.text import Text

Advance = Callable[[str, float], Any]
"""Takes what is being done, in words, and how much of the whole is done since it was last called."""
_FRAMES = 4  # a second


@contextmanager
def following(
    total: float | None, apart: bool = False, *, doing: str = "compiling", shown: bool = True
) -> Iterator[Advance]:
    """Show, on stderr if it is a terminal, what is being done, for how long, and the time left, as soon as two steps tell
    it, while the block runs.

    **Arguments:** `total`: how much the whole is; `None`: nobody knows. `apart`: a process of its own draws, for a block
    that is timed or runs in real time. `doing`: what is being done before anything is told. `shown`: whether at all.
    """
    console = Console(stderr=True)
    shown = shown and console.is_terminal
    if apart and shown:
        with _drawn_apart(total, doing) as told:
            yield told
        return
    with Progress(
        TextColumn("{task.description}"),
        BarColumn(bar_width=20),
        TimeElapsedColumn(),
        _Left(),
        console=console,
        transient=True,
        redirect_stdout=False,  # rich would have it on stderr
        refresh_per_second=_FRAMES,
        disable=not shown,
    ) as bar:
        task = bar.add_task(doing, total=total)

        def advance(doing: str, steps: float) -> None:
            bar.update(task, advance=steps, description=doing)

        yield advance


class _Left(ProgressColumn):
    """The time left, and nothing before it is known."""

    max_refresh = 0.5  # s; at each frame it would flicker

    def render(self, task: Task) -> Text:
        left = task.time_remaining
        return Text(
            "" if left is None else f"{timedelta(seconds=int(left))} left", style="progress.remaining"
        )


def each_tick(advance: Advance, doing: str, rate: float) -> Callable[[], bool]:
    """What a loop of `rate` Hz is to call after each tick, to tell of every tenth of a second; it returns `False`."""
    every = max(1, round(rate / 10))
    ticks = count(1)

    def tell() -> bool:
        if next(ticks) % every == 0:
            advance(doing, every / rate)
        return False

    return tell


@contextmanager
def _drawn_apart(total: float | None, doing: str) -> Iterator[Advance]:
    # A session of its own: Ctrl-C is for the program that is followed, whose end closes the pipe.
    command = [sys.executable, "-P", __file__, str(total or ""), doing]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
    ) as process:
        assert process.stdin is not None and process.stdout is not None
        process.stdout.readline()  # once it draws it takes next to nothing; to begin takes it a core
        pipe = process.stdin.fileno()
        os.set_blocking(pipe, False)

        def advance(doing: str, steps: float) -> None:
            with suppress(OSError):  # a terminal that is held draws nothing; nobody is to wait for it
                os.write(pipe, f"{steps} {doing}\n".encode())

        yield advance


def _draw(total: str, doing: str) -> None:
    """Show what comes on stdin until it ends."""
    print(flush=True)
    with following(float(total) if total else None, doing=doing) as advance:
        for line in sys.stdin:
            steps, _, doing = line.rstrip("\n").partition(" ")
            advance(doing, float(steps))


if __name__ == "__main__":
    _draw(*sys.argv[1:])
