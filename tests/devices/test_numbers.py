"""Live numbers: what another process gives the servo counts from one tick on, and no tick is lost for it."""

import os
import threading
import time
from typing import Any

import numpy as np
import pytest

import hapjax
import hapjax_devices as devices
from hapjax_devices.bus import Inbox, services

MU, STIFFNESS = "object.table.surface.mu", "object.table.surface.stiffness"


def table(dtype: type[np.floating] | type[float] = float):
    made = hapjax.Scene({"table": hapjax.Object(hapjax.Plane(), hapjax.Surface(800.0, mu=0.6))})
    return hapjax.cast(made, dtype)


def rubbing():
    """A finger that is pushed to and fro, 2 mm deep, by a hand that does not yield; without rounding."""
    t = np.arange(200) * 1e-3
    x = 0.02 * np.abs(t / 0.1 - 1)
    path = np.stack([x, 0 * t, np.full_like(t, -2e-3)], axis=1)
    hand = devices.Hand(stiffness=1e9)
    return devices.VirtualDevice(path, 1e-3, hand, resolution=1e-9, force_step=1e-9, again=True)


def with_numbers_given(name, give, dtype=float):
    """What `give` returns, called while a loop runs in a thread of its own, and the ticks and events of that loop."""
    name, over = f"{name}-{os.getpid()}", []
    options: Any = dict(
        stopped=lambda: bool(over), live=(MU, STIFFNESS), broadcast=devices.Broadcast(name, 2)
    )
    loop = threading.Thread(target=devices.run, args=(table(dtype), [rubbing()], None), kwargs=options)
    loop.start()
    try:
        with devices.TickReader(name, 60.0) as reader, devices.Numbers(name, 60.0) as numbers:
            before = ticks_of(reader, 50)
            given = give(numbers)
            after = ticks_of(reader, 100)
            over.append(True)
            loop.join()
            return given, np.concatenate([before, after, reader.take()]), reader.events()
    finally:
        over.append(True)


def ticks_of(reader, count):
    """The next ticks of a run, as many as this or more, however long it takes to begin."""
    ticks, until = [reader.take()], time.monotonic() + 60
    while sum(map(len, ticks)) < count:
        assert time.monotonic() < until, "the run does not go on"
        time.sleep(5e-3)
        ticks.append(reader.take())
    return np.concatenate(ticks)


def reader_of(bus):
    """A reader of a publisher in this process, which has to look for it."""
    thread = threading.Thread(target=bus.wait_for, args=(1, 5.0))
    thread.start()
    reader = devices.TickReader(bus.run)
    thread.join()
    return reader


def test_new_numbers_count_from_one_tick_on_and_none_is_lost(dtype):
    name = f"numbers-{np.dtype(dtype).name}"
    changed, ticks, events = with_numbers_given(name, lambda n: n.set({MU: 0.25, STIFFNESS: 400.0}), dtype)
    assert isinstance(changed, int) and changed > 0, changed
    np.testing.assert_array_equal(np.diff(ticks["tick"]), 1)
    along, _, normal = np.abs(ticks["memory"][:, :3]).T  # as the model answers, whatever the device is told
    before, after = ticks["tick"] < changed, ticks["tick"] >= changed
    after_it = np.flatnonzero(after)
    np.testing.assert_allclose(normal[before], 1.6, rtol=1e-5)
    np.testing.assert_allclose(normal[after_it[:-1]], 0.8, rtol=1e-5)
    assert along[after_it[20:]].max() == pytest.approx(0.25 * 0.8, rel=1e-4)
    events = [event for event in events if event.kind in ("numbers", "refused")]
    assert ["numbers"] == [event.kind for event in events]
    assert f"from tick {changed} on" in events[0].sentence and f"{MU} is 0.25" in events[0].sentence


def test_the_sender_refuses_what_no_scene_can_have():
    def give(numbers):
        said = []
        for values in (
            {MU: -0.1},
            {STIFFNESS: np.nan},
            {"object.table.surface.damping": 1.0},
            {MU: [1.0, 2.0]},
        ):
            with pytest.raises(hapjax.InputError) as refused:
                numbers.set(values)
            said.append(str(refused.value))
        return said, numbers.now(), numbers.about.live_at

    (said, now, places), ticks, events = with_numbers_given("numbers-refused", give)
    assert "-0.1" in said[0] and "0 or above" in said[0] and "nan" in said[1]
    assert "not live" in said[2] and STIFFNESS in said[2] and "(2,)" in said[3]
    assert {path: float(value) for path, value in now.items()} == {MU: 0.6, STIFFNESS: 800.0}
    assert not [event for event in events if event.kind in ("numbers", "refused")]
    assert np.ptp(ticks["memory"][:, places], axis=0).max() == 0


@pytest.fixture
def inbox():
    """The servo's end, its memory, how to send to it unchecked, and a reader of what it says."""
    scene = table(np.float32)
    packed = hapjax.pack(scene, np.zeros((1, 3), np.float32), live=(MU, STIFFNESS))
    name = f"inbox-{os.getpid()}"
    about = devices.About.of(name, 1000.0, scene, packed, [], 0)
    with devices.TickPublisher(about) as bus, Inbox(about, scene, bus) as made:
        node = services.join(name)
        port = services.numbers(node, name, about.numbers).publisher_builder().create()
        with reader_of(bus) as reader:

            def send(*values):
                services.send(port, "Numbers", np.array([(values,)], about.numbers))

            made.put(0, packed.start)  # the servo's end notices that there is a sender
            yield made, packed, send, reader


@pytest.mark.parametrize(
    "values", [(np.nan, 500.0), (np.inf, 500.0), (0.3, 1e39), (-0.1, 500.0), (0.3, 0.0), (0.3, -1.0)]
)
def test_the_servo_refuses_what_it_is_sent_all_the_same(values, inbox):
    made, packed, send, reader = inbox
    send(*values)
    assert made.put(7, packed.start) is packed.start
    send(0.0, 500.0)
    memory = made.put(8, packed.start)
    assert memory[packed.live[MU]] == 0 and memory[packed.live[STIFFNESS]] == 500
    others = np.delete(np.arange(len(memory)), made._places)
    np.testing.assert_array_equal(memory[others], packed.start[others])
    assert [event.kind for event in reader.events()] == ["refused"]  # a tick later
    made.put(9, memory)
    assert [event.kind for event in reader.events()] == ["numbers"]


def test_of_several_the_newest_counts_and_the_same_again_is_no_news(inbox):
    made, packed, send, reader = inbox
    for mu in (0.1, 0.2, 0.3):
        send(mu, 500.0)
    memory = made.put(1, packed.start)
    assert memory[packed.live[MU]] == np.float32(0.3)
    send(0.3, 500.0)
    assert made.put(2, memory) is memory and made.put(3, memory) is memory
    assert len(reader.events()) == 1


def test_one_who_sends_may_be_there_before_the_servo_listens():
    scene = table()
    packed = hapjax.pack(scene, np.zeros((1, 3)), live=(MU, STIFFNESS))
    about = devices.About.of(f"early-{os.getpid()}", 1000.0, scene, packed, [], 0)
    with devices.TickPublisher(about) as bus:
        thread = threading.Thread(target=bus.wait_for, args=(1, 5.0))
        thread.start()
        with devices.Numbers(bus.run) as numbers, Inbox(about, scene, bus) as made:
            thread.join()
            made.put(0, packed.start)
            services.send(numbers._port, "Numbers", np.array([([0.3, 500.0],)], about.numbers))
            assert made.put(1, packed.start)[packed.live[MU]] == 0.3


def test_a_run_without_live_numbers_says_so():
    about = devices.About.of(
        f"no-live-{os.getpid()}", 1000.0, table(), hapjax.pack(table(), np.zeros((1, 3))), [], 0
    )
    with devices.TickPublisher(about) as bus:
        thread = threading.Thread(target=bus.wait_for, args=(1, 1.5))
        thread.start()
        with pytest.raises(hapjax.InputError, match="no live numbers"):
            devices.Numbers(bus.run)
        thread.join()
    with pytest.raises(hapjax.InputError, match="without a broadcast"):
        devices.run(table(), [rubbing()], 1.0, live=(MU,))


# Runs without an end ----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_run_without_an_end_goes_on_until_it_is_stopped_and_keeps_its_last_second():
    calls = iter([False] * 2499 + [True])
    sensor = devices.ForceSensor(rate=500.0, noise=0.0)
    result = devices.run(
        table(), [rubbing()], None, 1000.0, force_sensor=sensor, realtime=False, stopped=lambda: next(calls)
    )
    whole = devices.run(table(), [rubbing()], 2.5, 1000.0, force_sensor=sensor, realtime=False).recording
    kept = result.recording
    assert kept.hip_t is not None and whole.hip is not None and whole.force is not None
    np.testing.assert_allclose(kept.hip_t, 1.5 + np.arange(1000) / 1000)
    np.testing.assert_array_equal(kept.hip, whole.hip[1500:])
    np.testing.assert_array_equal(kept.force, whole.force[750:])
    assert len(result.lateness_us) == 1000 and next(calls, None) is None


def test_a_run_with_an_end_can_be_stopped_before_it():
    calls = iter([False] * 49 + [True])
    result = devices.run(table(), [rubbing()], 9.0, realtime=False, stopped=lambda: next(calls))
    assert result.recording.hip_t is not None and len(result.recording.hip_t) == 50 == len(result.compute_us)
