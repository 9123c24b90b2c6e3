"""The serial line to the Falcon, through the FTDI FT232R behind its USB plug."""

import errno
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

from hapjax.extras import need

from ..device import DeviceError
from ..driver import State

VENDOR, PRODUCT = 0x0403, 0xCB48
_OUT, _IN, _SIZE = 0x02, 0x81, 64
_STATUS = 2  # bytes at the head of whatever comes in: modem status and line status
_CLEAR_TO_SEND = 0x10  # of the modem status
_TO_CHIP = 0x40  # bmRequestType of a request to the chip itself

_TIMEOUT = 5  # ms: the chip sends its status every millisecond, whatever the Falcon does
PATIENT, HURRIED = 100, 5  # ms for an answer of the chip itself; the second where a loop waits
_POLL = 1  # ms

RULES = Path(__file__).parents[1] / "udev" / "60-hapjax.rules"


class Request(NamedTuple):
    """A control request to the chip: bRequest and wValue."""

    request: int
    value: int


PURGE_RECEIVE, PURGE_TRANSMIT = Request(0, 1), Request(0, 2)
BAUD_9600, BAUD_142857, BAUD_1500000 = Request(3, 0x4138), Request(3, 0x15), Request(3, 2)
FRAME_8N1, NO_FLOW_CONTROL = Request(4, 8), Request(2, 0)
RTS_LOW, DTR_LOW, DTR_HIGH = Request(1, 0x200), Request(1, 0x100), Request(1, 0x101)


def latency(milliseconds: int) -> Request:
    """How long the chip waits for more bytes, 1 to 255 ms, before it sends what it has, or its status alone."""
    return Request(9, milliseconds)


FOR_PACKETS = (latency(1), BAUD_1500000, PURGE_RECEIVE, PURGE_TRANSMIT)
FOR_BOOTING = (
    *(PURGE_RECEIVE, PURGE_TRANSMIT, latency(16), BAUD_9600, FRAME_8N1, NO_FLOW_CONTROL),
    *(RTS_LOW, DTR_LOW, DTR_HIGH),  # which resets the processor
)


class Attached(NamedTuple):
    """A Falcon that is attached: its `serial` number, `bus` and `address`; where it cannot be asked, a sentence says the
    `problem`."""

    serial: str | None
    bus: int | None
    address: int | None
    problem: str | None


def attached_falcons(backend: Any = None) -> list[Attached]:
    """The Falcons that are attached to this computer.

    **Arguments:** `backend`, a `usb.backend.IBackend` of pyusb; `None`: libusb.

    **Raises:** `DeviceError` where USB cannot be asked; `InputError` where pyusb is not installed.
    """
    found = []
    for device in _all(backend, PATIENT):
        try:
            serial, problem = _serial(device), None
        except DeviceError as error:
            serial, problem = None, str(error)
        found.append(Attached(serial, device.bus, device.address, problem))
    return found


class Line:
    """An open line: bytes out, bytes in. Whatever goes wrong is a `DeviceError` of one sentence.

    **Arguments:** `serial` number of the Falcon that is meant; `None`: the only one that is attached. `backend` as for
    `attached_falcons`. `patience`: how many ms the chip itself is given for each answer.
    """

    def __init__(self, serial: str | None = None, backend: Any = None, patience: int = PATIENT):
        self._device = _chosen(serial, backend, patience)
        self.name = named(serial)
        self.clear_to_send = False
        util = need("usb.util", "falcon")
        self._buffer = util.create_buffer(_SIZE)
        try:
            if _kernel_drives(self._device):
                self._device.detach_kernel_driver(0)
            if not _is_configured(self._device):
                self._device.set_configuration()
            util.claim_interface(self._device, 0)
        except OSError as error:
            self.close()
            raise _told(error, self.name) from error

    def requested(self, state: State, *requests: Request) -> Iterator[State]:
        """Send control requests to the chip, in steps that each yield `state`: each takes a frame of USB or two."""
        for request, value in requests:
            try:
                self._device.ctrl_transfer(_TO_CHIP, request, value)
            except OSError as error:
                raise _told(error, self.name) from error
            yield state

    def write(self, data: bytes) -> None:
        """Send bytes to the Falcon."""
        try:
            sent = self._device.write(_OUT, data, _TIMEOUT)
        except OSError as error:
            raise _told(error, self.name) from error
        if sent != len(data):
            raise DeviceError(f"{self.name} took {sent} of {len(data)} bytes")

    def read(self) -> bytes:
        """What has come from the Falcon, at most 62 bytes; nothing from the chip for 5 ms is a `DeviceError`."""
        try:
            return self._received(_TIMEOUT)
        except OSError as error:
            raise _told(error, self.name) from error

    def poll(self) -> bytes:
        """What has come from the Falcon, at most 62 bytes, after a wait of 1 ms at most; nothing where nothing came."""
        try:
            return self._received(_POLL)
        except OSError as error:
            if error.errno == errno.ETIMEDOUT:
                return b""
            raise _told(error, self.name) from error

    def close(self) -> None:
        """Let go of the USB device. Never raises, and closing twice is no error."""
        try:
            need("usb.util", "falcon").dispose_resources(self._device)
        except OSError:
            pass  # it is gone, so there is nothing to let go of

    def _received(self, timeout: int) -> bytes:
        length = self._device.read(_IN, self._buffer, timeout)
        if length:
            self.clear_to_send = bool(self._buffer[0] & _CLEAR_TO_SEND)
        return self._buffer[_STATUS:length].tobytes()


def _all(backend: Any, patience: int) -> list[Any]:
    core = need("usb.core", "falcon")
    try:
        found = list(core.find(find_all=True, backend=backend, idVendor=VENDOR, idProduct=PRODUCT))
    except core.NoBackendError:
        raise DeviceError("USB cannot be used: the library libusb-1.0 is not installed") from None
    except OSError as error:
        raise _told(error, "USB") from error
    for device in found:
        device.default_timeout = patience
    return found


def _chosen(serial: str | None, backend: Any, patience: int) -> Any:
    devices = _all(backend, patience)
    if not devices:
        raise DeviceError("no Falcon is attached, or it has no power")
    if serial is None:
        if len(devices) > 1:
            each = ", ".join(_serial(device) or "without a number" for device in devices)
            raise DeviceError(
                f"{len(devices)} Falcons are attached; say which is meant by its serial number: {each}"
            )
        return devices[0]
    numbers, problem = [], None
    for device in devices:
        try:
            numbers.append(_serial(device))
        except DeviceError as error:  # of one that may not be meant
            problem = error
            continue
        if numbers[-1] == serial:
            return device
    raise problem or DeviceError(f"{named(serial)} is not attached; attached: {', '.join(map(str, numbers))}")


def _serial(device: Any) -> str | None:
    util = need("usb.util", "falcon")
    try:
        # Asked for first: pyusb, asked for the text at once, does not say why there is none.
        languages = util.get_langids(device)
        return util.get_string(device, device.iSerialNumber, languages[0]) if languages else None
    except OSError as error:
        raise _told(error, "a Falcon") from error
    finally:
        # Asked only for its name: whoever opens it does so afresh.
        util.dispose_resources(device)


def named(serial: str | None) -> str:
    """What a Falcon is called in sentences for the user."""
    return "the Falcon" if serial is None else f"the Falcon {serial}"


def _kernel_drives(device: Any) -> bool:
    try:
        return device.is_kernel_driver_active(0)
    except NotImplementedError:  # libusb cannot ask on Windows, where its own driver is the only one
        return False


def _is_configured(device: Any) -> bool:
    """Whether the system has configured the device, as it does when it is attached. To have it done again may take seconds
    where the chip does not answer, whatever is asked for."""
    try:
        device.get_active_configuration()
    except OSError as error:
        if error.errno is not None:
            raise
        return False  # pyusb's own word
    return True


def _told(error: OSError, name: str) -> DeviceError:
    if error.errno in (errno.EACCES, errno.EPERM):
        said = f"may not be opened by this user: copy {RULES} to /etc/udev/rules.d, and plug it in again"
    elif error.errno == errno.EBUSY:
        said = "is in use by another program"
    elif error.errno in (errno.ENODEV, errno.ENOENT, errno.ESHUTDOWN):
        said = "is not attached any more"
    elif error.errno == errno.ETIMEDOUT:
        said = "does not answer: nothing came over USB in time"
    else:
        said = f"cannot be reached over USB ({error.strerror or error})"
    return DeviceError(f"{name} {said}")
