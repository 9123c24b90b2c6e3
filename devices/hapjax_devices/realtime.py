"""Keeping time: deadlines, and a process that nothing interrupts."""

import ctypes
import gc
import os
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Protocol, runtime_checkable

SPIN_NS = 150_000  # a sleep may end this late; the rest of the wait is spent spinning, of a short one half
PRIORITY = (
    80  # of 1 to 99 under SCHED_FIFO: above ordinary real-time programs, below the kernel's own threads
)
_CLOCK_MONOTONIC, _TIMER_ABSTIME = 1, 1
_MCL_CURRENT, _MCL_FUTURE, _MCL_ONFAULT = 1, 2, 4


@runtime_checkable
class Clock(Protocol):
    """Time in whole nanoseconds that never goes back."""

    def now(self) -> int:
        """The time, ns."""
        ...

    def wait(self, deadline: int) -> None:
        """Return at `deadline` (ns) or as soon after it as can be; at once where it has passed."""
        ...


class MonotonicClock:
    """The computer's monotonic clock; waits by sleeping to shortly before the deadline, then spinning.

    **Arguments:** `rehearsal`, done after a sleep in place of some of the spinning, where the `needs` ns for it are left.
    """

    def __init__(self, rehearsal: Callable[[], object] = lambda: None, needs: int = 0):
        self._sleep, self._rehearsal, self._needs = _absolute_sleep(), rehearsal, needs
        self.now = time.monotonic_ns

    def wait(self, deadline: int) -> None:
        """See `Clock.wait`."""
        left = deadline - time.monotonic_ns()
        if left > 0:
            # Never spun through: Linux takes the processor from one of real-time priority that works or spins for over
            # 95 % of a second, for the rest of it, and that is 200 ticks at 4 kHz.
            self._sleep(deadline - min(SPIN_NS, left // 2))
            if deadline - time.monotonic_ns() > self._needs:
                self._rehearsal()
        while time.monotonic_ns() < deadline:
            pass


class Pacer:
    """Deadlines at a fixed period, the first of them one period after it is made.

    A deadline that has passed before the work of the last one was done is missed: it is counted and left out,
    for a burst of steps to catch up would be felt as a blow. `missed` says how many were.

    **Arguments:** `period` in ns.
    """

    def __init__(self, period: int, clock: Clock):
        self._period, self._clock = period, clock
        self._deadline = clock.now()
        self.missed = 0

    def wait(self) -> int:
        """Wait for the next deadline; returns how late it became, ns."""
        self._deadline += self._period
        behind = self._clock.now() - self._deadline
        if behind > 0:
            skipped = -(-behind // self._period)
            self.missed += skipped
            self._deadline += skipped * self._period
        self._clock.wait(self._deadline)
        return self._clock.now() - self._deadline


@contextmanager
def undisturbed() -> Iterator[list[str]]:
    """Run a block at real-time priority with its memory locked, as far as the system allows.

    Yields a sentence for each privilege that was refused. Everything is put back afterwards.
    """
    refused: list[str] = []
    undo: list[Callable[[], object]] = []
    for ask in (_real_time_priority, _locked_memory):
        try:
            undo.append(ask())
        except (OSError, AttributeError) as error:
            what = getattr(error, "strerror", None) or "not known to this system"
            refused.append(
                f"no {ask.__name__.strip('_').replace('_', ' ')} ({what}): the loop runs without it"
            )
    try:
        yield refused
    finally:
        for step in reversed(undo):
            step()


@contextmanager
def uncollected() -> Iterator[None]:
    """Keep Python's garbage collector out of a block: one full collection takes tens of milliseconds."""
    enabled, frozen = gc.isenabled(), gc.get_freeze_count()
    gc.collect()
    gc.freeze()
    gc.disable()
    try:
        yield
    finally:
        if not frozen:
            gc.unfreeze()
        if enabled:
            gc.enable()


def _real_time_priority() -> Callable[[], object]:
    # Of every thread: compiled steps are run by a pool of threads that JAX made before.
    before: dict[int, tuple[int, os.sched_param]] = {}

    def put_back() -> None:
        for thread, (policy, parameter) in before.items():
            with suppress(ProcessLookupError):  # it has ended
                os.sched_setscheduler(thread, policy, parameter)

    try:
        for thread in map(int, os.listdir("/proc/self/task")):
            with suppress(ProcessLookupError):
                before[thread] = os.sched_getscheduler(thread), os.sched_getparam(thread)
                os.sched_setscheduler(thread, os.SCHED_FIFO, os.sched_param(PRIORITY))
    except OSError:
        put_back()
        raise
    return put_back


def _locked_memory() -> Callable[[], object]:
    libc = ctypes.CDLL(None, use_errno=True)
    # On fault: only what is used gets locked, not every thread's whole stack.
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE | _MCL_ONFAULT) != 0:
        code = ctypes.get_errno()
        raise OSError(code, os.strerror(code))
    return libc.munlockall


def _absolute_sleep() -> Callable[[int], None]:
    """A sleep to a time of the monotonic clock, ns."""
    if not sys.platform.startswith("linux"):
        return lambda until: time.sleep(max(until - time.monotonic_ns(), 0) * 1e-9)

    class TimeSpec(ctypes.Structure):
        _fields_ = [("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long)]

    nanosleep = ctypes.CDLL(None).clock_nanosleep
    nanosleep.argtypes = [ctypes.c_int, ctypes.c_int, ctypes.POINTER(TimeSpec), ctypes.c_void_p]
    until_spec = TimeSpec()
    pointer = ctypes.byref(until_spec)

    def sleep(until: int) -> None:
        until_spec.seconds, until_spec.nanoseconds = divmod(until, 1_000_000_000)
        # Not 0: interrupted by a signal, whose handler Python runs between two rounds.
        while nanosleep(_CLOCK_MONOTONIC, _TIMER_ABSTIME, pointer, None) != 0:
            pass

    return sleep
