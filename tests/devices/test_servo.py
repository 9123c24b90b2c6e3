"""The servo loop: what it records is what the step was given and what the devices put out."""

import gc
import os
import threading
import time
from dataclasses import replace
from functools import partial

import jax.numpy as jnp
import numpy as np
import pytest

import hapjax
import hapjax_devices as devices
from hapjax import Body, Box, Contact, InputError, Object, Plane, Scene, Surface, World
from hapjax_devices import servo
from hapjax_devices.session.slower import Slower
from hapjax_devices.virtual import FORCE_STEP


def block(dtype) -> Scene:
    """A block on a floor, to be pushed down by one finger and along by another."""
    block = Object(Box((0.06,) * 3), Surface(800.0, mu=0.6, damping=1.0), Body(0.2), position=(0, 0, 0.03))
    scene = Scene(
        object={"block": block, "floor": Object(Plane())},
        contact={"on_floor": Contact(5000.0, mu=0.5, damping=0.5, between=("block", "floor"))},
        world=World(gravity=(0.0, 0.0, -9.81)),
    )
    return hapjax.cast(scene, dtype)


def fingers(samples=300) -> list[devices.VirtualDevice]:
    t = np.arange(samples) * 1e-3
    down = np.array([[0.0, 0.0, 0.062]]) - np.array([[0.0, 0.0, 1.0]]) * (0.05 * t)[:, None]
    along = np.array([[-0.032, 0.0, 0.03]]) + np.array([[1.0, 0.0, 0.0]]) * (0.05 * t)[:, None]
    return [devices.VirtualDevice(down), devices.VirtualDevice(along)]


def exact_sensors():
    return {
        "force_sensor": devices.ForceSensor(rate=500.0, noise=0.0),
        "pose_tracker": devices.PoseTracker(rate=100.0, place_noise=0.0, angle_noise=0.0),
    }


class Watched:
    """A device that keeps what was done to it, and breaks at a given write."""

    force_limit, resolution = 2.0, 3e-5

    def __init__(self, place, breaks_at=None):
        self.place, self.breaks_at, self.written, self.open_now = np.array(place), breaks_at, [], False

    def open(self):
        self.open_now = True

    def read(self):
        return self.place

    def write(self, force):
        self.written.append(np.array(force))
        if len(self.written) == self.breaks_at:
            raise devices.DeviceError("the cable is out")
        return force

    def close(self):
        self.open_now = False

    def __enter__(self):
        self.open()
        return self

    def __exit__(self, *exception):
        self.close()


@pytest.mark.slow
def test_the_recording_replays(dtype):
    """Through rollout the recorded HIP gives the recorded forces, to the device's step, and poses."""
    scene = block(dtype)
    result = devices.run(scene, fingers(), 0.3, realtime=False, **exact_sensors())
    recording = result.recording
    np.testing.assert_array_equal(recording.hip_t, np.arange(300) / 1000)
    np.testing.assert_array_equal(recording.force_t, np.arange(0, 300, 2) / 1000)
    np.testing.assert_array_equal(recording.pose_t, np.arange(10, 301, 10) / 1000)
    hips = jnp.asarray(recording.hip, dtype)
    np.testing.assert_array_equal(np.asarray(hips, np.float64), recording.hip)
    _, reply = hapjax.rollout(scene, hapjax.init(scene, hips[0]), hips, 1e-3)
    rounding = 2000 * float(jnp.finfo(dtype).eps)
    force = np.asarray(reply.force)[::2]
    assert np.max(np.linalg.norm(force, axis=-1)) > 1.0  # they do push
    assert np.max(np.abs(force - recording.force)) <= FORCE_STEP / 2 + rounding
    assert np.max(np.abs(np.asarray(reply.pose)[9::10] - recording.pose)) <= rounding


@pytest.mark.slow
def test_a_run_is_the_same_each_time_in_real_time_or_not_compiled_before_or_then():
    scene = block(jnp.float32)
    packed = hapjax.pack(scene, np.stack([device.path[0] for device in fingers()]), 1e-3)
    runs = [
        devices.run(
            scene,
            fingers(),
            0.3,
            force_sensor=devices.ForceSensor(seed=1),
            pose_tracker=devices.PoseTracker(seed=1),
            realtime=realtime,
            overrun=10**9,  # on a busy machine too
            packed=given,
        )
        for realtime, given in ((False, None), (True, packed))
    ]
    for channel in ("hip", "hip_t", "force", "force_t", "pose", "pose_t"):
        first, second = (getattr(run.recording, channel) for run in runs)
        np.testing.assert_array_equal(first, second)
    assert runs[0].missed == 0 and np.all(runs[0].lateness_us == 0)
    late = runs[1]
    assert late.lateness_us.shape == late.compute_us.shape == (300,)
    assert np.all(late.lateness_us >= 0) and np.all(late.compute_us > 0)
    assert late.summary()["ticks"] == 300


@pytest.mark.parametrize(("takes", "left", "calls_a_tick"), [(0.0, np.inf, 2), (1e-3, 2e6, 1)])
def test_a_step_is_rehearsed_with_what_its_tick_begins_with(takes, left, calls_a_tick, monkeypatch):
    """Where so many ns are `left`; after a sleep it takes several times as long as in the warm-up."""

    class Clock:
        def __init__(self, rehearsal, needs):
            self.time, self.rehearsal, self.needs = 0, rehearsal, needs

        def now(self):
            return self.time

        def wait(self, deadline):
            self.time = deadline
            if left > self.needs:
                self.rehearsal()

    monkeypatch.setattr(servo, "MonotonicClock", Clock)
    scene, watched = deep()
    packed, given = hapjax.pack(scene, np.array([device.place for device in watched]), 1e-3), []

    def call(memory, hip):
        given.append(np.array(memory))
        time.sleep(takes)
        return packed.call(memory, hip)

    result = devices.run(scene, watched, 0.02, packed=replace(packed, call=partial(call)))
    in_loop = np.array(given[servo.WARM_UP :]).reshape(20, calls_a_tick, -1)
    np.testing.assert_array_equal(in_loop[:, 0], in_loop[:, -1])
    assert not np.array_equal(in_loop[0, 0], in_loop[-1, 0])
    assert np.all(result.step_us >= takes * 1e6) and np.all(result.step_us <= result.compute_us)


def test_the_summary_is_that_of_the_ticks():
    lateness = np.arange(1001.0)
    recording = hapjax.Recording(hip=np.zeros((1, 1, 3)), hip_t=np.zeros(1))
    result = devices.ServoResult(recording, lateness, lateness / 10, lateness / 20, 7, (), ())
    summary = result.summary()
    assert summary["lateness_us"] == pytest.approx({"p50": 500, "p99": 990, "p99.9": 999, "max": 1000})
    assert summary["compute_us"] == pytest.approx({"p50": 50, "p99": 99, "p99.9": 99.9, "max": 100})
    assert summary["step_us"] == pytest.approx({"p50": 25, "p99": 49.5, "p99.9": 49.95, "max": 50})
    assert (summary["ticks"], summary["missed"]) == (1001, 7)


def test_the_rate_sets_the_step():
    """A block in free fall for 0.1 s at 500 Hz: semi-implicit Euler falls g dt^2 n (n + 1) / 2."""
    scene = Scene(
        object={"block": Object(Box((0.06,) * 3), body=Body(0.2))}, world=World(gravity=(0.0, 0.0, -9.81))
    )
    far = [devices.VirtualDevice(np.ones((1, 3)), period=2e-3)]
    tracker = devices.PoseTracker(rate=10.0, place_noise=0.0, angle_noise=0.0)
    recording = devices.run(scene, far, 0.1, 500.0, pose_tracker=tracker, realtime=False).recording
    assert recording.pose is not None and recording.pose.shape == (1, 1, 7) and recording.force is None
    np.testing.assert_allclose(recording.pose[0, 0, 2], -9.81 * 2e-3**2 * 50 * 51 / 2, rtol=1e-12)


RISING, AT_ONCE = devices.Limits(ramp=0.01), devices.Limits(ramp=0.0)


def deep(breaks_at=None):
    """Fingers that push 2 N and 40 N against a fixed wall of 800 N/m; the second is over its limit."""
    scene = Scene(object={"wall": Object(Plane(), Surface(800.0, mu=0.5))})
    return hapjax.cast(scene, jnp.float32), [Watched((0, 0, -0.0025), breaks_at), Watched((0, 0, -0.05))]


def test_commands_keep_to_each_devices_limit_and_end_at_none():
    scene, watched = deep()
    result = devices.run(scene, watched, 0.02, realtime=False, limits=RISING)
    # Both were inside from the start, so their forces rise in 10 ticks: to 2 N, and to far more than the limit.
    assert [(c.limited, c.ramped) for c in result.safety] == [(0, 10), (19, 10)]
    assert result.limited == 19 and result.not_finite == 0
    share = np.arange(20) / 10
    for device, sizes in zip(watched, (np.minimum(share, 1), np.minimum(20 * share, 1)), strict=True):
        np.testing.assert_allclose(np.array(device.written[:-1])[:, 2], 2.0 * sizes, rtol=1e-6)
        np.testing.assert_array_equal(device.written[-1], np.zeros(3))
        assert not device.open_now
    assert result.recording.model_force is not None  # what was wanted, not what was allowed
    np.testing.assert_allclose(
        result.recording.model_force[:, :, 2], np.tile([2.0, 40.0], (20, 1)), rtol=1e-6
    )
    assert [(e.kind, e.finger) for e in result.events if "begins" in e.sentence] == [
        ("ramped", 0),
        ("ramped", 1),
        ("limited", 1),
    ]


def test_a_position_that_is_nan_ends_the_loop_without_force():
    scene, watched = deep()
    watched[1].place = np.array([np.nan, 0.0, 0.0])
    with pytest.raises(devices.DeviceError, match="nan"):
        devices.run(scene, watched, 0.02, realtime=False)
    assert all(np.all(force == 0) for device in watched for force in device.written)


def broken_step(monkeypatch, after, answer):
    """Have the packed step do `answer(memory)` once it has been called `after` times in the loop."""
    real_pack = hapjax.pack

    def pack(*arguments, **options):
        packed = real_pack(*arguments, **options)
        calls = iter(range(servo.WARM_UP + after))

        def call(memory, hip):
            memory = packed.call(memory, hip)
            return memory if next(calls, None) is not None else answer(memory)

        return replace(packed, call=partial(call))

    monkeypatch.setattr(hapjax, "pack", pack)
    monkeypatch.setattr(servo, "_COLD", 10**9)  # nothing is rehearsed: each call is a tick's


def test_a_step_that_answers_nan_pushes_no_one_and_is_counted(monkeypatch):
    scene, watched = deep()
    broken_step(monkeypatch, 5, lambda memory: memory * jnp.nan)
    result = devices.run(scene, watched, 0.02, realtime=False, limits=AT_ONCE)
    assert result.not_finite == 2 * 15 and [c.not_finite for c in result.safety] == [15, 15]
    for device in watched:
        written = np.array(device.written)
        assert np.all(written[1:5, 2] > 1) and np.all(written[5:] == 0)


@pytest.mark.parametrize("realtime", [True, False])
def test_after_an_exception_in_the_step_the_forces_are_off(monkeypatch, realtime):
    def fail(_):
        raise FloatingPointError("the step broke")

    scene, watched = deep()
    broken_step(monkeypatch, 5, fail)
    with pytest.raises(FloatingPointError):
        devices.run(scene, watched, 1.0, realtime=realtime, limits=AT_ONCE)
    for device in watched:
        assert len(device.written) == 6 and np.any(device.written[4] != 0)
        np.testing.assert_array_equal(device.written[-1], np.zeros(3))
        assert not device.open_now
    assert gc.isenabled() and gc.get_freeze_count() == 0


def test_a_device_that_breaks_does_not_keep_the_others_pushing():
    scene, watched = deep(breaks_at=3)
    with pytest.raises(devices.DeviceError, match="cable"):
        devices.run(scene, watched, 1.0, realtime=False)
    np.testing.assert_array_equal(watched[1].written[-1], np.zeros(3))
    assert not watched[0].open_now and not watched[1].open_now


def test_a_device_that_fails_when_it_is_let_go_costs_nothing_but_itself():
    name, heard = f"let-go-{os.getpid()}", []
    scene, watched = deep(breaks_at=21)

    def listen():
        with devices.TickReader(name, 60.0) as reader:
            while not any(event.kind == "end" for event in heard):
                heard.extend(reader.events())
                time.sleep(0.01)

    thread = threading.Thread(target=listen)
    thread.start()
    bus = devices.Broadcast(name, readers=1)
    result = devices.run(scene, watched, 0.02, realtime=False, broadcast=bus)
    thread.join(20)
    assert result.faults == ((19, 0, "the cable is out", None),)
    assert [(e.kind, e.tick, e.finger) for e in result.events if e.kind == "fault"] == [("fault", 19, 0)]
    assert heard[:-1] == list(result.events)
    assert not any(device.open_now for device in watched)
    np.testing.assert_array_equal(watched[1].written[-1], np.zeros(3))


class Slow(Watched):
    """A device that once takes as many ticks as that for an answer, and counts how often it is to forget where it was."""

    def __init__(self, place, ticks):
        super().__init__(place)
        self.ticks, self.forgot = ticks, 0

    def forget(self):
        self.forgot += 1

    def write(self, force):
        if len(self.written) == 30:
            time.sleep((self.ticks + 0.5) * 1e-2)
        return super().write(force)


@pytest.mark.parametrize("late", [1, 5])
def test_after_too_many_missed_ticks_the_next_force_is_none_and_rises(late):
    """At 100 Hz; none is put out after more than 3."""
    scene = hapjax.cast(Scene({"wall": Object(Plane(), Surface(800.0, mu=0.5))}), jnp.float32)
    device = Slow((0, 0, -0.0025), late)
    result = devices.run(scene, [device], 0.6, 100.0, limits=devices.Limits(ramp=0.05), overrun=3)
    sizes = np.array(device.written)[:-1, 2]
    rise = np.concatenate([2.0 * np.arange(5) / 5, np.full(60, 2.0)])
    if result.missed > late:
        pytest.skip("the machine is too busy to be late by so much and no more")
    assert result.missed == late
    expected = rise[:60]
    if late > 3:
        expected = np.concatenate([rise[:31], rise[:29]])
    np.testing.assert_allclose(sizes, expected, rtol=1e-6)
    assert result.overrun == (late > 3) and result.safety[0].ramped == 5 * (1 + (late > 3))
    kinds = {event.kind: event.tick for event in result.events if "begins" in event.sentence}
    assert kinds.get("overrun") == (31 if late > 3 else None) and kinds["missed"] == 31
    assert device.forgot == 1 + (late > 3)  # once at the first tick


def test_fingers_begin_where_they_are_at_the_first_tick():
    """Not where they were seconds before, when the step was compiled: damping would take that for a leap into the wall."""

    class Moved(Watched):
        reads = 0

        def read(self):
            self.reads += 1
            return self.place if self.reads > 1 else np.array([0.0, 0.0, 0.05])

    scene = Scene(object={"wall": Object(Plane(), Surface(800.0, mu=0.5, damping=1.0))})
    scene = hapjax.cast(scene, jnp.float32)
    moved = [Moved((0.0, 0.0, -0.0025)) for _ in range(2)]
    fingers = [moved[0], Slower(moved[1], 200.0, 1000.0)]
    recording = devices.run(scene, fingers, 0.01, realtime=False, limits=RISING).recording
    assert recording.model_force is not None
    np.testing.assert_allclose(recording.model_force, np.tile([0.0, 0.0, 2.0], (10, 2, 1)), atol=1e-6)
    assert moved[1].written[1][2] == pytest.approx(0.6)  # let in 3 ticks before


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"devices": []}, "devices is empty"),
        ({"rate": 0.0}, "rate is 0.0 Hz"),
        ({"rate": float("nan")}, "rate is nan Hz"),
        ({"overrun": -1}, "overrun is -1; allowed: 0 ticks or more"),
        ({"limits": [devices.Limits()]}, "limits has 1 items; allowed: 2, one a device"),
        ({"duration": 0.0}, "duration is 0.0 s"),
        ({"duration": float("inf")}, "duration is inf s"),
        ({"force_sensor": devices.ForceSensor(rate=300.0)}, "force_sensor's rate is 300.0 Hz"),
        ({"force_sensor": devices.ForceSensor(rate=2000.0)}, "force_sensor's rate is 2000.0 Hz"),
        ({"pose_tracker": devices.PoseTracker()}, "no object of the scene has a body"),
    ],
)
def test_refusals(change, said):
    scene, watched = deep()
    arguments = {"devices": watched, "duration": 0.01, "realtime": False} | change
    with pytest.raises(InputError, match=said):
        devices.run(scene, **arguments)
    assert not any(device.open_now for device in watched)


@pytest.mark.parametrize(
    ("fingers", "live", "said"),
    [
        (
            1,
            ["object.wall.surface.mu"],
            r"packed has 1 fingers and the live numbers \['object.wall.surface.mu'\]",
        ),
        (2, ["object.wall.surface.mu"], r"allowed: 2 and \[\], as the devices and live have"),
    ],
)
def test_a_step_of_other_fingers_or_live_numbers_is_refused(fingers, live, said):
    scene, watched = deep()
    packed = hapjax.pack(scene, np.array([device.place for device in watched[:fingers]]), 1e-3, live=live)
    with pytest.raises(InputError, match=said):
        devices.run(scene, watched, 0.01, realtime=False, packed=packed)
    assert not any(device.open_now for device in watched)
