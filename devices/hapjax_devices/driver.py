"""What drivers of hardware share: states, faults, and the way back to a running device."""

from abc import ABC, abstractmethod
from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from .device import DeviceClosed, DeviceError
from .realtime import Clock, MonotonicClock

RETRY = 200_000_000  # ns between attempts to get a device back

State = str


class Driver(ABC):
    """A `RecoverableDevice` that is `"closed"`, on its way, `"running"` or `"faulted"`, and says which in `state`.

    A driver says how it gets from closed to running, in short steps, how it reads, writes and lets go, and what it is
    called. It may raise `DeviceError` wherever something is wrong: no force is put out from then on.

    **Attributes:** `state`, of those three, or the way's own; `fault`, the sentence that says what went wrong,
    or what its user has to do for it to come back, else `None`;
    `output` (3,) N, the force that it puts out, in the world.
    """

    force_limit: float
    resolution: float
    name: str

    def __init__(self, clock: Clock | None):
        self._clock = clock or MonotonicClock()
        self._way: Iterator[State] | None = None  # back from a fault: a loop waits for each step
        self._again = 0
        self._longest: dict[
            State, tuple[int, str]
        ] = {}  # of a state: ns that `open` waits in it, and what it says then
        self.state: State = "closed"
        self.fault: str | None = None
        self.output = np.zeros(3)

    @abstractmethod
    def _steps(self) -> Iterator[State]:
        """Everything from closed to the first position, in steps of a millisecond or two that each yield the state."""

    @abstractmethod
    def _read(self) -> Float[np.ndarray, "3"]:
        """The newest position in the world, m."""

    @abstractmethod
    def _write(self, force: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """Push with a finite force, N; returns what is really put out."""

    @abstractmethod
    def _release(self) -> None:
        """Stop pushing as far as that is still possible, and let go of the hardware. Never raises."""

    def open(self) -> None:
        """Make the device ready; see `Device.open`. **Raises:** `DeviceError` with a sentence that says what is missing."""
        self.close()
        try:
            since = self._clock.now()
            for state in self._steps():
                if state != self.state:
                    self.state, since = state, self._clock.now()
                longest, said = self._longest.get(state, (np.inf, ""))
                if self._clock.now() > since + longest:
                    raise DeviceError(said)
        except BaseException as error:
            self._let_go("closed", str(error))
            raise
        self.state = "running"

    def recover(self) -> bool:
        """One short step on the way back from a fault; see `RecoverableDevice.recover`."""
        if self.state == "closed":
            raise DeviceClosed(f"{self.name} is not open")
        if self.state == "running":
            return True
        if self._way is None:
            if self._clock.now() < self._again:
                return False
            self._way = self._steps()
        try:
            self.state = next(self._way)
        except StopIteration:
            self._way, self.fault, self.state = None, None, "running"
        except DeviceError as error:
            self._let_go("faulted", str(error))
        return self.state == "running"

    def read(self) -> Float[np.ndarray, "3"]:
        """The newest position; see `Device.read`. A reply that is missing once is made up for by the one before it."""
        self._check_running()
        try:
            return self._read()
        except DeviceError as error:
            self._let_go("faulted", str(error))
            raise

    def write(self, force: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """Push with a force; see `Device.write`. One over the limits keeps its direction."""
        self._check_running()
        try:
            if not np.isfinite(force).all():
                raise DeviceError(
                    f"the force for {self.name} is {np.asarray(force).tolist()} N; allowed: finite numbers"
                )
            self.output = self._write(np.asarray(force, np.float64))
        except DeviceError as error:
            self._let_go("faulted", str(error))
            raise
        return self.output

    def close(self) -> None:
        """No force any more, and let go of it; see `Device.close`."""
        self._let_go("closed", None)

    def __enter__(self) -> "Driver":
        self.open()
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    def _check_running(self) -> None:
        if self.state != "running":
            raise DeviceClosed(f"{self.name} is not open" if self.fault is None else self.fault)

    def _let_go(self, state: State, fault: str | None) -> None:
        """Stop, let go, and remember why."""
        self._release()
        self._way, self.state, self.fault, self.output = None, state, fault, np.zeros(3)
        self._again = self._clock.now() + RETRY
