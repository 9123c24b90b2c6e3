"""Devices of a rate of their own: asked when they are due, held in between, and never from before a fault."""

import numpy as np
import pytest

from hapjax import InputError
from hapjax_devices import DeviceError, GimbalDevice, Limits, RecoverableDevice, Safety, VirtualDevice
from hapjax_devices.event import Diary
from hapjax_devices.fingers import Fingers
from hapjax_devices.session.slower import Slower


class Counter(VirtualDevice):
    """Notes what it is asked; `fails` is the call that fails, `at` where it is, `None`: on its way."""

    def __init__(self):
        super().__init__(np.linspace(0, 0.1, 200)[:, None] * np.ones(3))
        self.reads, self.writes, self.now = [], [], 0
        self.fails = ""
        self.at: tuple[float, ...] | None = None
        self.fault: str | None = None

    def read(self):
        self.reads.append(self.now)
        if self.fails == "read":
            raise DeviceError("it fails")
        return super().read() if self.at is None else np.array(self.at)

    def write(self, force):
        self.writes.append((self.now, *force))
        if self.fails == "write":
            raise DeviceError("it fails")
        return super().write(force)

    def recover(self):
        self.fails = ""
        return True


def driven(slow, device, ticks, force=(0.0, 0.0, 1.0)):
    found = []
    for device.now in ticks:
        place = slow.read().copy()
        found.append((place, slow.write(np.array(force))))
    return found


@pytest.mark.parametrize(("rate", "turns"), [(250.0, [0, 3, 7, 11, 15, 19]), (1000.0, [*range(20)])])
def test_a_slower_device_is_asked_when_it_is_due_and_held_in_between(rate, turns):
    device = Counter()
    slow = Slower(device, rate, 1000.0)
    with slow:
        found = driven(slow, device, range(20))
    assert device.reads == turns == [tick for tick, *_ in device.writes]
    for tick in range(1, 20):
        assert np.array_equal(found[tick][0], found[tick - 1][0]) or tick in turns
        assert found[tick][1] == pytest.approx([0, 0, 1], abs=2e-3)  # the force that it still puts out


def test_a_slower_device_of_an_odd_rate_gets_its_turns():
    device = Counter()
    with Slower(device, 300.0, 1000.0) as slow:
        driven(slow, device, range(1000))
    assert len(device.reads) == pytest.approx(300, abs=1) and max(np.diff(device.reads)) == 4


def test_a_slower_device_that_is_not_pushed_is_written_when_it_is_due():
    device = Counter()
    with Slower(device, 250.0, 1000.0) as slow:
        driven(slow, device, range(20), (0.0, 0.0, 0.0))
    assert [tick for tick, *_ in device.writes] == device.reads == [0, 3, 7, 11, 15, 19]


@pytest.mark.parametrize("call", ["read", "write"])
def test_a_slower_device_that_is_back_is_let_in_from_where_it_is(call):
    """Its finger was free before the fault, and is deep inside after it: 5 N."""
    device = Counter()
    fingers = Fingers(
        [Slower(device, 125.0, 1000.0)], 1000.0, Safety([8.5], 1000.0, Limits(ramp=0.2)), Diary(1000.0)
    )
    hip, output, found = np.zeros((1, 3)), np.zeros((1, 3)), []
    device.at = (0.0, 0.0, 0.01)
    with fingers:
        for tick in range(300):
            if tick == 16:
                device.fails = call
            if tick == 25:  # it is down
                device.at = (0.0, 0.0, -0.01)
            fingers.read(tick, hip)
            fingers.write(tick, np.maximum(-500 * hip, 0) * [0.0, 0.0, 1.0], output)
            found.append(output[0, 2])
    (fault,) = fingers.faults
    assert fault.tick == 23 and fault.back == 33  # its turn, and the first request
    assert not any(found[:33])
    # Of the ramp it gets a step each time that it is due.
    assert 0 < max(np.diff(found)) < 0.3 and found[-1] == pytest.approx(5.0, abs=2e-3)


def test_no_force_is_passed_on_at_once_and_a_fault_too():
    device = Counter()
    slow = Slower(device, 100.0, 1000.0)
    assert isinstance(slow, RecoverableDevice) and isinstance(slow, GimbalDevice)
    with slow:
        driven(slow, device, range(5))
        assert np.all(slow.write(np.zeros(3)) == 0) and device.writes[-1] == (4, 0, 0, 0)
        device.fails = "read"
        with pytest.raises(DeviceError, match="it fails"):
            driven(slow, device, range(5, 50))
        device.fault = "it has no power"
        assert device.now < 15 and slow.fault == device.fault and slow.recover()
        driven(slow, device, range(20, 21))
        assert device.reads[-1] == 20  # it does not wait for another turn
    with pytest.raises(InputError, match="at most the loop's 1000"):
        Slower(device, 1001.0, 1000.0)
