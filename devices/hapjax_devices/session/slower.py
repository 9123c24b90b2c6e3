"""A device that is slower than the loop."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float

from hapjax import InputError

from ..device import Device, GimbalDevice, RecoverableDevice


class Slower:
    """A device that is read and written at a rate of its own, its position held in between; see `Device`.

    A force that is none is passed on at once. What else the device can do (come back after a fault, read a gimbal), this
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
            self.recover = device.recover
        if isinstance(device, GimbalDevice):
            self.read_gimbal = self._read_gimbal
        self._forget()

    def open(self) -> None:
        """Open the device; see `Device.open`."""
        self.device.open()
        self._forget()

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
        if self._due or not np.any(force):
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

    def _read_gimbal(self) -> float:
        return self._angle

    def _forget(self) -> None:
        self._turns, self._due, self._position = 0.0, True, None
        self._output, self._angle = np.zeros(3), 0.0
