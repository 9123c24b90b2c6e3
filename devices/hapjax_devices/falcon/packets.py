"""The Falcon's packets: 16 bytes each way, `<`, 14 bytes that are each a value above `A`, `>`.

Three signed numbers of 16 bits come first, four bits a byte, the lowest first: motor commands on the way out, the
encoders' counts on the way in. Then come flags, and a byte whose meaning is not known.
"""

from collections.abc import Sequence
from typing import NamedTuple

LENGTH = 16
_OPENS, _CLOSES, _ZERO = 0x3C, 0x3E, 0x41

HOMING, GREEN, BLUE, RED = 0x1, 0x2, 0x4, 0x8  # flags on the way out
BUTTONS, HOMED = (
    0x0F,
    0x70,
)  # flags on the way in: four buttons, three legs whose encoders know where they are


class Packet(NamedTuple):
    """What a packet says: three `numbers`, each within -32768 and 32767, and `flags` of 0 to 127."""

    numbers: tuple[int, int, int]
    flags: int


def encode(numbers: Sequence[int], flags: int) -> bytes:
    """The 16 bytes that say this; see `Packet` for the ranges."""
    nibbles = [_ZERO + (number >> shift & 0xF) for number in numbers for shift in (0, 4, 8, 12)]
    return bytes((_OPENS, *nibbles, _ZERO + flags, _ZERO, _CLOSES))


def decode(packet: bytes) -> Packet | None:
    """What 16 bytes say; `None` where they are no packet."""
    if len(packet) != LENGTH or packet[0] != _OPENS or packet[-1] != _CLOSES:
        return None
    nibbles = [byte - _ZERO for byte in packet[1:13]]
    flags = packet[13] - _ZERO
    if min(nibbles) < 0 or max(nibbles) > 0xF or not 0 <= flags <= 0x7F:
        return None
    a, b, c = (_signed(nibbles[at : at + 4]) for at in (0, 4, 8))
    return Packet((a, b, c), flags)


class Assembler:
    """Puts packets together from bytes that come in pieces of any size, with anything in between.

    `dropped` counts the bytes that belonged to no packet.
    """

    def __init__(self):
        self.dropped = 0
        self._rest = bytearray()

    def feed(self, data: bytes) -> list[Packet]:
        """Take what has come; returns the packets that it completes, oldest first."""
        rest, packets = self._rest, []
        rest += data
        while True:
            start = rest.find(_OPENS)
            if start < 0:
                self._drop(len(rest))
                return packets
            self._drop(start)
            if len(rest) < LENGTH:
                return packets
            packet = decode(bytes(rest[:LENGTH]))
            if packet is None:
                self._drop(1)  # not the start of one: the next may be
            else:
                packets.append(packet)
                del rest[:LENGTH]

    def _drop(self, count: int) -> None:
        self.dropped += count
        del self._rest[:count]


def _signed(nibbles: Sequence[int]) -> int:
    a, b, c, d = nibbles
    number = a | b << 4 | c << 8 | d << 12
    return number - 0x10000 if number & 0x8000 else number
