"""The bytes on the Falcon's line, against packets and requests written out by hand from the protocol."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hapjax_devices.falcon.packets import Assembler, Packet, decode, encode

NUMBERS = st.tuples(*[st.integers(-32768, 32767)] * 3)
# 0 is A, 15 is P; the lowest nibble first: 0x1234 is E D C B, -1 is P P P P.
GOLDEN = [
    ((0, 0, 0), 0x1, b"<AAAAAAAAAAAABA>"),
    ((1, -1, 4095), 0x1 | 0x2, b"<BAAAPPPPPPPADA>"),
    ((0x1234, -4095, 0), 0x1 | 0x8, b"<EDCBBAAPAAAAJA>"),
    ((-32768, 32767, 16), 0x7F, b"<AAAIPPPHABAA\xc0A>"),
    ((0, 0, 0), 0x70, b"<AAAAAAAAAAAA\xb1A>"),  # three legs homed, no button
]


@pytest.mark.parametrize(("numbers", "flags", "packet"), GOLDEN)
def test_golden_packets(numbers, flags, packet):
    assert encode(numbers, flags) == packet
    assert decode(packet) == Packet(numbers, flags)


@pytest.mark.parametrize(
    "wrong",
    [
        b"",
        b"<AAAAAAAAAAAABA",
        b"<AAAAAAAAAAAABA<",
        b">AAAAAAAAAAAABA>",
        b"<AAAAAAAAAAAQBA>",  # Q is 16
        b"<AAAAAA@AAAAABA>",  # @ is -1
        b"<AAAAAAAAAAAA\xc1A>",  # flags of 128
    ],
)
def test_what_is_no_packet(wrong):
    assert decode(wrong) is None


@given(
    st.lists(st.tuples(NUMBERS, st.integers(0, 0x7F)), max_size=5), st.lists(st.integers(1, 20)), st.data()
)
def test_packets_are_put_together_from_pieces_with_noise_between(said, cuts, data):
    """Whatever the pieces are, and whatever stands between packets but an opening bracket."""
    noise = [data.draw(st.binary(max_size=4)).replace(b"<", b"") for _ in said]
    stream = b"".join(n + encode(*packet) for n, packet in zip(noise, said, strict=True))
    assembler, found = Assembler(), []
    for cut in [*cuts, len(stream)]:
        found += assembler.feed(stream[:cut])
        stream = stream[cut:]
    assert found == [Packet(*packet) for packet in said]
    assert assembler.dropped == sum(map(len, noise))


def test_a_packet_is_found_behind_one_that_broke_off():
    assembler = Assembler()
    assert assembler.feed(b"<AAAA" + encode((1, 2, 3), 0) + b"<A<") == [Packet((1, 2, 3), 0)]
    assert assembler.feed(encode((4, 5, 6), 1)[1:]) == [Packet((4, 5, 6), 1)]
    assert assembler.dropped == 7


def test_endless_noise_is_not_kept():
    assembler, random = Assembler(), np.random.default_rng(0)
    for _ in range(200):
        assembler.feed(random.bytes(62))
    assert len(assembler._rest) < 16
    assert assembler.feed(encode((1, 2, 3), 0))[-1:] == [Packet((1, 2, 3), 0)]
