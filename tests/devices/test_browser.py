"""Fingers that a mouse moves: they go where the viewer says, no faster than a hand, and let go when it is silent."""

import os
from contextlib import nullcontext
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from falcon_cases import SteppedClock
from hapjax import InputError
from hapjax_devices import BrowserDevice, DeviceClosed, DeviceError, Operator, RecoverableDevice
from hapjax_devices.browser import HOLD, SILENCE, SPEED
from hapjax_devices.bus import services
from hapjax_devices.operator import Hand
from hapjax_devices.viewer.grip import Grip, closed

START = np.array([0.0, 0.0, 0.1])


class Page:
    """A page that is open, and what its mouse does."""

    def __init__(self, run, fingers, hip):
        self.called: dict[str, Any] = {}  # what drags call
        self.tips = SimpleNamespace(on_drag=lambda f: self.called.update(tip=f))
        self.palm = SimpleNamespace(on_drag=lambda f: self.called.update(palm=f))
        gui = SimpleNamespace(add_folder=nullcontext, add_markdown=lambda _: None, add_slider=self.slider)
        self.grip = Grip(SimpleNamespace(gui=gui), self, run, fingers, np.asarray(hip, np.float64))

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        self.grip.close()

    def slider(self, label, **options):
        self.closing = SimpleNamespace(value=options["initial_value"])
        return self.closing

    def drag(self, on, way, finger=None):
        for phase, part in (("start", 0.0), ("update", 0.5), ("end", 1.0)):
            self.dragged(on, phase, np.array(way) * part, finger)

    def dragged(self, on, phase, way, finger=None, page=0, held=(1.0, 1.0, 1.0)):
        event = SimpleNamespace(phase=phase, instance_index=finger, client_id=page)
        event.start_position, event.end_position = held, tuple(held + np.array(way))
        with pytest.raises(StopIteration):
            self.called[on](event).send(None)


def ticked(devices, clock, count, page=None, force=(0.0, 0.0, 0.0)):
    """Where devices are at each of so many ticks of 1 ms, while a page that is open speaks at 50 Hz."""
    found = []
    for tick in range(count):
        if page is not None and tick % 20 == 0:
            page.grip.send(True)
        found.append([device.read() for device in devices])
        for device in devices:
            device.write(np.array(force))
        clock.time += 1_000_000
    return np.array(found)


@pytest.fixture
def run():
    return f"browser-{os.getpid()}"


def test_a_mouse_that_jumps_is_no_blow(run):
    clock = SteppedClock()
    with BrowserDevice(run, 1, START, clock=clock) as device, Page(run, [1], [START] * 2) as page:
        assert isinstance(device, RecoverableDevice) and device.state == "running"
        assert np.ptp(ticked([device], clock, 50), axis=0).max() < 1e-9  # before the first word, however long
        page.drag("tip", (0.0, 0.0, 0.3), finger=0)  # another's
        page.drag("tip", (0.1, 0.0, 0.0), finger=1)
        way = ticked([device], clock, 1000, page)[:, 0]
    np.testing.assert_allclose(way[-1], START + [0.1, 0, 0], atol=5e-5)
    pace = np.linalg.norm(np.diff(way, axis=0), axis=1) * 1000
    assert pace.max() < 1.2 * SPEED + 0.03  # a hand that catches up, and the encoder's steps
    assert np.argmax(way[:, 0] > 0.09) > 0.09 / SPEED / 1.2 * 1000


def test_the_palm_takes_all_along_and_the_slider_closes_the_hand(run):
    clock, hips = SteppedClock(), START + np.array([[0.04, 0, 0], [-0.04, 0.01, 0], [-0.04, -0.01, 0]])
    devices = [BrowserDevice(run, i, hip, clock=clock) for i, hip in enumerate(hips)]
    with devices[0], devices[1], devices[2], Page(run, [0, 1, 2], hips) as page:
        page.drag("palm", (0.0, 0.0, 0.02))
        np.testing.assert_allclose(ticked(devices, clock, 500, page)[-1], hips + [0, 0, 0.02], atol=5e-5)
        page.closing.value = 5.0
        found = ticked(devices, clock, 500, page)[-1]
    np.testing.assert_allclose(
        found - hips, [[-0.005, 0, 0.02], [0.005, 0, 0.02], [0.005, 0, 0.02]], atol=5e-5
    )
    np.testing.assert_array_equal(closed(hips[:1], 0.005), hips[:1])  # one finger has no other side


def test_two_pages_drag_at_once_and_one_that_closes_leaves_its_finger_where_it_is(run):
    hips = START + np.array([[0.04, 0, 0], [-0.04, 0, 0]])
    with Page(run, [0, 1], hips) as page:
        page.dragged("tip", "start", (0.0, 0.0, 0.0), 0, page=7)
        page.dragged("tip", "update", (0.0, 0.0, 0.01), 0, page=7)
        page.dragged("tip", "start", (0.0, 0.0, 0.0), 1, page=8, held=(5.0, 5.0, 5.0))
        page.dragged("tip", "update", (0.0, 0.02, 0.0), 1, page=8, held=(5.0, 5.0, 5.0))
        page.dragged("tip", "update", (0.0, 0.0, 0.03), 0, page=7)
        wanted = hips + np.array([[0, 0, 0.03], [0, 0.02, 0]])
        np.testing.assert_allclose(page.grip.goals, wanted)
        page.dragged(
            "tip", "start", (0.0, 0.0, 0.0), 0, page=8
        )  # 7 has closed, and never said that it let go
        page.dragged("tip", "end", (0.0, 0.0, 0.01), 0, page=8)
        np.testing.assert_allclose(page.grip.goals, wanted + [[0, 0, 0.01], [0, 0, 0]])


def test_a_hand_yields_to_what_it_presses_on(run):
    clock = SteppedClock()
    with BrowserDevice(run, 0, START, clock=clock) as device:
        way = ticked([device], clock, 500, force=(0.0, 0.0, 2.0))[-1, 0]
    np.testing.assert_allclose(way - START, [0, 0, 2.0 / Hand().stiffness], atol=5e-5)


def test_silence_is_a_hold_and_then_a_fault_until_the_viewer_is_heard_again(run):
    clock = SteppedClock()
    with BrowserDevice(run, 0, START, clock=clock) as device:
        with Page(run, [0], [START]) as page:
            page.drag("tip", (1.0, 0.0, 0.0), finger=0)
            ticked([device], clock, 100, page)
            page.grip.send(False)  # no page is open any more
            way = ticked([device], clock, SILENCE // 1_000_000 - 100)[:, 0, 0]
            rests = way[HOLD // 1_000_000 + 200 :]
            assert np.ptp(rests) < 5e-5 and rests[0] == pytest.approx(
                (80 + HOLD * 1e-6) * SPEED * 1e-3, abs=0.01
            )
            with pytest.raises(
                DeviceError, match="browser's finger 0 is not held: nothing came .* for 3.0 s"
            ):
                ticked([device], clock, 200)
            assert device.state == "faulted" and not np.any(device.output)
            with pytest.raises(DeviceClosed):
                device.read()
            for _ in range(5):
                clock.time += 300_000_000
                assert not device.recover()
            page.grip.send(True)
            assert device.recover() and device.state == "running"
            assert device.read()[0] == pytest.approx(rests[-1], abs=1e-4)  # it is where it was
            ticked([device], clock, 300, page)
            assert device.read()[0] > rests[-1] + 0.04
    with pytest.raises(DeviceClosed):
        device.read()


def test_a_hand_follows_straight_at_a_pace():
    hand = Operator(START[None], 1e-3, Hand(stiffness=1e9))
    hand.follow([0.3, 0.0, 0.5], 0.5)
    places = []
    for _ in range(1200):
        hand.advance(np.zeros(3))
        places.append(hand.goal)
    steps = np.linalg.norm(np.diff([START, *places], axis=0), axis=1)
    assert steps[:999] == pytest.approx(0.5e-3) and np.all(steps[1000:] == 0)
    np.testing.assert_allclose(places[-1], [0.3, 0.0, 0.5])
    with pytest.raises(InputError, match="speed is 0.0 m/s; allowed: above 0"):
        hand.follow(START, 0.0)
    with pytest.raises(InputError, match="allowed: three finite numbers"):
        hand.follow([0, 0, np.nan], 1.0)


def test_another_user_of_the_service_is_told_of_trouble(run, monkeypatch):
    monkeypatch.setattr(services, "hands", lambda *_: 1 / 0)
    with pytest.raises(InputError, match=f"the fingers of {run} is not to be had"):
        BrowserDevice(run, 0, START).open()
