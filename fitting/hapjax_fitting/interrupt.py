"""Ctrl-C while a fit runs: the search ends, what it found so far is kept."""

import logging
import os
import signal
import threading
from collections.abc import Callable
from contextlib import contextmanager, suppress
from typing import TypeVar

import jax

from .solve import Trace

_T = TypeVar("_T")


@contextmanager
def stopping_at_interrupts(trace: Trace):
    """Inside the block, the first SIGINT ends the search also while compiled code runs; the second one ends the program.

    Python runs a signal's handler in the main thread alone, and not before compiled code has returned to it. So the
    handler in C writes a byte (`signal.set_wakeup_fd`), which the solver's callback looks for, in whatever thread that
    is; it fails then, and with it the compiled code. Outside the main thread, where the program has a handler of its own,
    and in a fit of several processes, nothing is changed.
    """
    if (
        jax.process_count() > 1  # which would wait for the one that ends
        or threading.current_thread() is not threading.main_thread()
        or signal.getsignal(signal.SIGINT) is not signal.default_int_handler
    ):
        yield
        return
    watch = _Watch(trace)
    log = logging.getLogger("jax._src.debugging")  # it would print a traceback of the callback that fails
    log.addFilter(watch.is_worth_logging)
    before, trace.should_stop = signal.set_wakeup_fd(watch.write, warn_on_full_buffer=False), watch.has_come
    signal.signal(signal.SIGINT, watch.handle)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, signal.default_int_handler)
        signal.set_wakeup_fd(before)
        log.removeFilter(watch.is_worth_logging)
        trace.should_stop = None
        watch.close(before)


def once_more(trace: Trace, make: Callable[[], _T]) -> _T:
    """What is made of what a search found, also where the first SIGINT comes in the middle of that."""
    try:
        return make()
    except KeyboardInterrupt:
        if trace.interrupted:
            raise
        trace.interrupted = True
        return make()


class _Watch:
    """A pipe from the handler in C, and how many signals have been acted on by either side."""

    def __init__(self, trace: Trace):
        self.trace, self.acted, self.handled, self.received = trace, 0, 0, b""
        self.read, self.write = os.pipe()
        for end in (self.read, self.write):
            os.set_blocking(end, False)

    def has_come(self) -> bool:
        """Whether a SIGINT has come that nobody acted on yet; of any thread."""
        with suppress(BlockingIOError):
            self.received += os.read(self.read, 4096)
        count = self.received.count(signal.SIGINT)
        if count <= self.acted:
            return False
        self.acted, self.trace.interrupted = count, True
        return True

    def handle(self, number, frame) -> None:
        """Python's handler: a signal that stopped the solver needs no exception any more."""
        self.handled += 1
        if self.handled > self.acted:
            self.acted, self.trace.interrupted = self.handled, True
            raise KeyboardInterrupt

    def is_worth_logging(self, record: logging.LogRecord) -> bool:
        """Whether a failure of a callback is none of ours."""
        return not self.trace.interrupted

    def close(self, before: int) -> None:
        """Hand what came on to whoever listened before."""
        self.has_come()
        if before != -1 and self.received:
            os.write(before, self.received)
        for end in (self.read, self.write):
            os.close(end)
