"""How late the loop's ticks are on this machine, and how long a step takes in it."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import numpy as np

import hapjax
from hapjax.progress import each_tick, following

from .. import demo
from ..realtime import MonotonicClock, Pacer, uncollected, undisturbed
from .check import Check

RATES = (100, 500, 1000, 2000, 3000, 4000)  # Hz, of which the highest that can be held is told


def timings(rate: float, seconds: float) -> Iterator[Check]:
    """An idle loop without and with privileges, then one that steps the demonstration's scene, for `seconds` each."""
    yield _idle("idle loop, as any program", rate, seconds, privileged=False)
    yield _idle("idle loop, with what is granted", rate, seconds, privileged=True)
    yield step(rate, seconds)


def step(rate: float, seconds: float) -> Check:
    """The demonstration's step in the loop, and the highest rate that lateness and step together leave room for."""
    with following(seconds, apart=True) as advance:
        return _step(rate, seconds, each_tick(advance, "loop with a step", rate))


def _step(rate: float, seconds: float, told: Callable[[], Any]) -> Check:
    task = demo.three_finger_lift(0)
    hip = np.stack([device.path[0] for device in task.devices])
    packed = hapjax.pack(task.scene, hip, 1 / rate)
    held, memory = hip.astype(packed.dtype), [packed.start]

    def work() -> None:
        memory[0] = packed.call(memory[0], held)
        packed.force(memory[0])

    for _ in range(200):
        work()
    late, worked, missed = loop(rate, seconds, True, work, told)
    figures = _figures(late, missed) | {"call_us": _percentiles(worked), "rate_hz": rate}
    whole = figures["lateness_us"]["p99.9"] + figures["call_us"]["p99.9"]
    figures["holds_hz"] = highest = highest_rate(whole)
    sentence = (
        f"three fingers on a cube: late by {figures['lateness_us']['p99.9']:.0f} us and busy for "
        f"{figures['call_us']['p99.9']:.0f} us (p99.9), {missed} of {len(late)} ticks missed at {rate:g} Hz; "
        f"up to {highest} Hz can be held"
    )
    # Of 10,000 ticks one may be missed.
    if highest >= rate and missed * 10_000 <= len(late):
        return Check("loop with a step", "good", sentence, figures=figures)
    advice = "see to the rest of this list, let nothing else run beside it, or take a lower rate"
    return Check("loop with a step", "poor", sentence, advice, figures)


def highest_rate(whole: float) -> int:
    """The highest of the usual rates (Hz) whose period leaves room for `whole` us of lateness and work; 0: none."""
    return max((rate for rate in RATES if 1e6 / rate > whole), default=0)


def loop(
    rate: float,
    seconds: float,
    privileged: bool,
    work: Callable[[], Any] = lambda: None,
    told: Callable[[], Any] = lambda: None,
) -> tuple[np.ndarray, np.ndarray, int]:
    """How late each tick was and how long its work took, us, and how many were missed; `told` is called after each."""
    ticks = max(1, round(rate * seconds))
    late, worked = np.zeros(ticks), np.zeros(ticks)
    with ExitStack() as stack:
        stack.enter_context(uncollected())
        if privileged:
            stack.enter_context(undisturbed())
        pacer = Pacer(round(1e9 / rate), MonotonicClock())
        for tick in range(ticks):
            late[tick] = pacer.wait() * 1e-3
            began = time.perf_counter_ns()
            work()
            worked[tick] = (time.perf_counter_ns() - began) * 1e-3
            told()
    return late, worked, pacer.missed


def _idle(name: str, rate: float, seconds: float, privileged: bool) -> Check:
    with following(seconds, apart=True) as advance:
        late, _, missed = loop(rate, seconds, privileged, told=each_tick(advance, name, rate))
    figures = _figures(late, missed)
    lateness = figures["lateness_us"]
    sentence = (
        f"late by {lateness['p50']:.1f} us (p50), {lateness['p99.9']:.0f} us (p99.9), {lateness['max']:.0f} us (max); "
        f"{missed} of {len(late)} ticks missed at {rate:g} Hz"
    )
    # Half a period is left for the work.
    good = lateness["p99.9"] < 5e5 / rate
    advice = (
        "" if good or not privileged else "let nothing else run beside it; see privileges, kernel, governor"
    )
    return Check(name, "good" if good else "poor", sentence, advice, figures)


def _figures(late: np.ndarray, missed: int) -> dict[str, Any]:
    return {"lateness_us": _percentiles(late), "ticks": len(late), "missed": missed}


def _percentiles(values: np.ndarray) -> dict[str, float]:
    p50, p99, p999 = np.percentile(values, [50, 99, 99.9]).tolist()
    return {"p50": p50, "p99": p99, "p99.9": p999, "max": float(values.max())}
