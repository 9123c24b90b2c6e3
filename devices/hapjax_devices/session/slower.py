"""A device that is slower than the loop."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from hapjax import InputError

from ..device import Device, GimbalDevice, RecoverableDevice


class Slower:
    """A `HoldingDevice`: a device that is read and written at a rate of its own, its position held in between.

    A force that ends is passed on at once. What else the device can do (come back after a fault, read a gimbal), this
    can.

    **Arguments:** the `device`; its `rate` in Hz, above 0 and at most that of the loop; the loop's rate, `of`, in Hz.

    **Raises:** `InputError` for a rate out of range.
    """

    recover: Callable[[], bool]
    read_gimbal: Callable[[], float]

    def __init__(self, device: Device, rate: float, of: float):
        if not 0 < rate <= of:
            raise InputError(
                f"rate of a device is {rate} Hz; allowed: above 0 and at most the loop's {of:g} Hz"
            )
        self.device, self.rate = device, rate
        self.force_limit, self.resolution = device.force_limit, device.resolution
        self._share = rate / of
        # As the device's own, for a loop asks whether a device has them.
        if isinstance(device, RecoverableDevice):
            self.recover = self._recover
        if isinstance(device, GimbalDevice):
            self.read_gimbal = self._read_gimbal
        self._begin()

    def open(self) -> None:
        """Open the device; see `Device.open`."""
        self.device.open()
        self._begin()

    def forget(self) -> None:
        """The next read is of the device itself; see `HoldingDevice.forget`."""
        self._position = None

    def read(self) -> Float[np.ndarray, "3"]:
        """Where the device was when it was last due; see `Device.read`."""
        self._turns += self._share
        self._due = self._turns >= 1 or self._position is None
        if self._due:
            self._position = self.device.read()  # a turn that fails is made good by the next
            self._turns %= 1
            if isinstance(self.device, GimbalDevice):
                self._angle = self.device.read_gimbal()
        assert self._position is not None
        return self._position

    def write(self, force: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """Push from the next turn on; returns what is put out now. See `Device.write`."""
        if self._due or (np.any(self._output) and not np.any(force)):
            self._output = self.device.write(force)
        return self._output

    def close(self) -> None:
        """Close the device; see `Device.close`."""
        self.device.close()

    def __enter__(self) -> "Slower":
        self.open()
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    @property
    def fault(self) -> str | None:
        """What is in the way of the device; see `RecoverableDevice`."""
        return getattr(self.device, "fault", None)

    def _recover(self) -> bool:
        assert isinstance(self.device, RecoverableDevice)
        self.forget()
        return self.device.recover()

    def _read_gimbal(self) -> float:
        return self._angle

    def _begin(self) -> None:
        self._turns, self._due, self._output, self._angle = 0.0, True, np.zeros(3), 0.0
        self.forget()
