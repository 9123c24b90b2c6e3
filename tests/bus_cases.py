"""A servo's end of the bus for tests, in their own process, or with no devices and no scene in one of its own:
python bus_cases.py RUN RATE FINGERS, until it is killed."""

import os
import sys
import time

import numpy as np

from hapjax_devices import About, TickPublisher
from hapjax_devices.bus.publisher import COUNTED
from hapjax_devices.realtime import MonotonicClock, Pacer


def about(name, rate=400.0, fingers=2, memory=11) -> About:
    """Fingers on one object, whose pose is at the end of the memory."""
    device = {"type": "VirtualDevice", "force_limit": 8.5, "resolution": 3e-5}
    places = (tuple(range(memory - 7, memory)),)
    return About(
        name,
        rate,
        fingers,
        fingers,
        memory,
        "float32",
        ("cube",),
        places,
        (device,) * fingers,
        "[object.cube]\n",
        {},
        "",
        os.getpid(),
        time.time_ns(),
        time.perf_counter_ns(),
    )


def numbers(tick, fingers=2, memory=11):
    """What the fingers of a tick have, all different: hip, gimbal, force, memory."""
    hip = (tick + np.arange(3 * fingers) / 7).reshape(fingers, 3).astype(np.float32)
    pose = [0.1 * tick, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0]
    held = np.concatenate([np.arange(memory - 7) / 9 + tick, pose])
    return hip, tick + np.arange(fingers) / 8, -hip.astype(float) / 3, held


NONE = (0,) * len(COUNTED)


def publish(publisher, ticks, down=0, counts=NONE, begin=None):
    """Ticks 2.5 ms apart, as fast as it can."""
    begin = time.perf_counter_ns() if begin is None else begin
    for tick in ticks:
        publisher.publish(tick, begin + tick * 2_500_000, 1.5, 20.25, counts, down, *numbers(tick))


def main(name: str, rate: float, fingers: int) -> None:
    """Publish at a rate, each tick with other numbers, until killed."""
    memory = 3 * fingers + 7  # forces, and a pose
    with TickPublisher(about(name, rate, fingers, memory)) as publisher:
        publisher.wait_for(1, 30.0)
        prepared = [numbers(tick, fingers, memory) for tick in range(1000)]
        pacer = Pacer(round(1e9 / rate), MonotonicClock())
        for tick in range(10**9):
            late = pacer.wait() * 1e-3
            now, counts = time.perf_counter_ns(), (pacer.missed, *NONE[1:])
            publisher.publish(tick, now, late, 0.0, counts, 0, *prepared[tick % 1000])


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]), int(sys.argv[3]))
