"""The Inverse3's driver against a stand-in for Haply's service."""

import socket
import threading
import time
from contextlib import suppress

import numpy as np
import pytest

from hapjax import InputError
from hapjax_devices import (
    DeviceClosed,
    DeviceError,
    Inverse3,
    Placement,
    RecoverableDevice,
    attached_inverse3,
    driver,
    inverse3,
)
from haply_service import DROPS, HaplyService

PUSH = np.array([1.0, -2.0, 1.5])
SAID = {
    "closed": "Haply's service has closed the connection",
    "unplugged": "is not attached any more: Haply's service does not know 049D",
}


@pytest.fixture(autouse=True)
def patience(monkeypatch):
    """The service is a thread of a busy machine: what takes longer than in a loop is no fault."""
    monkeypatch.setattr(inverse3, "_PATIENCE", 250_000_000)
    monkeypatch.setattr(inverse3, "_INVENTORY", 400_000_000)
    monkeypatch.setattr(inverse3, "_SHAKE", 5.0)
    monkeypatch.setattr(driver, "RETRY", 1_000_000)


@pytest.fixture
def service():
    with HaplyService() as service:
        yield service


def test_positions_and_forces_in_the_world(service):
    device = Inverse3(placement=Placement((0.1, 0.0, 0.2), (0.5, 0.5, 0.5, 0.5)), url=service.url)
    assert isinstance(device, RecoverableDevice)
    service.place = np.array([0.01, 0.02, 0.03])
    with device:
        # That quaternion turns x into y, y into z, and z into x.
        np.testing.assert_allclose(device.read(), [0.13, 0.01, 0.22], atol=1e-12)
        assert device.write(PUSH) == pytest.approx(PUSH)
        device.read()
        device.read()
        assert service.messages[-1] == {
            "inverse3": [
                {
                    "device_id": "049D",
                    "commands": {"set_cursor_force": {"values": {"x": -2.0, "y": 1.5, "z": 1.0}}},
                }
            ]
        }
        over = device.write(100 * PUSH)
        assert np.linalg.norm(over) <= device.force_limit and over == pytest.approx(
            5 * PUSH / np.linalg.norm(PUSH)
        )
    with pytest.raises(DeviceClosed, match="the Inverse3 is not open"):
        device.read()


def test_a_moving_hand_is_followed(service):
    with Inverse3(url=service.url) as device:
        for step in range(20):
            service.place = np.array([0.0002 * step, 0.0, 0.0])
            device.write(np.zeros(3))
            device.read()
        until(lambda: device.read()[0] == pytest.approx(0.0002 * 19))


def test_a_service_has_long_to_answer_until_a_loop_waits(service, monkeypatch):
    given, real = [], inverse3._connected
    monkeypatch.setattr(inverse3, "_OPENING", 7.0)
    monkeypatch.setattr(inverse3, "_connected", lambda *to: given.append(to[1]) or real(*to))
    device = Inverse3(url=service.url)
    with device:
        device.read()
        assert 0 < device._connection.sock.gettimeout() <= 5.0
        service.fault = "closed"
        with pytest.raises(DeviceError):
            three_ticks(device)
        service.fault = None
        until(device.recover)
        assert given[0] == 7.0 and {*given[1:]} == {5.0} and device._connection.sock.gettimeout() <= 5.0
    with device:
        assert given[-1] == 7.0


def test_what_comes_in_small_pieces_holds_a_loop_up_no_longer_than_what_does_not_come(service, monkeypatch):
    monkeypatch.setattr(inverse3, "_SHAKE", 0.05)
    with Inverse3(url=service.url) as device:
        service.fault = "drips"
        with pytest.raises(DeviceError, match="no message that makes sense came in two ticks"):
            three_ticks(device)
    assert service.drops < DROPS / 2


def test_a_handshake_in_small_pieces_holds_a_loop_up_no_longer_than_one_that_does_not_come():
    drops = []

    def drip():
        connection = server.accept()[0]
        with connection, suppress(OSError):
            connection.recv(65536)
            connection.sendall(b"HTTP/1.1 101 Switching Protocols\r\nServer: ")
            while len(drops) < DROPS:
                time.sleep(1e-3)
                connection.send(b"a")
                drops.append(1)

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=drip)
        thread.start()
        url = f"ws://127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(DeviceError, match=f"the Inverse3 needs Haply's service at {url}: .*timed out"):
            inverse3._connected(url, 0.05, "the Inverse3")
        thread.join()
    assert len(drops) < DROPS / 2


def test_a_name_is_looked_up_before_a_loop_waits(service, monkeypatch):
    port, asked, real = int(service.url.rsplit(":", 1)[1]), [], socket.getaddrinfo

    def look_up(host, *rest):
        asked.append(host)
        return real("127.0.0.1" if host == "haply" else host, *rest)

    monkeypatch.setattr(socket, "getaddrinfo", look_up)
    with Inverse3(url=f"ws://haply:{port}") as device:
        service.fault = "closed"
        with pytest.raises(DeviceError):
            three_ticks(device)
        service.fault = None
        until(device.recover)
    assert asked[0] == "haply" and {*asked[1:]} == {"127.0.0.1"}


def test_the_newer_message_format():
    with HaplyService(field="vector") as service:
        with Inverse3(message_format="3.5", url=service.url) as device:
            device.write(PUSH)
            device.read()
            device.read()
            np.testing.assert_array_equal(service.force["049D"], PUSH)


@pytest.mark.parametrize("fault", HaplyService.FAULTS)
def test_a_fault_while_it_pushes(service, fault):
    """No force after two ticks, a sentence, and it comes back."""
    device = Inverse3(url=service.url)
    device.open()
    device.write(PUSH)
    device.read()
    device.read()
    assert service.force["049D"].any()
    service.fault = fault
    with pytest.raises(
        DeviceError, match=SAID.get(fault, "no message that makes sense came in two ticks")
    ) as error:
        three_ticks(device)
    assert device.state == "faulted" and device.fault == str(error.value) and not device.output.any()
    with pytest.raises(DeviceClosed):
        device.write(PUSH)
    until(lambda: not service.force["049D"].any())
    service.fault = None
    until(device.recover)
    assert device.fault is None
    device.write(PUSH)
    device.read()
    until(lambda: device.read() is not None and service.force["049D"].any())
    device.close()
    until(lambda: not service.force["049D"].any())


def three_ticks(device):
    """The first finds an answer from before."""
    for _ in range(3):
        device.write(PUSH)
        device.read()


def until(done, seconds=30.0):
    """Ask until it is so; the service is another thread, so that takes a while, but not for ever."""
    end = time.monotonic() + seconds
    while not done():
        assert time.monotonic() < end, "it never came so"
        time.sleep(1e-3)


@pytest.mark.parametrize(
    ("ids", "fault", "wanted", "said"),
    [
        ((), None, None, "is not attached: Haply's service knows of none"),
        (("A", "B"), None, None, "2 Inverse3 are attached; say which is meant by its id: A, B"),
        (("A", "B"), None, "C", "the Inverse3 C is not attached; attached: A, B"),
    ],
)
def test_what_cannot_be_opened(ids, fault, wanted, said):
    with HaplyService(ids) as service:
        assert attached_inverse3(service.url) == list(ids)
        device = Inverse3(wanted, url=service.url)
        with pytest.raises(DeviceError, match=said):
            device.open()
        assert device.state == "closed"


def test_a_service_that_is_not_there_or_says_nothing(service):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        url = f"ws://127.0.0.1:{free.getsockname()[1]}"
    with pytest.raises(DeviceError, match=f"needs Haply's service at {url}: no program listens there"):
        Inverse3(url=url).open()
    with pytest.raises(DeviceError, match="no program listens there"):
        attached_inverse3(url)
    service.fault = "silence"
    with pytest.raises(DeviceError, match="Haply's service does not say what is attached"):
        Inverse3(url=service.url).open()
    with pytest.raises(DeviceError, match="does not say which Inverse3 are attached"):
        attached_inverse3(service.url)


def test_a_force_limit_out_of_range():
    with pytest.raises(InputError, match="force_limit is nan N"):
        Inverse3(force_limit=float("nan"))
