"""A Falcon that is not there, on a USB bus that is not there: for tests, and to try things without one."""

import errno
from array import array
from collections import deque
from enum import Enum
from types import SimpleNamespace
from typing import Any

import numpy as np
import usb.backend
import usb.core

from ..operator import Operator
from ..realtime import Clock, MonotonicClock
from .line import PRODUCT, VENDOR
from .packets import encode
from .processor import Processor

_BAUD = {0x4138: 9600, 0x15: 142857, 2: 1500000}
_SIZE, _STATUS = 64, bytes((0x01, 0x60))
_CLEAR_TO_SEND = 0x10
_SETTLED = 5_000_000  # ns from a reset until the line is clear to send
_THINKS = 100_000  # ns before an answer
_CONFIGURED = 5000  # ms that Linux gives a device to be configured


class Fault(Enum):
    """How an emulated Falcon can misbehave."""

    SHORT_PACKETS = "its packets come in pieces"
    GARBAGE = "random bytes come instead of its own"
    SILENCE = "the USB chip goes on, but the processor says nothing"
    TIMEOUT = "nothing can be read over USB"
    DEAF = "the USB chip answers no request to itself"
    UNPLUG = "the cable is out"
    WRONG_ECHO = "the boot loader echoes another byte now and then"
    HOMING_LOST = "the legs do not know where they are"
    CORRUPT = "packets are whole, but their numbers are random"
    POWER = "the processor has no power"
    FORBIDDEN = "the user may not open it"
    BUSY = "another program has it"


class EmulatedFalcon:
    """A Falcon: the USB chip, and a `Processor` behind it.

    **Arguments:** `runs`: whether firmware runs already; `hand` as for `Processor`; `serial` number; `seed` of what is
    random in faults; `clock`: `None` is the computer's own.

    **Attributes:** `faults`: the set of those that are on now; `processor`; `configuration` of USB, 0: none; `requests`: the
    chip's control requests so far, (bRequest, wValue); `written`: what was sent to the processor so far.
    """

    def __init__(
        self,
        runs: bool = True,
        hand: Operator | None = None,
        serial: str = "FT000001",
        seed: int = 0,
        clock: Clock | None = None,
    ):
        self.clock = clock or MonotonicClock()
        self.processor = Processor(self.clock, runs, hand)
        self.serial, self.configuration = serial, 1
        self.faults: set[Fault] = set()
        self.requests: list[tuple[int, int]] = []
        self.written: list[bytes] = []
        self._random = np.random.default_rng(seed)
        self._coming: deque[tuple[int, int]] = deque()  # when each byte comes, ns, and the byte
        self._latency, self._baud, self._ready = 16_000_000, 9600, True
        self._last, self._kept, self._settles = 0, 0, 0

    def inject(self, fault: Fault) -> None:
        """Begin to misbehave."""
        self.faults.add(fault)
        if fault is Fault.POWER:
            self.processor.reset()
        elif fault is Fault.UNPLUG:
            self.processor.commands = np.zeros(3)

    def mend(self) -> None:
        """Behave again; what was lost with power is still lost."""
        self.faults.clear()

    def check_attached(self) -> None:
        """Raise what a computer raises where the cable is out."""
        if Fault.UNPLUG in self.faults:
            raise OSError(errno.ENODEV, "No such device")

    def check_answers(self, timeout: int) -> None:
        """Raise what a computer raises where the chip answers no request in `timeout` ms, or the cable is out."""
        self.check_attached()
        if Fault.DEAF in self.faults:
            self.clock.wait(self.clock.now() + timeout * 1_000_000)
            raise OSError(errno.ETIMEDOUT, "Operation timed out")

    def control(self, request: int, value: int) -> None:
        """A control request to the chip."""
        self.requests.append((request, value))
        if (request, value) == (0, 1):
            self._coming.clear()
        elif request == 3:
            self._baud = _BAUD.get(value, 0)
        elif request == 9:
            self._latency = value * 1_000_000
        elif (request, value) == (1, 0x100):
            self._ready = False
        elif (request, value) == (1, 0x101) and not self._ready:
            self._ready, self._settles = True, self.clock.now() + _SETTLED
            self.processor.reset()

    def write(self, data: bytes) -> None:
        """Bytes to the processor, which may answer."""
        self.check_attached()
        self.written.append(data)
        if Fault.POWER in self.faults:
            return
        loading = self.processor.mode == "loading"
        if Fault.HOMING_LOST in self.faults:
            self.processor.homed = 0
            self.processor._since = self.clock.now()
        answer = self.processor.receive(data, self._baud)
        if Fault.SILENCE in self.faults:
            return
        if Fault.CORRUPT in self.faults and self.processor.mode == "running" and not loading:
            answer = encode(self._random.integers(-32768, 32768, 3).tolist(), self.processor.homed)
        if Fault.WRONG_ECHO in self.faults and loading and answer:
            wrong = self._random.integers(len(answer))
            answer = answer[:wrong] + bytes([answer[wrong] ^ 0x10]) + answer[wrong + 1 :]
        begin, byte_time = self.clock.now() + _THINKS, 10**10 // max(self._baud, 1)
        self._coming.extend((begin + (n + 1) * byte_time, byte) for n, byte in enumerate(answer))

    def read(self, timeout: int) -> bytes:
        """A packet of the chip: its status and up to 62 bytes, once there are as many, or the latency timer has run off.

        `timeout` in ms; raises ETIMEDOUT after that.
        """
        self.check_attached()
        now = self.clock.now()
        gives_up = now + timeout * 1_000_000
        full = self._coming[_SIZE - 3][0] if len(self._coming) >= _SIZE - 2 else gives_up + 1
        sends = max(now, min(full, self._last + self._latency))
        if Fault.GARBAGE in self.faults:
            sends = max(now, self._last + 400_000)
        if sends > gives_up or Fault.TIMEOUT in self.faults:
            self.clock.wait(gives_up)
            raise OSError(errno.ETIMEDOUT, "Operation timed out")
        self.clock.wait(sends)
        self._last = self.clock.now()
        modem = _STATUS[0] | (_CLEAR_TO_SEND if self._last >= self._settles else 0)
        return bytes((modem, _STATUS[1])) + self._payload()

    def _payload(self) -> bytes:
        if Fault.GARBAGE in self.faults:
            self._coming.clear()
            return self._random.bytes(_SIZE - 2)
        ready = sum(time <= self._last for time, _ in self._coming)
        if Fault.SHORT_PACKETS in self.faults and ready > self._kept:  # something new: its end comes later
            self._kept = min(ready - 1, int(self._random.integers(1, 16)))
            ready -= self._kept
        else:
            self._kept = 0
        return bytes(self._coming.popleft()[1] for _ in range(min(ready, _SIZE - 2)))


_DESCRIPTOR = {"bLength": 0, "bDescriptorType": 0, "extra_descriptors": []}
_DEVICE = SimpleNamespace(
    **_DESCRIPTOR,
    **dict(
        bcdUSB=0x0110,
        bDeviceClass=0,
        bDeviceSubClass=0,
        bDeviceProtocol=0,
        bMaxPacketSize0=8,
        bcdDevice=0x0600,
    ),
    **dict(
        idVendor=VENDOR, idProduct=PRODUCT, iManufacturer=1, iProduct=2, iSerialNumber=3, bNumConfigurations=1
    ),
    **dict(address=1, bus=1, port_number=1, port_numbers=(1,), speed=2),
)
_CONFIGURATION = SimpleNamespace(
    **_DESCRIPTOR,
    wTotalLength=32,
    bNumInterfaces=1,
    bConfigurationValue=1,
    iConfiguration=0,
    bmAttributes=0x80,
    bMaxPower=45,
)
_INTERFACE = SimpleNamespace(
    **_DESCRIPTOR,
    **dict(
        bInterfaceNumber=0,
        bAlternateSetting=0,
        bNumEndpoints=2,
        bInterfaceClass=0xFF,
        bInterfaceSubClass=0xFF,
    ),
    **dict(bInterfaceProtocol=0xFF, iInterface=2),
)
_ENDPOINTS = [
    SimpleNamespace(
        **_DESCRIPTOR,
        bEndpointAddress=address,
        bmAttributes=2,
        wMaxPacketSize=_SIZE,
        bInterval=0,
        bRefresh=0,
        bSynchAddress=0,
    )
    for address in (0x81, 0x02)
]


class EmulatedUsb(usb.backend.IBackend):
    """A backend of pyusb for a USB bus with emulated Falcons on it: `Falcon(backend=EmulatedUsb(EmulatedFalcon()))`."""

    def __init__(self, *falcons: EmulatedFalcon):
        self.falcons = falcons

    def enumerate_devices(self):
        """Those whose cable is in."""
        return [falcon for falcon in self.falcons if Fault.UNPLUG not in falcon.faults]

    def get_device_descriptor(self, dev):
        """The same for all but the address."""
        return SimpleNamespace(**vars(_DEVICE) | {"address": self.falcons.index(dev) + 1})

    def get_configuration_descriptor(self, dev, config):
        """The one of an FT232R."""
        if config:
            raise IndexError(config)
        return _CONFIGURATION

    def get_interface_descriptor(self, dev, intf, alt, config):
        """The one of an FT232R."""
        if intf or alt or config:
            raise IndexError(intf)
        return _INTERFACE

    def get_endpoint_descriptor(self, dev, ep, intf, alt, config):
        """The two of an FT232R."""
        return _ENDPOINTS[ep]

    def open_device(self, dev):
        """The Falcon is its own handle."""
        for fault, code in ((Fault.FORBIDDEN, errno.EACCES), (Fault.BUSY, errno.EBUSY)):
            if fault in dev.faults:
                raise usb.core.USBError(fault.value, None, code)
        _asked(dev.check_attached)
        return dev

    def close_device(self, dev_handle):
        """Nothing is held."""

    def set_configuration(self, dev_handle, config_value):
        """There is only one. Linux asks the device for it."""
        _asked(lambda: dev_handle.check_answers(_CONFIGURED))
        dev_handle.configuration = config_value

    def get_configuration(self, dev_handle):
        """The one that the system has set when the device was attached, as a rule."""
        _asked(dev_handle.check_attached)
        return dev_handle.configuration

    def claim_interface(self, dev_handle, intf):
        """No one else is there."""
        _asked(dev_handle.check_attached)

    def release_interface(self, dev_handle, intf):
        """No one else is there."""

    def is_kernel_driver_active(self, dev_handle, intf):
        """No kernel knows of it."""
        return False

    def bulk_write(self, dev_handle, ep, intf, data, timeout):
        """To the processor."""
        _asked(lambda: dev_handle.write(data.tobytes()))
        return len(data)

    def bulk_read(self, dev_handle, ep, intf, buff, timeout):
        """From the chip."""
        packet = _asked(lambda: dev_handle.read(timeout))
        buff[: len(packet)] = array("B", packet)
        return len(packet)

    def ctrl_transfer(self, dev_handle, bmRequestType, bRequest, wValue, wIndex, data, timeout):
        """The chip's requests, and that for a text that describes the device."""
        _asked(lambda: dev_handle.check_answers(timeout))
        if bmRequestType == 0x40:
            dev_handle.control(bRequest, wValue)
            return 0
        text = [b"\x09\x04", *(s.encode("utf-16-le") for s in ("FTDI", "FALCON HAPTIC", dev_handle.serial))][
            wValue & 0xFF
        ]
        described = bytes((len(text) + 2, 3)) + text
        data[: len(described)] = array("B", described)
        return len(described)


def _asked(question: Any) -> Any:
    """What a question comes to, with errors as pyusb has them."""
    try:
        return question()
    except OSError as error:
        kind = usb.core.USBTimeoutError if error.errno == errno.ETIMEDOUT else usb.core.USBError
        raise kind(error.strerror, None, error.errno) from None
