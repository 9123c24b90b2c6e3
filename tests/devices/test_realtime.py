"""Deadlines by a clock that the test turns, and a process that is put back as it was."""

import gc
import os
import time

import pytest

from hapjax_devices import realtime
from hapjax_devices.realtime import MonotonicClock, Pacer, uncollected, undisturbed

PERIOD = 1000


class FakeClock:
    """A clock that moves when work is done, when one waits, and overshoots a wait by `late`."""

    def __init__(self):
        self.time, self.late = 5_000_000, 0

    def now(self):
        return self.time

    def wait(self, deadline):
        self.time = max(self.time, deadline) + self.late


def test_work_within_the_period_misses_nothing():
    clock = FakeClock()
    pacer = Pacer(PERIOD, clock)
    starts = []
    for _ in range(5):
        assert pacer.wait() == 0
        starts.append(clock.time)
        clock.time += 999
    assert pacer.missed == 0
    assert starts == [5_001_000 + PERIOD * n for n in range(5)]


@pytest.mark.parametrize(("work", "skipped"), [(1000, 0), (1001, 1), (2000, 1), (2001, 2), (7500, 7)])
def test_missed_deadlines_are_counted_and_left_out(work, skipped):
    clock = FakeClock()
    pacer = Pacer(PERIOD, clock)
    pacer.wait()
    first = clock.time
    clock.time += work
    assert pacer.wait() == 0
    assert clock.time == first + (skipped + 1) * PERIOD
    assert pacer.missed == skipped
    pacer.wait()
    assert clock.time == first + (skipped + 2) * PERIOD  # no burst to catch up
    assert pacer.missed == skipped


def test_a_late_wake_up_is_lateness_and_does_not_shift_the_deadlines():
    clock = FakeClock()
    pacer = Pacer(PERIOD, clock)
    clock.late = 300
    assert [pacer.wait() for _ in range(3)] == [300, 300, 300]
    assert clock.time == 5_003_300
    clock.late = 0
    assert pacer.wait() == 0 and pacer.missed == 0
    clock.late = 2500  # wakes up after two more deadlines
    assert pacer.wait() == 2500
    clock.late = 0
    assert pacer.wait() == 0 and pacer.missed == 2


def turned(monkeypatch):
    """The computer's time in a list, ns: a microsecond goes by whenever it is looked at."""
    now = [0]

    def look():
        now[0] += 1000
        return now[0]

    monkeypatch.setattr(realtime.time, "monotonic_ns", look)
    return now


def test_the_monotonic_clock_never_returns_early():
    clock = MonotonicClock()
    for ahead in (-1_000_000, 0, 50_000, 2_000_000):
        deadline = time.monotonic_ns() + ahead
        clock.wait(deadline)
        assert time.monotonic_ns() >= deadline


@pytest.mark.parametrize(
    ("rate", "work", "asleep"), [(1000, 100_000, 0.7), (4000, 100_000, 0.25), (4000, 200_000, 0.05)]
)
def test_a_loop_sleeps_in_each_period_however_short(rate, work, asleep, monkeypatch):
    """A process of real-time priority that is busy for over 95 % of a second is stopped for 50 ms of it."""
    now, slept = turned(monkeypatch), []

    def sleep(until):
        slept.append(until - now[0])
        now[0] = until

    clock = MonotonicClock()
    clock._sleep = sleep
    pacer = Pacer(10**9 // rate, clock)
    for _ in range(100):
        assert pacer.wait() < 2000
        now[0] += work
    assert len(slept) == 100 and sum(slept) > asleep * now[0]


@pytest.mark.parametrize(
    ("ahead", "over", "rehearsed"),
    [(900_000, 0, 1), (900_000, 60_000, 1), (900_000, 90_000, 0), (100_000, 0, 0), (-5000, 0, 0)],
)
def test_a_tick_is_rehearsed_after_a_sleep_where_there_is_time(ahead, over, rehearsed, monkeypatch):
    now, done = turned(monkeypatch), []

    def sleep(until):
        now[0] = until + over

    clock = MonotonicClock(lambda: done.append(now[0]), 75_000)
    clock._sleep = sleep
    deadline = now[0] + ahead
    clock.wait(deadline)
    assert len(done) == rehearsed and all(deadline - at > 74_000 for at in done)


@pytest.mark.parametrize("enabled", [True, False])
def test_the_collector_is_off_inside_and_as_before_afterwards(enabled):
    before = gc.isenabled()
    try:
        (gc.enable if enabled else gc.disable)()
        with pytest.raises(KeyError), uncollected():
            assert not gc.isenabled() and gc.get_freeze_count() > 0
            raise KeyError
        assert gc.isenabled() == enabled and gc.get_freeze_count() == 0
    finally:
        (gc.enable if before else gc.disable)()


def test_the_priority_is_put_back():
    before = os.sched_getscheduler(0), os.sched_getparam(0).sched_priority
    with undisturbed() as refused:
        if not any("priority" in sentence for sentence in refused):
            assert os.sched_getscheduler(0) == os.SCHED_FIFO
    assert (os.sched_getscheduler(0), os.sched_getparam(0).sched_priority) == before


def test_a_refused_privilege_is_said_in_one_sentence_and_the_block_runs(monkeypatch):
    def refuse(*_):
        raise PermissionError(1, "Operation not permitted")

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    ran = False
    with undisturbed() as refused:
        ran = True
    assert ran
    # Memory may be refused too, on a machine that does not grant it.
    assert "no real time priority (Operation not permitted): the loop runs without it" in refused
