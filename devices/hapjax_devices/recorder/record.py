"""Records a run: from the bus into a file, until the run ends in whatever way."""

import time
from collections.abc import Callable
from pathlib import Path

from ..bus import TickReader
from ..event import Event
from .growing import GrowingFile
from .messages import Messages

PERIOD = 0.04  # s between two batches: with the time that one takes, at most 0.1 s is lost where the recorder is killed


def record(
    run: str,
    path: Path,
    stopped: Callable[[], bool] = lambda: False,
    began: Callable[[], object] = lambda: None,
    patience: float = 20.0,
    process: int | None = None,
) -> str:
    """Record a run until it ends, its process ends, or `stopped()`; returns a sentence that says how it went.

    **Arguments:** `run`, its name on the bus; `path` of the new file; `began` is called once nothing is missed any more;
    `patience`, s to wait for the run; the number of the `process` whose run it is to be, `None`: of any.

    **Raises:** `InputError` where there is no such run, or a file already; `OSError` where the file cannot be written
    on: it is readable up to there.
    """
    with TickReader(run, patience, process=process) as reader:
        messages = Messages(reader.about)
        file = GrowingFile(path, reader.about, messages.schemas)
        tape = _Tape(reader, messages, file)
        began()
        while True:
            due = time.monotonic() + PERIOD
            # Asked before what is there is taken: what is taken then is all.
            over = stopped() or not reader.is_alive()
            more = tape.batch()
            if (over and not more) or tape.is_at_end():
                break
            if over:
                continue
            time.sleep(max(0.0, due - time.monotonic()))
        return tape.finish()


class _Tape:
    """What is recorded, and what is noticed on the way."""

    def __init__(self, reader: TickReader, messages: Messages, file: GrowingFile):
        self._reader, self._messages, self._file = reader, messages, file
        self._ticks, self._lost, self._end, self._unfit = 0, 0, -1, 0
        self._now = reader.about.clock_ns

    def batch(self) -> bool:
        """Write what has come since the last batch; whether there was anything."""
        events = self._reader.events()
        ticks = self._reader.take()
        said = [*self._messages.of_ticks(ticks)] if len(ticks) else []
        if len(ticks):
            self._ticks, self._now = self._ticks + len(ticks), int(ticks["time_ns"][-1])
            events = [*events, *self._left_out()]
        self._end = max([self._end, *(e.tick for e in events if e.kind == "end")])
        said += [self._messages.of_event(event) for event in events]
        if said:
            self._file.save(said)
        return bool(said)

    def is_at_end(self) -> bool:
        """Whether the run has said that it ended, and all until then is written."""
        return self._end >= 0 and self._reader.last >= self._end

    def finish(self) -> str:
        """Write the end of the file; how it went, in a sentence."""
        events, how = [], ""
        if self._end < 0 and not self._reader.is_alive():
            how = "; the servo's process ended without a word"
            sentence = f"the servo's process ended without a word after tick {self._reader.last}"
            events.append(Event(self._reader.last, self._now, -1, "cut", sentence))
        self._file.save([self._messages.of_event(event) for event in events])
        self._file.finish()
        lost = f", {self._lost} lost" if self._lost else ""
        return f"{self._ticks} ticks recorded{lost}{how}"

    def _left_out(self) -> list[Event]:
        """What of these ticks is not in the file."""
        tick, found = self._reader.last, []
        if self._reader.lost > self._lost:
            lost, self._lost = self._reader.lost - self._lost, self._reader.lost
            sentence = f"{lost} ticks before tick {tick} were not recorded: the recorder was late"
            found.append(Event(tick, self._now, -1, "dropped", sentence))
        unfit = sum(self._messages.unfit.values())
        if unfit > self._unfit:
            sentence = f"{unfit - self._unfit} samples until tick {tick} were left out: they were not finite"
            found.append(Event(tick, self._now, -1, "unfit", sentence))
            self._unfit = unfit
        return found
