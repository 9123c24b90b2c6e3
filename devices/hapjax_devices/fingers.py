"""The devices of a servo loop, of which one that fails does not stop the others."""

import re
from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Shaped

from .device import Device, DeviceError, HoldingDevice, RecoverableDevice
from .event import Diary
from .safety import Safety

RECOVERY = (
    0.01  # s between two steps of a device on its way back: each may hold the loop up by a millisecond or two
)


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
    come back every 10 ms. A fault of any other device ends the loop.

    Entered, it opens the devices, and closes them all at the end, the others also where one fails.

    **Arguments:** `devices`; `rate` of the loop, Hz; `safety`, through which each force goes right before it is
    written; `diary`, for what happens.

    **Attributes:** `faults`, all so far.
    """

    def __init__(self, devices: Sequence[Device], rate: float, safety: Safety, diary: Diary):
        self._devices, self._safety, self._diary = devices, safety, diary
        self._recoverable = [device if isinstance(device, RecoverableDevice) else None for device in devices]
        self._every = max(1, round(RECOVERY * rate))
        self._down: dict[int, int] = {}  # the place in `faults` of each finger whose device is down
        self._told: dict[int, set[str]] = {}  # what was said of each of these since then
        self._tick = -1
        self.faults: list[DeviceFault] = []

    def __enter__(self) -> "Fingers":
        with ExitStack() as stack:
            for finger, device in enumerate(self._devices):
                device.open()
                stack.callback(self._stop, finger, device.close)
            self._opened = stack.pop_all()
        return self

    def __exit__(self, *exception) -> None:
        self._opened.__exit__(*exception)

    def let_in(self) -> None:
        """The next force of each finger is none, and the first of one that is let in, from where it is then."""
        self._safety.cut_all()
        for device in self._devices:
            if isinstance(device, HoldingDevice):
                device.forget()

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
                self._failed(finger, error)

    def write(self, tick: int, force: Shaped[np.ndarray, "F 3"], output: Float[np.ndarray, "F 3"]) -> None:
        """Push with `force`, N, as far as that is safe; what is put out goes into `output`, N."""
        wanted = force.tolist()
        for finger, device in enumerate(self._devices):
            if finger in self._down:
                output[finger] = 0
                continue
            try:
                output[finger] = device.write(self._safety(tick, finger, wanted[finger]))
            except DeviceError as error:
                output[finger] = 0
                self._failed(finger, error)

    @contextmanager
    def let_go(self) -> Iterator[None]:
        """Write no force to every device at the end of the block, to the others also where one fails."""
        with ExitStack() as stack:
            for finger in range(len(self._devices)):
                stack.callback(self._stop, finger, partial(self._quiet, finger))
            yield

    def _quiet(self, finger: int) -> None:
        # One that ended the loop may take this still; one that is recoverable has done it by itself.
        if finger not in self._down or self._recoverable[finger] is None:
            self._devices[finger].write(np.zeros(3))

    def _stop(self, finger: int, how: Callable[[], object]) -> None:
        """Do what stops a device. One that fails now is noted, but the loop is over: what it has done is not lost for it."""
        try:
            how()
        except DeviceError as error:
            if finger not in self._down:
                self._note(finger, error)

    def _failed(self, finger: int, error: DeviceError) -> None:
        self._safety.cut(finger)
        self._note(finger, error)
        if self._recoverable[finger] is None:
            raise error

    def _note(self, finger: int, error: DeviceError) -> None:
        self._down[finger], self._told[finger] = len(self.faults), set()
        self.faults.append(DeviceFault(self._tick, finger, str(error)))
        self._tell(finger, str(error))

    def _tell(self, finger: int, sentence: str) -> None:
        """Say what is wrong with a device, once while it is down: each attempt to get it back finds it anew."""
        gist = re.sub(r"-?\d+", "", sentence)  # what it counts or reads may be another thing each time
        if gist not in self._told[finger]:
            self._told[finger].add(gist)
            self._diary.say("fault", sentence, finger)

    def _is_back(self, tick: int, finger: int) -> bool:
        at, device = self._down[finger], self._recoverable[finger]
        assert device is not None
        if (tick - self.faults[at].tick) % self._every:
            return False
        if not device.recover():
            if (fault := getattr(device, "fault", None)) is not None:
                self._tell(finger, fault)
            return False
        self.faults[at] = self.faults[at]._replace(back=tick)
        del self._down[finger]
        self._diary.say("back", "the device is back; its force rises", finger)
        return True
