"""The Falcon's firmware: the user's file, and its way into the device's boot loader.

The processor's boot ROM (TI TMS320F2811, serial boot mode) finds the line's speed from an `A`, then takes a program and
echoes every byte. The program is not part of this package: it comes with the vendor's driver.
"""

from collections.abc import Callable, Generator, Iterator
from functools import partial
from pathlib import Path

from hapjax import InputError

from ..device import DeviceError
from ..driver import State
from ..realtime import Clock
from . import line as ftdi
from .line import Line

SMALLEST, LARGEST = (
    1 << 10,
    36 << 10,
)  # bytes: the processor has 18 K words of memory; known images have 7 to 9 kB
_KEY, _ANSWER = b"\x0aC\r", b"\x0aD,\r"
_AUTOBAUD = b"A"
_CHUNK = 62
_TRIES, _LOADS = 100, 10
_ANSWER_TIME, _ECHO_TIME = 0.05, 1.0  # s
_MOST = 1024  # bytes that are listened to in one go: a line that babbles is no answer

Steps = Generator[State, None, bytes]


def read_firmware(file: Path) -> bytes:
    """The firmware in a file. **Raises:** `InputError` where it cannot be read or has a size that no firmware has."""
    try:
        with open(file, "rb") as opened:
            image = opened.read(LARGEST + 1)
    except OSError as error:
        raise InputError(f"firmware {file} cannot be read: {error.strerror}") from error
    if not SMALLEST <= len(image) <= LARGEST:
        size = f"more than {LARGEST}" if len(image) > LARGEST else len(image)
        raise InputError(
            f"firmware {file} has {size} bytes; allowed: {SMALLEST} to {LARGEST}, usually 7000 to 9000"
        )
    return image


def upload(line: Line, image: bytes, clock: Clock) -> Iterator[State]:
    """Put firmware into a Falcon, in steps of a millisecond or two; each yields `"booting"` or `"uploading"`.

    **Raises:** `DeviceError` where the boot loader does not answer, or has got the firmware wrong ten times.
    """
    for _ in range(_LOADS):
        yield from _knock(line, clock)
        if (yield from _load(line, image, clock)):
            yield from line.requested("uploading", *ftdi.FOR_PACKETS)
            return
    raise DeviceError(
        f"{line.name} did not take its firmware: {_LOADS} times its boot loader echoed something else"
    )


def _knock(line: Line, clock: Clock) -> Iterator[State]:
    """Reset the processor into its boot loader, and ask until it answers."""
    yield from line.requested("booting", *ftdi.FOR_BOOTING)
    yield from _collected(line, clock, "booting", _ECHO_TIME, lambda _: line.clear_to_send)
    for _ in range(_TRIES):
        line.write(_KEY)
        answer = yield from _collected(line, clock, "booting", _ANSWER_TIME, lambda got: _ANSWER in got)
        if _ANSWER in answer:
            return
    raise DeviceError(
        f"{line.name} runs no firmware, and its boot loader does not answer: switch it off and on again"
    )


def _load(line: Line, image: bytes, clock: Clock) -> Generator[State, None, bool]:
    """Send the image; whether every byte of it came back."""
    yield from line.requested("uploading", ftdi.DTR_LOW, ftdi.BAUD_142857)
    for chunk in (_AUTOBAUD, *(image[at : at + _CHUNK] for at in range(0, len(image), _CHUNK))):
        line.write(chunk)
        whole = partial(_is_long, len(chunk))
        echo = yield from _collected(line, clock, "uploading", _ECHO_TIME, whole)
        if echo != chunk:
            return False
    return True


def _is_long(length: int, received: bytes) -> bool:
    return len(received) >= length


def _collected(
    line: Line, clock: Clock, state: State, seconds: float, done: Callable[[bytes], bool]
) -> Steps:
    """What comes until it is `done`, or for so many seconds."""
    received, deadline = b"", clock.now() + round(1e9 * seconds)
    while not done(received) and clock.now() < deadline and len(received) < _MOST:
        received += line.poll()
        yield state
    return received
