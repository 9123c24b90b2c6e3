"""What a haptic device is to the servo loop: a fingertip's position in, a force out."""

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float


class DeviceError(Exception):
    """A device could not do what it was asked; the family of all that goes wrong with one."""


class DeviceClosed(DeviceError):
    """A device was read or written while it was not open."""


@runtime_checkable
class Device(Protocol):
    """One fingertip. Everything is in SI units and in the world frame (z up).

    `with device:` opens it and closes it again. A device says of itself: `force_limit`, the largest norm of a
    force that it takes, N; `resolution`, the step of its positions, m.
    """

    force_limit: float
    resolution: float

    def open(self) -> None:
        """Make the device ready. **Raises:** `DeviceError` where that fails."""
        ...

    def read(self) -> Float[np.ndarray, "3"]:
        """The newest position of the fingertip, m. **Raises:** `DeviceError`."""
        ...

    def write(self, force: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """Push the finger with `force` (N) until the next write; returns the force that it really puts out.

        **Raises:** `DeviceError`.
        """
        ...

    def close(self) -> None:
        """Let go: no force any more. Closing twice is no error."""
        ...

    def __enter__(self) -> "Device": ...

    def __exit__(self, *exception) -> None: ...


@runtime_checkable
class RecoverableDevice(Device, Protocol):
    """A device that can come back after a fault while the loop goes on for the others.

    Of one with an attribute `fault`, a sentence that says what is in its way, else `None`, the loop tells that too.
    """

    def recover(self) -> bool:
        """One short step, of some milliseconds at most, on the way back; whether the device is ready again.

        A step that fails is no error: the next one begins anew. **Raises:** `DeviceClosed` where it is not open.
        """
        ...


@runtime_checkable
class HoldingDevice(Device, Protocol):
    """A device whose `read` may answer with a position from before, as one does that is slower than the loop."""

    def forget(self) -> None:
        """The next `read` answers where the finger is then: no force was put out for a while, and it has moved."""
        ...


@runtime_checkable
class GimbalDevice(Device, Protocol):
    """A device whose thimble hangs in an instrumented gimbal; a scene whose torsion is a gimbal needs them."""

    def read_gimbal(self) -> float:
        """The angle, rad, at the time of the last `read`, right-handed about the line from the earlier finger to the
        later.

        **Raises:** `DeviceError`.
        """
        ...
