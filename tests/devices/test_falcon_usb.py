"""The Falcon's driver through libusb itself, on a USB device that umockdev puts there: `make usb-test`."""

import errno
import json
import os
import socket
import threading
import time

import numpy as np
import pytest

from falcon_cases import HARMLESS, HIDDEN, PUSH, is_a_sentence
from hapjax_devices import DeviceError, Falcon, attached_falcons
from hapjax_devices.falcon import driver, line
from hapjax_devices.falcon.emulator import EmulatedFalcon, EmulatedUsb, Fault
from hapjax_devices.falcon.processor import synthetic_firmware

BRIDGE = os.environ.get("FALCON_BRIDGE")
pytestmark = pytest.mark.skipif(BRIDGE is None, reason="runs where umockdev is installed: make usb-test")

SAID = {
    **dict.fromkeys((Fault.GARBAGE, Fault.SILENCE, Fault.CORRUPT, Fault.POWER), "no packet that makes sense"),
    Fault.TIMEOUT: "nothing came over USB in time",
    Fault.UNPLUG: "is not attached any more",
    Fault.HOMING_LOST: "has lost its homing",
}


class Socket:
    """Where `usb_bridge.py` asks what the device answers; `falcon` is the one that does."""

    def __init__(self, path):
        self.falcon = EmulatedFalcon()
        self._listening = socket.socket(socket.AF_UNIX)
        self._listening.bind(path)
        self._listening.listen()
        threading.Thread(target=self._serve, daemon=True).start()

    def _serve(self):
        connection, _ = self._listening.accept()
        self._listening.close()
        with connection, connection.makefile("rwb", buffering=0) as stream:
            for question in stream:
                stream.write(json.dumps(self._answer(*json.loads(question))).encode() + b"\n")

    def _answer(self, what, content=""):
        falcon, data = self.falcon, bytes.fromhex(content)
        try:
            if what in ("attached", "claim"):
                falcon.check_attached()
                if what == "claim" and Fault.BUSY in falcon.faults:
                    raise OSError(errno.EBUSY, "")
                return {"data": ""}
            if what == "read":
                return {"data": falcon.read(0).hex()}
            if what == "write":
                falcon.write(data)
                return {"data": ""}
            value, index, length = (int.from_bytes(data[at : at + 2], "little") for at in (2, 4, 6))
            answer = bytearray(max(length, 64))
            sent = EmulatedUsb(falcon).ctrl_transfer(falcon, data[0], data[1], value, index, answer, 0)
            return {"data": answer[: min(sent, length)].hex()}
        except OSError as error:
            return {"errno": error.errno}


@pytest.fixture(autouse=True)
def patience(monkeypatch):
    """Three processes answer each other here, on a machine that may be busy: what takes them longer is no fault."""
    monkeypatch.setattr(line, "_TIMEOUT", 500)
    monkeypatch.setattr(line, "HURRIED", 500)
    monkeypatch.setattr(driver, "_PATIENCE", 500_000_000)


@pytest.fixture(scope="module")
def wire():
    assert BRIDGE is not None
    return Socket(BRIDGE)


@pytest.fixture
def emulated(wire):
    wire.falcon = EmulatedFalcon()
    return wire.falcon


def tick(falcon, force=PUSH):
    place = falcon.read()
    falcon.write(force)
    return place


def until(done, seconds=60.0):
    """Ask until it is so."""
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end, "it never came so"


def test_what_is_attached(emulated):
    assert [(a.serial, a.bus, a.address, a.problem) for a in attached_falcons()] == [("FT000001", 1, 2, None)]


def test_the_upload(wire, tmp_path):
    file = tmp_path / "firmware.bin"
    file.write_bytes(synthetic_firmware(500))
    wire.falcon = EmulatedFalcon(runs=False)
    with Falcon(file, serial="FT000001", notify=lambda _: None) as falcon:
        assert falcon.state == "running"
        assert wire.falcon.processor.loaded == synthetic_firmware(500)
        settled, probe = [(9, 1), (3, 2), (0, 1), (0, 2)], [(4, 8), (2, 0)]
        reset = [(0, 1), (0, 2), (9, 16), (3, 0x4138), (4, 8), (2, 0), (1, 0x200), (1, 0x100), (1, 0x101)]
        expected = [*probe, *settled, *reset, (1, 0x100), (3, 0x15), *settled, *probe, *settled]
        assert wire.falcon.requests == expected


def test_positions_and_forces(emulated):
    random = np.random.default_rng(0)
    axes = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
    for shift in random.uniform(-0.02, 0.02, (5, 3)):
        emulated.processor.place = np.array([0.0, 0.0, 0.125]) + shift
        with Falcon() as falcon:
            np.testing.assert_allclose(falcon.read(), axes @ shift, atol=2e-4)
            falcon.write(PUSH)
            np.testing.assert_allclose(axes @ emulated.processor.force, PUSH, atol=0.02)
        assert not emulated.processor.force.any()


@pytest.mark.parametrize("fault", [fault for fault in Fault if fault is not Fault.FORBIDDEN])
def test_a_fault_and_the_way_back(emulated, fault, tmp_path):
    """As in the table of the faults, here in real time: no force within two ticks, a sentence, and it comes back."""
    file = tmp_path / "firmware.bin"
    file.write_bytes(synthetic_firmware(500))
    with Falcon(file, notify=lambda _: None) as falcon:
        tick(falcon)
        emulated.inject(fault)
        if fault in HARMLESS:
            for _ in range(20):
                tick(falcon)
            assert emulated.processor.commands.any()
        else:
            with pytest.raises(DeviceError, match=SAID[fault]) as error:
                for _ in range(HIDDEN + 1):
                    tick(falcon)
            assert is_a_sentence(str(error.value)) and not emulated.processor.commands.any()
            end = time.monotonic() + 0.5
            while time.monotonic() < end:
                assert not falcon.recover() or fault is Fault.HOMING_LOST
                assert not emulated.processor.commands.any()
            emulated.mend()
            until(falcon.recover)
        tick(falcon)
        assert emulated.processor.commands.any()


def test_another_program_has_it(emulated):
    emulated.inject(Fault.BUSY)
    with pytest.raises(DeviceError, match="the Falcon is in use by another program"):
        Falcon().open()
