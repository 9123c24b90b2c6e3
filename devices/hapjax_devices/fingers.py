"""The devices of a servo loop, of which one that fails does not stop the others."""

from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Shaped

from .device import Device, DeviceError, RecoverableDevice

RECOVERY = (
    0.01  # s between two steps of a device on its way back: each may hold the loop up by a millisecond or two
)
RAMP = 0.5  # s, in which the force comes up after a fault: the finger may be back deep inside an object


class DeviceFault(NamedTuple):
    """A fault of a device while the loop ran: at which `tick`, of which `finger`, a `sentence` that says what, and from
    which tick on it was `back` (`None`: not before the end)."""

    tick: int
    finger: int
    sentence: str
    back: int | None = None


class Fingers:
    """Reads and writes the devices of a loop, one a finger.

    While a `RecoverableDevice` has a fault, its finger stays where it was and gets no force; the device is asked to
    come back every 10 ms, and its force then rises over half a second. A fault of any other device ends the loop.

    **Arguments:** `devices`, open; `rate` of the loop, Hz.

    **Attributes:** `faults`, all so far.
    """

    def __init__(self, devices: Sequence[Device], rate: float):
        self._devices = devices
        self._recoverable = [device if isinstance(device, RecoverableDevice) else None for device in devices]
        self._every, self._ramp = max(1, round(RECOVERY * rate)), max(1, round(RAMP * rate))
        self._down: dict[int, int] = {}  # the place in `faults` of each finger whose device is down
        self._ramped: dict[int, int] = {}  # since when the force of a finger rises
        self._tick = 0
        self.faults: list[DeviceFault] = []

    @property
    def down(self) -> int:
        """A bit for each finger whose device is down."""
        return sum(1 << finger for finger in self._down)

    def read(self, tick: int, hip: Shaped[np.ndarray, "F 3"]) -> None:
        """Put where the fingers are, m, into `hip`; one whose device is down stays where it was."""
        self._tick = tick
        for finger, device in enumerate(self._devices):
            if finger in self._down and not self._is_back(tick, finger):
                continue
            try:
                hip[finger] = device.read()
            except DeviceError as error:
                self._failed(tick, finger, error)

    def write(self, tick: int, force: Float[np.ndarray, "F 3"], output: Float[np.ndarray, "F 3"]) -> None:
        """Push with `force`, N; what is put out goes into `output`, N."""
        for finger, device in enumerate(self._devices):
            if finger in self._down:
                output[finger] = 0
                continue
            try:
                output[finger] = device.write(self._risen(tick, finger) * force[finger])
            except DeviceError as error:
                output[finger] = 0
                self._failed(tick, finger, error)

    @contextmanager
    def let_go(self) -> Iterator[None]:
        """Write no force to every device at the end of the block, to the others also where one fails."""
        with ExitStack() as stack:
            for finger in range(len(self._devices)):
                stack.callback(self._release, finger)
            yield

    def _release(self, finger: int) -> None:
        if finger in self._down:
            return
        try:
            self._devices[finger].write(np.zeros(3))
        except DeviceError as error:
            self._failed(self._tick, finger, error)

    def _failed(self, tick: int, finger: int, error: DeviceError) -> None:
        if self._recoverable[finger] is None:
            raise error
        self._down[finger] = len(self.faults)
        self.faults.append(DeviceFault(tick, finger, str(error)))

    def _is_back(self, tick: int, finger: int) -> bool:
        at, device = self._down[finger], self._recoverable[finger]
        assert device is not None
        if (tick - self.faults[at].tick) % self._every or not device.recover():
            return False
        self.faults[at] = self.faults[at]._replace(back=tick)
        del self._down[finger]
        self._ramped[finger] = tick
        return True

    def _risen(self, tick: int, finger: int) -> float:
        """How much of its force a finger gets, 0 to 1."""
        if finger not in self._ramped:
            return 1.0
        part = (tick - self._ramped[finger]) / self._ramp
        if part >= 1:
            del self._ramped[finger]
        return min(1.0, part)
