"""An emulated Falcon on a clock that only tests move, in a loop beside another device, and random runs with faults.

`python tests/falcon_cases.py 10000` makes as many random runs.
"""

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from hapjax_devices import Falcon
from hapjax_devices.event import Diary
from hapjax_devices.falcon.emulator import EmulatedFalcon, EmulatedUsb, Fault
from hapjax_devices.falcon.processor import synthetic_firmware
from hapjax_devices.fingers import Fingers
from hapjax_devices.safety import Safety

PUSH = np.array([1.0, -2.0, 3.0])
# What does no harm once the line is open and the firmware runs; a fault in any other way ends the force.
HARMLESS = {Fault.SHORT_PACKETS, Fault.WRONG_ECHO, Fault.DEAF, Fault.FORBIDDEN, Fault.BUSY}
# Ticks: in the first, a fault is still behind a reply that came before it; in the second it shows; then comes no force.
HIDDEN = 2
LONGEST = 12_000_000  # ns that any call in a loop may take: two packets that are not taken, or a wait for a late one


class SteppedClock:
    """A clock that stands still but for who waits for it; see `hapjax_devices.realtime.Clock`."""

    def __init__(self):
        self.time = 0

    def now(self) -> int:
        return self.time

    def wait(self, deadline: int) -> None:
        self.time = max(self.time, deadline)


class Rig:
    """A driver and its emulated Falcon."""

    def __init__(self, runs=True, firmware: str | Path | None = None, seed=0):
        self.clock = SteppedClock()
        self.said: list[str] = []
        self.emulated = EmulatedFalcon(runs, seed=seed, clock=self.clock)
        self.falcon = Falcon(
            firmware,
            homing_time=2.0,
            notify=self.said.append,
            backend=EmulatedUsb(self.emulated),
            clock=self.clock,
        )

    def pushes(self) -> bool:
        """Whether the emulated motors push."""
        return bool(self.emulated.processor.commands.any())

    def tick(self, force=PUSH) -> np.ndarray:
        """What a servo loop does in a millisecond: read, write; returns the position."""
        self.clock.wait((self.clock.time // 1_000_000 + 1) * 1_000_000)
        place = self.falcon.read()
        self.falcon.write(np.asarray(force, float))
        return place


class Other:
    """A device beside the Falcon: where it is told to be, and counts what is written to it."""

    force_limit, resolution = 8.0, 1e-5

    def __init__(self):
        self.reads = self.writes = 0

    def open(self): ...

    def read(self):
        self.reads += 1
        return np.zeros(3)

    def write(self, force):
        self.writes += bool(force.any())
        return force

    def close(self): ...

    def __enter__(self):
        return self

    def __exit__(self, *exception): ...


class Loop:
    """A Falcon and another device in a servo loop of 100 Hz that pushes both all the time."""

    def __init__(self, rig: Rig):
        self.rig, self.other = rig, Other()
        safety = Safety([8.0, 8.0], 100.0)
        for finger in range(2):  # both are in
            safety(-1, finger, (0.0, 0.0, 0.0))
        self.diary = Diary(100.0)
        self.fingers = Fingers([rig.falcon, self.other], 100.0, safety, self.diary)
        self.hip, self.output, self.ticks = np.zeros((2, 3)), np.zeros((2, 3)), 0

    def tick(self) -> None:
        """One tick, in which no call takes long, the other device goes on, and a force is there only while it should be."""
        rig = self.rig
        rig.clock.time += 10_000_000
        began = rig.clock.time
        self.fingers.read(self.ticks, self.hip)
        assert rig.clock.time - began <= LONGEST, f"{rig.falcon.state}: {rig.clock.time - began} ns"
        began = rig.clock.time
        self.fingers.write(self.ticks, np.array([PUSH, PUSH]), self.output)
        assert rig.clock.time - began <= LONGEST
        self.ticks += 1
        assert self.other.reads == self.other.writes == self.ticks
        assert np.isfinite(self.hip).all() and np.abs(self.hip[0]).max() < 0.002
        if rig.falcon.state != "running":
            assert not rig.pushes() and not self.output[0].any() and not rig.falcon.output.any()
        for fault in self.fingers.faults[-1:]:
            assert is_a_sentence(fault.sentence), fault.sentence

    def until(self, done, most=3000) -> None:
        """Go on until something is so; it has to be within so many ticks."""
        for _ in range(most):
            if done():
                return
            self.tick()
        raise AssertionError(f"after {most} ticks {self.rig.falcon.state}: {self.rig.falcon.fault}")

    def until_it_pushes(self) -> None:
        """Go on until the Falcon is back, and its force has risen again."""
        self.until(lambda: self.rig.falcon.state == "running")
        for _ in range(60):
            self.tick()
        np.testing.assert_allclose(self.output[0], PUSH, atol=0.01)
        assert self.rig.pushes()


def is_a_sentence(text: str | None) -> bool:
    """One line about one thing that says more than a code."""
    return text is not None and "\n" not in text and 20 < len(text) < 250 and "Falcon" in text


def random_run(seed: int, firmware: Path) -> set[tuple[str, Fault]]:
    """Faults at random times, several at once, and a Falcon that comes back after the last; returns which came when.

    **Raises:** `AssertionError` where that does not hold; see `Loop.tick`.
    """
    random = np.random.default_rng(seed)
    rig = Rig(runs=bool(random.integers(2)), firmware=firmware, seed=seed)
    rig.falcon.open()
    loop, came = Loop(rig), set()
    for _ in range(random.integers(1, 4)):
        for _ in range(random.integers(1, 30)):
            loop.tick()
        for fault in random.choice(np.array(Fault), random.integers(1, 3), replace=False):
            came.add((rig.falcon.state, fault))
            rig.emulated.inject(fault)
        harmless = rig.emulated.faults <= HARMLESS
        # In pieces, replies come a tick later anyhow.
        hidden = HIDDEN + (Fault.SHORT_PACKETS in rig.emulated.faults)
        for tick in range(random.integers(4, 60)):
            loop.tick()
            assert tick < hidden or harmless or not rig.pushes(), (
                f"{rig.emulated.faults} for {tick + 1} ticks"
            )
        rig.emulated.mend()
    loop.until_it_pushes()
    rig.falcon.close()
    assert not rig.pushes()
    return came


def main(runs: int) -> None:
    """Make random runs, and say how long they took."""
    began, came = time.perf_counter(), set()
    with tempfile.TemporaryDirectory() as folder:
        firmware = Path(folder) / "firmware.bin"
        firmware.write_bytes(synthetic_firmware(500))
        for seed in range(runs):
            try:
                came |= random_run(seed, firmware)
            except BaseException:
                print(f"in the run of seed {seed}:", file=sys.stderr)
                raise
    pairs = f"{len(came)} pairs of a state and a fault"
    print(f"{runs} runs with {pairs} in {time.perf_counter() - began:.0f} s: none hung, none failed")


if __name__ == "__main__":
    main(int(sys.argv[1]))
