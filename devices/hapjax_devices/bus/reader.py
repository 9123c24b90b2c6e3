"""A reader's end of the bus."""

import ctypes
import os
import select
import time
from contextlib import suppress
from typing import Any

import numpy as np

from hapjax import InputError

from ..event import Event
from . import services
from .about import About


class NotBegun(InputError):
    """The process whose run was waited for has ended before that was on the bus."""


class TickReader:
    """Reads the ticks of a run; how slowly it does is its own affair.

    **Arguments:** `run`, its name; `patience`, s to wait for it to begin; `depth`, how many ticks are kept for this reader,
    `None`: those of 1.25 s. A display that wants the newest takes 1; the number of the `process` whose run it is to be,
    `None`: whichever has the name.

    **Attributes:** `about` the run; `lost`, how many ticks were pushed out before they were read, or never sent; `last`, the
    newest tick that was read, -1 before.

    **Raises:** `InputError` where the run does not begin in time; `NotBegun`, which is one, where the process has ended.
    """

    def __init__(
        self, run: str, patience: float = 20.0, depth: int | None = None, process: int | None = None
    ):
        services.check_name(run)
        until = time.monotonic() + patience
        self._node = services.join(run)
        self.about = _told(self._node, run, until, process)
        self._process = _process(self.about.process)
        self._ended = False
        self.lost, self.last = 0, -1
        sample = self.about.tick
        deepest = services.depth(self.about.rate)
        kept = deepest if depth is None else min(depth, deepest)
        self._services = []
        # Events first: who waits for readers counts those of the ticks.
        self._events = self._reads(services.events(self._node, run), services.EVENTS)
        self._ticks = self._reads(services.ticks(self._node, run, sample, self.about.rate), kept)
        self._buffer = np.zeros(kept, sample)
        self._event = np.zeros(1, services.EVENT)

    def take(self) -> np.ndarray:
        """The ticks that came since the last call, (n,) in their order; see `About.tick`."""
        n, receive, into, size = 0, self._ticks.receive, self._buffer.ctypes.data, self._buffer.itemsize
        while n < len(self._buffer) and (sample := receive()) is not None:
            ctypes.memmove(into + n * size, sample.payload_ptr, size)
            n += 1
        taken = self._buffer[:n].copy()
        if n:
            first = self.last + 1 if self.last >= 0 else int(taken["tick"][0])
            self.last = int(taken["tick"][-1])
            self.lost += self.last - first + 1 - n
        return taken

    def events(self) -> list[Event]:
        """The events that came since the last call."""
        found = []
        while (sample := self._events.receive()) is not None:
            ctypes.memmove(self._event.ctypes.data, sample.payload_ptr, self._event.nbytes)
            tick, time_ns, finger, kind, text = self._event[0].tolist()
            found.append(Event(tick, time_ns, finger, kind.decode(), text.decode(errors="replace")))
        return found

    def is_alive(self) -> bool:
        """Whether the run is still on the bus, and its process alive. What was published before can be taken afterwards."""
        if self._process is None or _has_ended(self._process):
            return False
        return self._services[-1].dynamic_config.number_of_publishers > 0

    def close(self) -> None:
        """Leave the bus."""
        for port in (self._ticks, self._events):
            port.delete()
        self._services, self._node = [], None
        if self._process is not None:
            os.close(self._process)
            self._process = None

    def __enter__(self) -> "TickReader":
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    def _reads(self, builder: Any, kept: int) -> Any:
        with services.said(f"the run {self.about.run}"):
            service = builder.open()
            self._services.append(service)
            return service.subscriber_builder().buffer_size(kept).create()


def _told(node: Any, run: str, until: float, process: int | None) -> About:
    """What the run says of itself, once it does: of those of this name the one of the process."""
    iox = services.iceoryx()
    port = None
    while True:
        over = process is not None and _is_over(process)  # asked first: what it has said before is there then
        if port is None:
            with suppress(iox.PublishSubscribeOpenError):
                service = services.about(node, run).open()
                port = service.subscriber_builder().create()
        if port is not None and (sample := port.receive()) is not None:
            about = About.from_json(bytes(sample.payload().as_memory_view()))
            if process in (None, about.process):
                return about
            port.delete()
            port = None
        if over:
            raise NotBegun(f"no run {run!r} is on the bus: its process has ended; allowed: one that goes on")
        if time.monotonic() > until:
            raise InputError(
                f"no run {run!r} is on the bus; allowed: {', '.join(services.runs()) or 'none now'}"
            )
        time.sleep(0.02)


def _process(number: int) -> int | None:
    """A handle of a process, by which its end can be seen."""
    try:
        return os.pidfd_open(number)
    except ProcessLookupError:
        return None


def _is_over(number: int) -> bool:
    """Whether a process has ended, given by its number."""
    if (process := _process(number)) is None:
        return True
    try:
        return _has_ended(process)
    finally:
        os.close(process)


def _has_ended(process: int) -> bool:
    return bool(select.select([process], [], [], 0)[0])
