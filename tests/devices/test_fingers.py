"""A loop's devices: one that fails gets no force and comes back, and the others do not notice."""

import numpy as np
import pytest

from hapjax_devices import DeviceError, Limits, Safety
from hapjax_devices.event import Diary
from hapjax_devices.fingers import Fingers

PUSH = np.array([[1.0, 0.0, -2.0], [0.0, 3.0, 0.0]])


class Plain:
    """A device that fails in the calls whose numbers it is given, and keeps what was written."""

    force_limit, resolution = 8.0, 1e-5

    def __init__(self, fails=()):
        self.fails, self.calls, self.written = fails, 0, []

    def _call(self):
        self.calls += 1
        if self.calls in self.fails:
            raise DeviceError("the cable is out")

    def open(self):
        self.is_open = True

    def read(self):
        self._call()
        return np.full(3, 0.001 * self.calls)

    def write(self, force):
        self._call()
        self.written.append(np.array(force))
        return force

    def close(self):
        self.is_open = False

    def __enter__(self):
        return self

    def __exit__(self, *exception): ...


class Recoverable(Plain):
    """One that is back after `patience` requests."""

    def __init__(self, fails=(), patience=2):
        super().__init__(fails)
        self.patience, self.asked = patience, []

    def recover(self):
        self.asked.append(True)
        return len(self.asked) >= self.patience


def fingers_on(devices, rate=1000.0, ramp=0.5) -> tuple[Fingers, Diary]:
    """Fingers that are in already, and what happens to them."""
    diary, count = Diary(rate), len(devices)
    safety = Safety([8.0] * count, rate, Limits(ramp=ramp), diary)
    for finger in range(count):
        safety(-1, finger, (0.0, 0.0, 0.0))
    return Fingers(devices, rate, safety, diary), diary


def loop(first, ticks, rate=1000.0):
    """Where the fingers were and what was put out, tick by tick, with `first` beside one that never fails."""
    fingers, other = fingers_on([first, Plain()], rate)[0], []
    hip, output, hips = np.zeros((2, 3)), np.zeros((2, 3)), []
    for tick in range(ticks):
        fingers.read(tick, hip)
        hips.append(hip.copy())
        fingers.write(tick, PUSH, output)
        other.append(output.copy())
    return fingers, np.array(hips), np.array(other)


@pytest.mark.parametrize(("call", "tick"), [(7, 3), (8, 3)])  # a read, and the write after it
def test_it_gets_no_force_until_it_is_back(call, tick):
    fingers, hips, outputs = loop(Recoverable(fails=[call]), 700)
    (fault,) = fingers.faults
    # Asked every 10 ticks, and back at the second time; then half a second to the full force.
    assert fault == (tick, 0, "the cable is out", tick + 20)
    assert np.array_equal(outputs[:tick, 0], np.tile(PUSH[0], (tick, 1)))
    assert not outputs[tick : tick + 20, 0].any()
    part = np.clip((np.arange(tick + 20, 700) - (tick + 20)) / 500, 0, 1)
    np.testing.assert_allclose(outputs[tick + 20 :, 0], part[:, None] * PUSH[0])
    assert np.ptp(hips[tick : tick + 20, 0], axis=0).max() == 0
    assert np.array_equal(outputs[:, 1], np.tile(PUSH[1], (700, 1))) and np.all(
        np.diff(hips[:, 1], axis=0) > 0
    )


def test_a_slow_loop_asks_each_tick():
    fingers, _, outputs = loop(Recoverable(fails=[3], patience=3), 60, rate=100.0)
    assert fingers.faults[0].back == 1 + 3
    assert not outputs[4, 0].any() and np.array_equal(outputs[54:, 0], np.tile(PUSH[0], (6, 1)))


def test_one_that_fails_again_is_told_of_again():
    device = Recoverable(fails=[3, 4], patience=1)  # the second is the read with which it is back
    fingers, _, _ = loop(device, 40)
    assert [(fault.tick, fault.back) for fault in fingers.faults] == [(1, 11), (11, 21)]


def test_one_that_cannot_come_back_ends_the_loop():
    with pytest.raises(DeviceError, match="the cable is out"):
        loop(Plain(fails=[5]), 10)


def test_faults_are_told_with_their_finger():
    device = Recoverable(fails=[3, 4], patience=1)
    fingers, diary = fingers_on([Plain(), device])
    hip, output = np.zeros((2, 3)), np.zeros((2, 3))
    for tick in range(25):
        diary.turn(tick, tick)
        fingers.read(tick, hip)
        fingers.write(tick, PUSH, output)
    back = "the device is back; its force rises"
    told = [(event.kind, event.tick, event.sentence) for event in diary.events if event.finger == 1]
    assert told[:5] == [
        ("fault", 1, "the cable is out"),
        ("back", 11, back),
        ("fault", 11, "the cable is out"),
        ("back", 21, back),
        ("ramped", 21, "forces of a finger that is let in again, rising: begins at tick 21"),
    ]
    assert all(event.finger == 1 for event in diary.events)
    first = diary.events[0]
    assert first.said(2) == "finger 1: the cable is out" and first.said(1) == "the cable is out"
    assert first._replace(finger=-1).said(2) == "the cable is out"


def test_what_is_in_a_devices_way_is_told_once_until_it_is_back():
    class Telling(Recoverable):
        def recover(self):
            self.fault = (
                None
                if len(self.asked) % 5 == 4
                else ["no power", "it counts 17", "it counts -4"][len(self.asked) % 3]
            )
            self.asked.append(True)
            return self.fault is None

    device = Telling(fails=[3, 9])
    fingers, diary = fingers_on([device])
    hip, output = np.zeros((1, 3)), np.zeros((1, 3))
    for tick in range(120):
        fingers.read(tick, hip)
        fingers.write(tick, PUSH[:1], output)
    told = [event.sentence for event in diary.events if event.kind in ("fault", "back")]
    back = "the device is back; its force rises"
    assert told == [
        *("the cable is out", "no power", "it counts 17", back),
        *("the cable is out", "it counts -4", "no power", back),
    ]


def test_all_are_let_go_though_one_fails():
    failing, down, fine = Recoverable(fails=[1]), Recoverable(fails=[1]), Plain()
    fingers, diary = fingers_on([failing, down, fine])
    with fingers, fingers.let_go():
        failing.calls = 0
        hip = np.zeros((3, 3))
        failing.fails = ()
        fingers.read(0, hip)  # here the second goes down
        failing.fails = [failing.calls + 1]  # and this one when it is let go
    assert [fault.finger for fault in fingers.faults] == [1, 0] and not down.written
    assert [(event.kind, event.finger) for event in diary.events] == [("fault", 1), ("fault", 0)]
    np.testing.assert_array_equal(fine.written, np.zeros((1, 3)))
    assert not any(device.is_open for device in (failing, down, fine))


def test_what_fails_when_it_is_closed_is_noted_and_no_more():
    class Stuck(Plain):
        def close(self):
            super().close()
            raise DeviceError("the claw is stuck")

    devices = Plain(), Stuck(), Plain()
    fingers, diary = fingers_on(devices)
    with fingers:
        assert all(device.is_open for device in devices)
    assert not any(device.is_open for device in devices)
    assert fingers.faults == [(-1, 1, "the claw is stuck", None)] and diary.events[0].kind == "fault"


def test_where_one_does_not_open_those_before_are_closed():
    class Missing(Plain):
        def open(self):
            raise DeviceError("it is not attached")

    first, last = Plain(), Plain()
    with pytest.raises(DeviceError, match="not attached"), fingers_on([first, Missing(), last])[0]:
        raise AssertionError
    assert first.is_open is False and not hasattr(last, "is_open")
