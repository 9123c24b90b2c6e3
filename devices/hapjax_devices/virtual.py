"""A haptic device that is not there, with the faults of one that is."""

from math import hypot, isfinite, trunc

import numpy as np
from jaxtyping import Float

from hapjax import InputError

from .device import DeviceClosed, DeviceError
from .operator import Hand, Operator

ENCODER_STEP = 3e-5  # m
FORCE_LIMIT = 8.5  # N
FORCE_STEP = FORCE_LIMIT / 4095  # N: a signed command of 13 bits


class VirtualDevice:
    """A device in the hand of an `Operator`; see `Device`.

    Positions come in steps of `resolution` (m) and one sample late: what is read is what the encoders
    latched at the sample before, as over a bus. Forces come in steps of `force_step` (N) an axis, and the
    norm is limited to `force_limit` (N). Each write carries the hand on by one `period` (s).

    **Arguments:** `path` (T, 3) m, `period` s and `hand` as for `Operator`. `gimbal` (G,) rad, the angles of the
    fingertip's gimbal: one a period from `open` on, the last one kept; `None`: 0 always. `again`: path and angles begin
    anew when they have ended.

    **Attributes:** `path`; `operator`, the hand while the device is open; `output` (3,) N, the force that
    it puts out.
    """

    def __init__(
        self,
        path: Float[np.ndarray, "T 3"],
        period: float = 1e-3,
        hand: Hand | None = None,
        resolution: float = ENCODER_STEP,
        force_step: float = FORCE_STEP,
        force_limit: float = FORCE_LIMIT,
        gimbal: Float[np.ndarray, "G"] | None = None,
        again: bool = False,
    ):
        self.resolution, self.force_limit, self._force_step = resolution, force_limit, force_step
        self.path, self._period, self._hand, self._again = path, period, hand or Hand(), again
        self.gimbal = np.zeros(1) if gimbal is None else np.asarray(gimbal, np.float64)
        if self.gimbal.ndim != 1 or not self.gimbal.size or not np.isfinite(self.gimbal).all():
            raise InputError(f"gimbal has the shape {self.gimbal.shape}; allowed: (G,) finite angles in rad")
        self._operator: Operator | None = None
        self._sample = 0
        self._latched = np.zeros(3)
        self.output = np.zeros(3)
        Operator(path, period, self._hand)  # refuses a bad path now rather than when the device is opened

    @property
    def operator(self) -> Operator:
        """The hand that holds the device. **Raises:** `DeviceClosed` before `open` and after `close`."""
        if self._operator is None:
            raise DeviceClosed("the virtual device is not open")
        return self._operator

    def open(self) -> None:
        """Put the hand at the start of its path; see `Device.open`."""
        self._operator = Operator(self.path, self._period, self._hand, self._again)
        self._sample = 0
        self._latched = self._encode()
        self.output = np.zeros(3)

    def read(self) -> Float[np.ndarray, "3"]:
        """The position at the sample before; see `Device.read`."""
        if self._operator is None:
            raise DeviceClosed("the virtual device is not open")
        return self._latched

    def read_gimbal(self) -> float:
        """The gimbal's angle, as late as the position; see `GimbalDevice.read_gimbal`."""
        if self._operator is None:
            raise DeviceClosed("the virtual device is not open")
        sample, count = max(self._sample - 1, 0), len(self.gimbal)
        return float(self.gimbal[sample % count if self._again else min(sample, count - 1)])

    def write(self, force: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """Push the hand for one period; see `Device.write`."""
        operator = self.operator
        self.output = self._driven(np.asarray(force, np.float64))
        self._latched = self._encode()
        operator.advance(self.output)
        self._sample += 1
        return self.output

    def close(self) -> None:
        """Let go of the hand; see `Device.close`."""
        self._operator = None
        self.output = np.zeros(3)

    def __enter__(self) -> "VirtualDevice":
        self.open()
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    def _encode(self) -> Float[np.ndarray, "3"]:
        return np.rint(self.operator.position / self.resolution) * self.resolution

    def _driven(self, force: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        x, y, z = force.tolist()  # NumPy's calls take longer for three numbers
        size, most, step = hypot(x, y, z), self.force_limit, self._force_step
        if not (isfinite(x) and isfinite(y) and isfinite(z)):
            raise DeviceError(f"the force is {force.tolist()} N; allowed: finite numbers")
        part = most / size if size > most else 1.0
        steps = part * x / step, part * y / step, part * z / step
        driven = [round(n) * step for n in steps]
        if hypot(*driven) > most:  # rounded up over the limit
            driven = [trunc(n) * step for n in steps]
        return np.array(driven)
