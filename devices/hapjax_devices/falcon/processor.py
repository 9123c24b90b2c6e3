"""The Falcon behind its serial line, emulated: a boot loader, firmware, three arms with motors, and a hand."""

from contextlib import suppress

import numpy as np
from jaxtyping import Float

from ..operator import Operator
from ..realtime import Clock
from .kinematics import CENTRE
from .packets import BUTTONS, HOMED, HOMING, Assembler, Packet, encode
from .stance import Stance, counts_at, stance_of

_KEY, _ANSWER = b"\x0aC\r", b"\x00\x0aD,\r"
_BOOT_KEY, _ENTRY = 0x08AA, 0x3F8002
_TORQUE = -1e-4  # N m, of a command of 1
_WRAP = 4096  # a command from here on has the other sign


def synthetic_firmware(words: int = 500) -> bytes:
    """A program that the emulated boot loader takes: as long as asked for, and of no use to a real one.

    Its form is that of TI's serial boot: a key, 8 words, the entry point, blocks of a size, an address and that many
    words, and a block of size 0.
    """
    body = [(7 * n + 3) & 0xFFFF for n in range(words)]
    header = [_BOOT_KEY, *([0] * 8), _ENTRY >> 16, _ENTRY & 0xFFFF]
    program = [*header, len(body), _ENTRY >> 16, _ENTRY & 0xFFFF, *body, 0]
    return b"".join(word.to_bytes(2, "little") for word in program)


class Processor:
    """What is behind the Falcon's serial line.

    **Attributes:**

    - `mode`: `"boot"`, `"loading"`, `"lost"` (a program that is none) or `"running"`.
    - `place` (3,) m of the grip in the device's frame, where a hand holds it, or moves it as a path says.
    - `hand`: an `Operator` in the device's frame, which each packet carries on by one sample; `None`: one that never yields.
    - `commands` (3,), to which the motors were last set; `force` (3,) N on the grip, in the device's frame.
    - `lights` and `pressed`, flags of the LEDs and of the buttons.
    - `homed`, a flag for each leg; `homes_after` so many seconds of running, where `None` is never.
    - `loaded`: the bytes of the last program.
    """

    def __init__(self, clock: Clock, runs: bool = True, hand: Operator | None = None):
        self._clock, self.hand = clock, hand
        self.place = CENTRE if hand is None else hand.position
        self.homes_after: float | None = 0.02
        at_rest = counts_at(CENTRE)
        middle = stance_of(at_rest)
        assert middle is not None
        self._at = CENTRE, at_rest, middle
        self.reset()
        if runs:
            self._start()
            self.homed = HOMED

    def reset(self) -> None:
        """As after power has come: nothing runs, and no leg knows where it is."""
        self.mode, self.homed, self.lights, self.pressed = "boot", 0, 0, 0
        self.loaded, self._heard, self._knocked = b"", b"", False
        self.commands = np.zeros(3)

    @property
    def force(self) -> Float[np.ndarray, "3"]:
        """What the motors put out now, N, in the device's frame."""
        if not self.commands.any():
            return np.zeros(3)
        wrapped = (self.commands + _WRAP) % (2 * _WRAP) - _WRAP
        return self._arms()[1].force(_TORQUE * wrapped)

    def receive(self, data: bytes, baud: int) -> bytes:
        """Take bytes at a speed of the line; returns the answer."""
        if self.mode == "boot":
            return self._asked(data, baud)
        if self.mode == "loading":
            return self._loading(data) if baud == 142857 else b""
        if self.mode == "running" and baud == 1500000:
            return b"".join(self._exchanged(packet) for packet in self._assembler.feed(data))
        return b""

    def _asked(self, data: bytes, baud: int) -> bytes:
        if baud == 9600:
            self._heard = (self._heard + data)[-len(_KEY) :]
            if self._heard == _KEY:
                self._knocked = True
                return _ANSWER
        elif baud == 142857 and self._knocked and data == b"A":
            self.mode, self._loader = "loading", _program()
            next(self._loader)
            return data
        return b""

    def _loading(self, data: bytes) -> bytes:
        for at, byte in enumerate(data):
            try:
                self._loader.send(byte)
            except StopIteration as end:
                self.loaded += data[: at + 1]
                if end.value:
                    self._start()
                else:
                    self.mode = "lost"
                return data[: at + 1]
        self.loaded += data
        return data

    def _start(self) -> None:
        self.mode, self._assembler, self._since = "running", Assembler(), self._clock.now()

    def _exchanged(self, packet: Packet) -> bytes:
        self.commands, self.lights = np.array(packet.numbers, np.float64), packet.flags & ~HOMING
        if self.hand is not None:
            self.hand.advance(self.force)
            self.place = self.hand.position
        ripe = self.homes_after is not None and self._clock.now() >= self._since + 1e9 * self.homes_after
        if packet.flags & HOMING and ripe:
            self.homed = HOMED
        counts = np.rint(self._arms()[0]) if self.homed == HOMED else np.zeros(3)
        return encode([int(c) for c in counts], self.homed | self.pressed & BUTTONS)

    def _arms(self) -> tuple[Float[np.ndarray, "3"], Stance]:
        """What the encoders are at, and the stance; where the hand goes out of reach, the arms stay where they were."""
        if self._at[0] is not self.place:
            arms = self._at[1:]
            with suppress(ValueError):
                counts = counts_at(self.place)
                arms = counts, stance_of(counts, arms[1].position) or arms[1]
            self._at = self.place, *arms
        return self._at[1], self._at[2]


def _program():
    """Takes a program byte by byte; ends with it, or with a key that is none, and says whether it was one."""

    def word():
        low = yield
        high = yield
        return low | high << 8

    if (yield from word()) != _BOOT_KEY:
        return False
    for _ in range(10):
        yield from word()
    while size := (yield from word()):
        for _ in range(2 + size):
            yield from word()
    return True
