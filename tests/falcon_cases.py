"""An emulated Falcon on a clock that only tests move, and random runs of it with faults."""

from dataclasses import dataclass, field

import numpy as np

from hapjax_devices import Falcon
from hapjax_devices.falcon.emulator import EmulatedFalcon, EmulatedUsb

TICK = 1_000_000  # ns
STATES = ("closed", "connecting", "booting", "uploading", "homing", "running")
PUSH = np.array([1.0, -2.0, 3.0])


class SteppedClock:
    """A clock that stands still but for who waits for it; see `hapjax_devices.realtime.Clock`."""

    def __init__(self):
        self.time = 0

    def now(self) -> int:
        return self.time

    def wait(self, deadline: int) -> None:
        self.time = max(self.time, deadline)


@dataclass
class Rig:
    """A driver and its emulated Falcon."""

    runs: bool = True
    firmware: str | None = None
    homing_time: float = 2.0
    seed: int = 0
    clock: SteppedClock = field(default_factory=SteppedClock)
    said: list[str] = field(default_factory=list)

    def __post_init__(self):
        self.emulated = EmulatedFalcon(self.runs, seed=self.seed, clock=self.clock)
        self.usb = EmulatedUsb(self.emulated)
        self.falcon = Falcon(
            self.firmware,
            homing_time=self.homing_time,
            notify=self.said.append,
            backend=self.usb,
            clock=self.clock,
        )

    def tick(self, force=PUSH) -> np.ndarray:
        """What a servo loop does in a millisecond: read, write; returns the position."""
        self.clock.wait((self.clock.time // TICK + 1) * TICK)
        place = self.falcon.read()
        self.falcon.write(np.asarray(force, float))
        return place
