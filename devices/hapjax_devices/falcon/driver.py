"""The driver of a Novint Falcon; see `Device`."""

import sys
from collections.abc import Callable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from hapjax import InputError

from ..device import DeviceError
from ..driver import Driver, State
from ..placement import Placement
from ..realtime import Clock
from . import line as ftdi
from .firmware import read_firmware, upload
from .kinematics import ARM, CENTRE, COUNT
from .line import Line
from .packets import BLUE, BUTTONS, GREEN, HOMED, HOMING, RED, Assembler, Packet, encode
from .stance import Stance, stance_of

FORCE_LIMIT = 8.0  # N
COMMAND_LIMIT = 4095  # above, a command wraps round to the other sign
COMMANDS = -1e4  # a torque of 1 N m
RESOLUTION = 4e-5  # m a count in the workspace's middle
AXES = np.array(
    [[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]
)  # world's right, away, up from the device's axes

_COLOURS = {"green": GREEN, "blue": BLUE, "red": RED}
_NONE = np.zeros(3)
_FASTEST = 4.0 / ARM / COUNT * 1e-9  # counts a nanosecond: no hand moves an arm's end at over 4 m/s
_JITTER = 60  # counts that a move may seem more, for a clock that is late
_PATIENCE = 2_000_000  # ns that an overdue reply is waited for
_POLLS = 8  # reads in one wait, whatever the clock says
_PROBES, _PROBE_TIME = 3, 30_000_000  # ns
_SILENCE = 100_000_000  # ns without a reply while it is homed

_HOMING = "is not homed: pull its grip all the way out, then push it all the way in"


def _say(sentence: str) -> None:
    print(sentence, file=sys.stderr, flush=True)


def let_go(serial: str | None, backend: Any = None) -> None:
    """Have a Falcon push no more whose process is gone: its protocol has no timeout that would do it.

    **Arguments:** `serial` and `backend` as for `Falcon`.

    **Raises:** `DeviceError` where it cannot be told.
    """
    line = Line(serial, backend)
    try:
        line.write(encode((0, 0, 0), HOMING))
    finally:
        line.close()


class Falcon(Driver):
    """A Novint Falcon on USB; see `Device` and `RecoverableDevice`. Needs the extra `falcon`.

    `open` finds it, gives it its firmware where none runs, and has the user home it. Its own frame is the world's as its
    user sees it, x to the right, y away and z up, its origin in the workspace's middle.

    **Arguments:**

    - `firmware`: the file of the vendor's firmware; `None` where it runs already.
    - `serial` number, where several are attached; `None`: the only one.
    - `placement` of that frame in the world.
    - `homing_time`: how many seconds `open` gives the user for homing, above 0.
    - `notify`: is called with a sentence for the user while it opens; by default it is printed to stderr. On the way back
      from a fault it is in `fault`, and the loop tells it.
    - `backend`, a `usb.backend.IBackend` of pyusb, and `clock`: both for tests; `None`: libusb, and the computer's own.

    **Attributes:** `state`: `"closed"`, `"connecting"`, `"booting"`, `"uploading"`, `"homing"`, `"running"` or `"faulted"`;
    `fault`, the sentence that says what went wrong, else `None`; `output` (3,) N, the force that it puts out in the
    world; `buttons`, whether each of its four is pressed.

    **Raises:** `InputError` for firmware that cannot be read or has a senseless size, and a `homing_time` out of range.
    """

    force_limit = FORCE_LIMIT
    resolution = RESOLUTION

    def __init__(
        self,
        firmware: Path | str | None = None,
        serial: str | None = None,
        placement: Placement | None = None,
        homing_time: float = 60.0,
        notify: Callable[[str], object] = _say,
        backend: Any = None,
        clock: Clock | None = None,
    ):
        if not 0 < homing_time < np.inf:
            raise InputError(f"homing_time is {homing_time} s; allowed: above 0")
        super().__init__(clock)
        self._image = None if firmware is None else read_firmware(Path(firmware))
        self._serial, self._backend, self._notify = serial, backend, notify
        self.name = ftdi.named(serial)
        self._longest = {"homing": (round(1e9 * homing_time), f"{self.name} {_HOMING}")}
        placement = placement or Placement()
        self._rotation = placement.rotation() @ AXES  # of the device's axes into the world
        self._origin = np.asarray(placement.position) - self._rotation @ CENTRE
        self._line: Line | None = None
        self.buttons = (False,) * 4
        self._lights = GREEN

    def light(self, *colours: str) -> None:
        """Light the LEDs of these `colours` (`"green"`, `"blue"`, `"red"`), and no others, from the next write on."""
        unknown = set(colours) - _COLOURS.keys()
        if unknown:
            raise InputError(f"the Falcon has no LED {min(unknown)!r}; allowed: {', '.join(_COLOURS)}")
        self._lights = sum(_COLOURS[colour] for colour in set(colours))

    def _release(self) -> None:
        line, self._line = self._line, None
        if line is not None:
            with suppress(DeviceError):
                line.write(encode((0, 0, 0), HOMING))
            line.close()

    # The way to a running device ------------------------------------------------------------------------------

    def _steps(self) -> Iterator[State]:
        patience = ftdi.PATIENT if self._way is None else ftdi.HURRIED
        yield "connecting"
        self._line = line = Line(self._serial, self._backend, patience)
        if not (yield from self._probed(line)):
            if self._image is None:
                raise DeviceError(
                    f"{self.name} runs no firmware: the file of the vendor's firmware is needed"
                )
            yield from upload(line, self._image, self._clock)
            if not (yield from self._probed(line)):
                raise DeviceError(
                    f"{self.name} took its firmware, but does not run it: is it the right file?"
                )
        yield from self._homed(line)

    def _probed(self, line: Line) -> Iterator[State]:
        """Whether firmware runs."""
        yield from line.requested("connecting", ftdi.FRAME_8N1, ftdi.NO_FLOW_CONTROL, *ftdi.FOR_PACKETS)
        for _ in range(_PROBES):
            if (yield from self._asked(line, "connecting", _PROBE_TIME)):
                return True
        return False

    def _homed(self, line: Line) -> Iterator[State]:
        """Wait until all legs know where they are, and take the first position."""
        told = False
        while True:
            reply = yield from self._asked(line, "homing", _SILENCE)
            if reply is None:
                raise DeviceError(f"{self.name} does not answer: no packet came for {1e-6 * _SILENCE:g} ms")
            if reply.flags & HOMED == HOMED:
                self._begin_at(reply)
                # A second reply, that fits: the first is not checked by one before it.
                again = yield from self._asked(line, "homing", _SILENCE)
                if again is not None and self._accepted(again):
                    return
                raise DeviceError(f"{self.name} counts {reply.numbers}, but its next reply does not fit that")
            if self._way is not None:
                self.fault = f"{self.name} {_HOMING}"
            elif not told:
                self._notify(f"{self.name} {_HOMING}.")
                told = True

    def _begin_at(self, reply: Packet) -> None:
        stance = stance_of(reply.numbers)
        if stance is None:
            raise DeviceError(f"{self.name} counts {reply.numbers}, which no position of its grip has")
        self._counts, self._stance, self._taken = reply.numbers, stance, self._clock.now()

    def _asked(self, line: Line, state: State, time: int) -> Iterator[State]:
        """The reply to a packet without force, or `None` where none comes in time."""
        self._assembler, self._overdue, self._commands = Assembler(), False, _NONE
        line.write(encode((0, 0, 0), HOMING | RED))
        until, over = self._clock.now() + time, False
        while not over:
            # Asked first: what has come until then counts, also where nobody looked.
            over = self._clock.now() >= until
            packets = self._assembler.feed(line.poll())
            yield state
            if packets:
                self._waiting = False
                return packets[-1]
        return None

    # Running --------------------------------------------------------------------------------------------------

    def _read(self) -> Float[np.ndarray, "3"]:
        assert self._line is not None
        self._take_reply(self._line)
        return self._rotation @ self._stance.position + self._origin

    def _write(self, force: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        assert self._line is not None
        commands = _commands(self._stance, force @ self._rotation)
        self._send(self._line, commands)
        return self._rotation @ self._stance.force(commands / COMMANDS)

    def _send(self, line: Line, commands: Float[np.ndarray, "3"]) -> None:
        self._commands, self._waiting = commands, True
        line.write(encode([int(c) for c in commands], HOMING | self._lights))

    def _take_reply(self, line: Line) -> None:
        """Move on to the newest reply; the second time in a row that there is none is a fault."""
        patient = self._overdue or not self._waiting
        if not self._waiting:
            self._send(line, self._commands)
        until = self._clock.now() + (_PATIENCE if patient else 0)
        for _ in range(_POLLS):
            packets = self._assembler.feed(line.read())
            if packets and self._accepted(packets[-1]):
                self._overdue = self._waiting = False
                return
            if self._clock.now() >= until:
                break
        if self._overdue:
            raise DeviceError(f"{self.name} does not answer: no packet that makes sense came in two ticks")
        self._overdue = True

    def _accepted(self, reply: Packet) -> bool:
        """Whether a reply can be true; if so, it is where the grip is."""
        if reply.flags & HOMED != HOMED:
            raise DeviceError(f"{self.name} has lost its homing")
        now = self._clock.now()
        most = _JITTER + _FASTEST * (now - self._taken)
        if max(abs(a - b) for a, b in zip(reply.numbers, self._counts, strict=True)) > most:
            return False
        stance = stance_of(reply.numbers, self._stance.position)
        if stance is None:
            return False
        self._counts, self._stance, self._taken = reply.numbers, stance, now
        self.buttons = tuple(bool(reply.flags & BUTTONS & 1 << button) for button in range(4))
        return True


def _commands(stance: Stance, force: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Whole motor commands for a force in the device's frame, within the limits of force and of command."""
    size = float(np.sqrt(force @ force))
    if size > FORCE_LIMIT:
        force = force * (FORCE_LIMIT / size)
    commands = COMMANDS * stance.torques(force)
    largest = float(np.max(np.abs(commands)))
    if largest > COMMAND_LIMIT:
        commands = commands * (COMMAND_LIMIT / largest)
    commands = np.rint(commands)
    while np.sum(stance.force(commands / COMMANDS) ** 2) > FORCE_LIMIT**2:  # rounded up over the limit
        commands = np.trunc(0.999 * commands)
    return commands
