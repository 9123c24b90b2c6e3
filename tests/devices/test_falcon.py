"""The Falcon's driver on an emulated one: what is sent, what is felt, what is refused."""

import math
import re

import numpy as np
import pytest

from falcon_cases import LONGEST, PUSH, Rig, SteppedClock
from hapjax import InputError
from hapjax_devices import (
    DeviceClosed,
    DeviceError,
    Falcon,
    Hand,
    Operator,
    Placement,
    RecoverableDevice,
    attached_falcons,
)
from hapjax_devices.falcon import emulator, let_go
from hapjax_devices.falcon.emulator import EmulatedFalcon, EmulatedUsb, Fault
from hapjax_devices.falcon.processor import synthetic_firmware
from hapjax_devices.falcon.stance import counts_at

CENTRE = np.array([0.0, 0.0, 0.125])


@pytest.fixture(scope="module")
def firmware(tmp_path_factory):
    """A file with firmware of a usual size."""
    file = tmp_path_factory.mktemp("firmware") / "falcon.bin"
    file.write_bytes(synthetic_firmware(4000))
    return str(file)


@pytest.fixture
def rig():
    """A driver that runs."""
    rig = Rig()
    rig.falcon.open()
    return rig


def test_it_is_a_device_that_can_recover():
    assert isinstance(Rig().falcon, RecoverableDevice)


# The wire -------------------------------------------------------------------------------------------------


def test_where_firmware_runs_none_is_uploaded(rig):
    assert rig.falcon.state == "running" and rig.said == []
    assert rig.emulated.requests == [(4, 8), (2, 0), (9, 1), (3, 2), (0, 1), (0, 2)]
    assert set(rig.emulated.written) == {b"<AAAAAAAAAAAAJA>"}  # no force, homing mode, red


def test_the_upload_is_as_documented(firmware):
    rig = Rig(runs=False, firmware=firmware)
    rig.falcon.open()
    image = synthetic_firmware(4000)
    settled = [(9, 1), (3, 2), (0, 1), (0, 2)]
    probe = [(4, 8), (2, 0), *settled]
    reset = [(0, 1), (0, 2), (9, 16), (3, 0x4138), (4, 8), (2, 0), (1, 0x200), (1, 0x100), (1, 0x101)]
    assert rig.emulated.requests == [*probe, *reset, (1, 0x100), (3, 0x15), *settled, *probe]
    written = rig.emulated.written
    start = written.index(b"\x0aC\r")
    assert written[start + 1] == b"A"
    chunks = written[start + 2 : start + 2 + math.ceil(len(image) / 62)]
    assert b"".join(chunks) == image == rig.emulated.processor.loaded
    assert {len(chunk) for chunk in chunks[:-1]} == {62}
    assert rig.falcon.state == "running"


def test_lights_buttons_and_homing_mode(rig):
    rig.tick(np.zeros(3))
    assert rig.emulated.written[-1] == b"<AAAAAAAAAAAADA>"  # green while it runs
    rig.falcon.light("red", "blue")
    rig.emulated.processor.pressed = 0b0101
    rig.tick(np.zeros(3))
    rig.tick(np.zeros(3))
    assert rig.emulated.written[-1] == b"<AAAAAAAAAAAANA>"
    assert rig.falcon.buttons == (True, False, True, False)
    with pytest.raises(InputError, match="no LED 'pink'"):
        rig.falcon.light("pink")


# Position and force ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("placement", [None, Placement((0.1, 0.2, 0.3), (0.5, 0.5, -0.5, 0.5))])
def test_the_grip_is_felt_where_it_is_in_the_world(placement):
    clock = SteppedClock()
    emulated = EmulatedFalcon(clock=clock)
    falcon = Falcon(placement=placement, backend=EmulatedUsb(emulated), clock=clock)
    rotation, origin = np.eye(3), np.zeros(3)
    if placement is not None:  # that quaternion turns x into z, y into -x, and z into -y
        rotation, origin = np.array([[0, -1, 0], [0, 0, -1], [1, 0, 0]]), np.array([0.1, 0.2, 0.3])
    axes = np.array(
        [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    )  # right, up and towards the user, seen in right, away and up
    random = np.random.default_rng(0)
    for _ in range(20):
        emulated.processor.place = CENTRE + random.uniform(-0.025, 0.025, 3)
        with falcon:
            place = falcon.read()
            out = falcon.write(PUSH)
        expected = origin + rotation @ axes @ (emulated.processor.place - CENTRE)
        np.testing.assert_allclose(place, expected, atol=4 * falcon.resolution)
        np.testing.assert_allclose(out, PUSH, atol=0.01)


def test_the_motors_push_as_told(rig):
    """What the emulated legs do with the commands is the force that was asked for, in its direction, to a command's step."""
    random = np.random.default_rng(1)
    axes = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    for force in random.uniform(-2.9, 2.9, (200, 3)):
        out = rig.falcon.write(force)
        np.testing.assert_allclose(axes @ rig.emulated.processor.force, out, atol=1e-3)
        np.testing.assert_allclose(out, force, atol=3e-3)
        assert np.array_equal(rig.falcon.output, out)


@pytest.mark.parametrize("size", [8.0, 8.01, 50.0, 1e6])
def test_a_force_over_the_limit_keeps_its_direction(rig, size):
    random = np.random.default_rng(2)
    for corner in random.uniform((-0.028, -0.028, 0.08), (0.028, 0.028, 0.165), (30, 3)):
        rig.emulated.processor.place = corner
        rig.falcon.open()
        way = random.standard_normal(3)
        way /= np.linalg.norm(way)
        out = rig.falcon.write(size * way)
        assert np.max(np.abs(rig.emulated.processor.commands)) <= 4095
        assert np.linalg.norm(out) <= 8.0
        assert way @ out > 0.99 * np.linalg.norm(out)
        assert np.linalg.norm(out) > 7.97 or np.max(np.abs(rig.emulated.processor.commands)) == 4095


def test_forces_that_are_not_finite_are_none(rig):
    rig.tick()
    with pytest.raises(DeviceError, match="finite"):
        rig.falcon.write(np.array([np.nan, 0.0, 0.0]))
    assert not rig.emulated.processor.force.any() and not rig.falcon.output.any()


def test_positions_come_a_packet_late(rig):
    before = counts_at(CENTRE)
    rig.tick()
    rig.emulated.processor.place = CENTRE + np.array([0.001, 0.0, 0.0])
    assert abs(rig.tick()[0]) < 1e-4 and np.allclose(before, counts_at(CENTRE))
    assert rig.tick()[0] == pytest.approx(0.001, abs=1e-4)


def test_a_hand_that_is_faster_than_hands_are_is_not_believed(rig):
    """2 m/s is followed; 20 mm in a millisecond is a number that got broken: the position before it holds for a tick."""
    rig.tick()
    for step in range(1, 8):
        rig.emulated.processor.place = CENTRE + np.array([0.002 * step, 0.0, 0.0])
        before = rig.tick()
        assert before[0] == pytest.approx(0.002 * (step - 1), abs=1e-4)
    last = rig.tick()
    rig.emulated.processor.place = CENTRE - np.array([0.006, 0.0, 0.0])
    np.testing.assert_allclose(rig.tick(), last, atol=1e-4)  # from before
    np.testing.assert_allclose(rig.tick(), last, atol=1e-9)
    with pytest.raises(DeviceError, match="no packet that makes sense"):
        rig.tick()


def test_a_hand_yields_to_the_force():
    clock = SteppedClock()
    hand = Operator(CENTRE[None], 1e-3, Hand(0.15, 400.0))
    emulated = EmulatedFalcon(hand=hand, clock=clock)
    with Falcon(backend=EmulatedUsb(emulated), clock=clock) as falcon:
        for _ in range(400):
            clock.time += 1_000_000
            place = falcon.read()
            falcon.write(np.array([0.0, 0.0, 2.0]))
    np.testing.assert_allclose(place, [0.0, 0.0, 2.0 / 400.0], atol=2e-4)  # up in the world


# Refusals -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("size", "said"),
    [(None, "cannot be read: No such file"), (100, "has 100 bytes"), (50_000, "more than 36864 bytes")],
)
def test_firmware_that_is_none(tmp_path, size, said):
    file = tmp_path / "falcon.bin"
    if size is not None:
        file.write_bytes(bytes(size))
    with pytest.raises(InputError, match=said):
        Falcon(firmware=file)
    with pytest.raises(InputError, match="cannot be read: Is a directory"):
        Falcon(firmware=tmp_path)


def test_homing_time_and_placement_out_of_range():
    with pytest.raises(InputError, match="homing_time is 0"):
        Falcon(homing_time=0.0)
    with pytest.raises(InputError, match=r"position of the device is \[0.0, nan, 0.0\]"):
        Placement((0.0, np.nan, 0.0))
    with pytest.raises(InputError, match=r"orientation of the device is \[0.0, 0.0, 0.0, 0.0\]"):
        Placement(orientation=(0.0, 0.0, 0.0, 0.0))


def test_a_reply_that_came_while_the_process_was_held_up_counts(monkeypatch):
    """On a busy machine nobody may look for longer than is waited for a reply."""
    rig, held = Rig(), []
    monkeypatch.setattr(emulator, "_THINKS", 3_000_000)

    def read(timeout):
        came = EmulatedFalcon.read(rig.emulated, timeout)
        if len(came) == 2:  # the chip's status alone
            held.append(rig.clock.time)
            rig.clock.time += 200_000_000
        return came

    monkeypatch.setattr(rig.emulated, "read", read)
    rig.falcon.open()
    assert held and rig.falcon.state == "running"


def test_nothing_works_before_open_and_after_close(rig):
    rig.tick()
    rig.falcon.close()
    rig.falcon.close()
    assert not rig.emulated.processor.force.any()
    for call in (rig.falcon.read, lambda: rig.falcon.write(PUSH), rig.falcon.recover):
        with pytest.raises(DeviceClosed, match="the Falcon is not open"):
            call()


def test_several_falcons_are_told_apart_by_their_numbers():
    clock = SteppedClock()
    several = [EmulatedFalcon(serial=serial, clock=clock) for serial in ("FT1", "FT2")]
    bus = EmulatedUsb(*several)
    assert [(a.serial, a.bus, a.address, a.problem) for a in attached_falcons(bus)] == [
        ("FT1", 1, 1, None),
        ("FT2", 1, 2, None),
    ]
    with pytest.raises(DeviceError, match="2 Falcons are attached; .* serial number: FT1, FT2"):
        Falcon(backend=bus, clock=clock).open()
    with pytest.raises(DeviceError, match="the Falcon FT3 is not attached; attached: FT1, FT2"):
        Falcon(serial="FT3", backend=bus, clock=clock).open()
    with Falcon(serial="FT2", backend=bus, clock=clock) as falcon:
        falcon.write(PUSH)
        assert several[1].processor.force.any() and not several[0].processor.force.any()


@pytest.mark.parametrize("fault", [Fault.FORBIDDEN, Fault.DEAF])
def test_one_that_cannot_be_asked_for_its_number_is_not_in_the_way_of_another(fault):
    clock = SteppedClock()
    bus = EmulatedUsb(*(EmulatedFalcon(serial=serial, clock=clock) for serial in ("FT1", "FT2")))
    bus.falcons[0].inject(fault)
    with Falcon(serial="FT2", backend=bus, clock=clock) as falcon:
        falcon.write(PUSH)
        assert bus.falcons[1].processor.force.any()
    said = {Fault.FORBIDDEN: "may not be opened by this user", Fault.DEAF: "nothing came over USB in time"}
    with pytest.raises(DeviceError, match=f"a Falcon .*{said[fault]}"):
        Falcon(serial="FT1", backend=bus, clock=clock).open()


@pytest.mark.parametrize("serial", [None, "FT1"])
def test_a_chip_that_answers_no_request_holds_a_loop_up_for_milliseconds(serial):
    clock = SteppedClock()
    emulated = EmulatedFalcon(serial="FT1", clock=clock)
    falcon = Falcon(serial=serial, backend=EmulatedUsb(emulated), clock=clock)
    falcon.open()
    emulated.inject(Fault.UNPLUG)
    with pytest.raises(DeviceError):
        falcon.write(PUSH)
    emulated.mend()
    emulated.inject(Fault.DEAF)
    said = set()
    for _ in range(50):
        clock.time += 10_000_000
        began = clock.time
        assert not falcon.recover() and clock.time - began <= LONGEST
        said.add(falcon.fault)
    assert len(said) == 2 and any("nothing came over USB in time" in (each or "") for each in said)
    began = clock.time
    with pytest.raises(DeviceError, match="nothing came over USB in time"):
        falcon.open()
    assert 90e6 < clock.time - began < 110e6  # no loop waits


def test_one_that_the_system_has_not_configured_is_configured(rig):
    rig.emulated.configuration = 0
    rig.falcon.open()
    assert rig.emulated.configuration == 1 and rig.falcon.state == "running"


def test_a_falcon_that_may_not_be_opened_says_what_to_do():
    emulated = EmulatedFalcon(clock=SteppedClock())
    emulated.inject(Fault.FORBIDDEN)
    (found,) = attached_falcons(EmulatedUsb(emulated))
    assert found.serial is None and found.problem is not None
    rules = re.search(r"copy (\S+60-hapjax\.rules) to /etc/udev/rules\.d", found.problem)
    assert rules is not None
    with open(rules[1]) as file:
        assert 'ATTR{idVendor}=="0403", ATTR{idProduct}=="cb48"' in file.read()


def test_firmware_that_does_not_run(tmp_path):
    file = tmp_path / "other.bin"
    file.write_bytes(bytes(5000))
    rig = Rig(runs=False, firmware=str(file))
    with pytest.raises(DeviceError, match="did not take its firmware: 10 times"):
        rig.falcon.open()
    with pytest.raises(DeviceError, match="runs no firmware: the file of the vendor's firmware is needed"):
        Rig(runs=False).falcon.open()
    assert rig.clock.time < 60e9


def test_a_falcon_that_no_one_homes():
    rig = Rig()
    rig.emulated.processor.homes_after, rig.emulated.processor.homed = None, 0
    with pytest.raises(DeviceError, match="the Falcon is not homed: pull its grip"):
        rig.falcon.open()
    assert len(rig.said) == 1 and 2e9 < rig.clock.time < 2.5e9 and rig.falcon.state == "closed"


def test_one_whose_process_is_gone_can_be_told_to_push_no_more(rig):
    rig.tick()
    assert rig.pushes()
    let_go(None, EmulatedUsb(rig.emulated))
    assert not rig.pushes()
    with pytest.raises(DeviceError, match="FT9"):
        let_go("FT9", EmulatedUsb(rig.emulated))
