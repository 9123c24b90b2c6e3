"""The servo loop: read the fingers, step the scene, push the fingers, a thousand times a second."""

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass
from itertools import count

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

import hapjax
from hapjax import InputError, Scene
from hapjax.recording import Recording

from .bus import About, Broadcast, Inbox, TickPublisher
from .device import Device, DeviceError, GimbalDevice
from .fingers import DeviceFault, Fingers
from .passivity import Passivity, PassivityControl
from .realtime import MonotonicClock, Pacer, uncollected, undisturbed
from .safety import ForceGuard
from .sensor import ForceSensor, PoseTracker

LAST = 1.0  # s of a run without an end that its result has
WARM_UP = 50  # calls before the first deadline: the first ones of a compiled function are slow


@dataclass(frozen=True)
class ServoResult:
    """What a run of the servo loop leaves behind.

    `recording`; for each tick how late it began, `lateness_us`, and how long it worked, `compute_us` (T,) us;
    `missed` deadlines; how many force commands were `not_finite` or `limited`; `refused`, a sentence for each
    privilege that the system did not grant; `passivity`, what its control saw and did, `None` where it was off; `lost`,
    at how many ticks the scene left the range of sense, and no force was put out; the `faults` of devices that came
    back, or might have; how many ticks the bus did not take, `unsent`. Of a run without an end the recording and the times
    are those of its last second.
    """

    recording: Recording
    lateness_us: Float[np.ndarray, "T"]
    compute_us: Float[np.ndarray, "T"]
    missed: int
    not_finite: int
    limited: int
    refused: tuple[str, ...]
    passivity: PassivityControl | None = None
    lost: int = 0
    faults: tuple[DeviceFault, ...] = ()
    unsent: int = 0

    def summary(self) -> dict[str, dict[str, float] | int]:
        """p50, p99, p99.9 and max of lateness and of compute time in us; ticks done and ticks missed."""
        return {
            "lateness_us": _percentiles(self.lateness_us),
            "compute_us": _percentiles(self.compute_us),
            "ticks": len(self.lateness_us),
            "missed": self.missed,
            "lost": self.lost,
        }


def run(
    scene: Scene,
    devices: Sequence[Device],
    duration: float | None,
    rate: float = 1000.0,
    *,
    force_sensor: ForceSensor | None = None,
    pose_tracker: PoseTracker | None = None,
    realtime: bool = True,
    passivity: Passivity | None = None,
    broadcast: Broadcast | None = None,
    stopped: Callable[[], bool] | None = None,
    live: Sequence[str] = (),
) -> ServoResult:
    """Let the fingers on `devices` feel a scene for `duration` seconds, and record it.

    The recording's clock is the servo clock: tick n is at n / rate. `hip` is exactly what the step got. The
    forces of tick n push until tick n + 1 and are measured at tick n; its poses are those that the step
    ends with, and are measured at tick n + 1. The forces are off again when the loop ends, in whatever way
    it does.

    **Arguments:**

    - `devices`, one a finger; `run` opens and closes them.
    - `duration` in s; `None`: until `stopped`, with the last second as the recording.
    - `rate` in Hz, above 0; the step's dt is 1 / rate, whatever the scene's integrator says.
    - `force_sensor`, `pose_tracker`: each measures at every tick that is its turn, so its rate goes a whole
        number of times into the loop's. `None`: the recording is without that channel.
    - `realtime`: `False` runs as fast as it can, with the same recording on virtual devices.
    - `passivity`: keeps each device passive by damping it where its loop gives out energy. `None`: off, at no cost.
    - `broadcast`: puts every tick on the bus, for a recorder or a display in a process of its own. `None`: off, at no cost.
    - `stopped`: is asked after each tick whether that was the last.
    - `live`: paths of numbers of the scene, such as `object.cube.surface.mu`, that other processes may change while the loop
        goes on; see `Numbers`. They need a `broadcast`.

    A scene whose torsion is a gimbal needs devices that are each a `GimbalDevice`; the recording then has the channel
    `gimbal`, exactly what the step got.

    While a `RecoverableDevice` has a fault, its finger stays where it was and gets no force, and the others go on; its
    force rises over 0.5 s once it is back.

    **Raises:** `InputError` for arguments out of range; `DeviceError` from a device that is not a `RecoverableDevice`, or
    that does not even open, and where one reads NaN.
    """
    ticks = _ticks(duration, rate)
    if live and broadcast is None:
        raise InputError(f"live is {', '.join(live)} without a broadcast; allowed: with one")
    turned = scene.torsion is not None and scene.torsion.needs_gimbal
    if turned and not all(isinstance(device, GimbalDevice) for device in devices):
        raise InputError(
            "the scene's torsion is a gimbal, but a device has no read_gimbal; allowed: a GimbalDevice for each finger"
        )
    if not devices:
        raise InputError("devices is empty; allowed: one device or more")
    if pose_tracker is not None and not scene.moving():
        raise InputError(
            "pose_tracker is given, but no object of the scene has a body; allowed: no pose_tracker"
        )
    with ExitStack() as stack:
        for device in devices:
            stack.enter_context(device)
        hip = np.stack([device.read() for device in devices])
        gimbals = [device for device in devices if isinstance(device, GimbalDevice)] if turned else []
        angles = [np.array([device.read_gimbal() for device in gimbals])] if turned else []
        packed = hapjax.pack(scene, hip, 1 / rate, *angles, live=live)
        log = _Log(ticks, rate, packed, force_sensor, pose_tracker, turned)
        guard = ForceGuard(np.array([device.force_limit for device in devices]))
        control = None if passivity is None else PassivityControl(passivity, 1 / rate, hip)
        bus = inbox = None
        if broadcast is not None:
            places = _pose_places(packed).tolist() if scene.moving() else []
            about = About.of(broadcast.run, rate, scene, packed, places, devices, len(gimbals))
            bus = stack.enter_context(TickPublisher(about))
            inbox = stack.enter_context(Inbox(about, scene, bus)) if live else None
            bus.wait_for(broadcast.readers, broadcast.patience)
        for _ in range(WARM_UP):
            packed.force(packed.call(packed.start, *(x.astype(packed.dtype) for x in (hip, *angles))))
        stack.enter_context(uncollected())
        refused = stack.enter_context(undisturbed() if realtime else nullcontext([]))
        fingers = Fingers(devices, rate)
        stack.enter_context(fingers.let_go())
        pacer = Pacer(round(1e9 / rate), MonotonicClock()) if realtime else None
        _loop(packed, fingers, hip, gimbals, guard, control, log, pacer, bus, inbox, stopped)
    missed = 0 if pacer is None else pacer.missed
    recording = log.recording()
    lateness_us, compute_us = log.times()
    return ServoResult(
        recording,
        lateness_us,
        compute_us,
        missed,
        guard.not_finite,
        guard.limited,
        tuple(refused),
        control,
        log.lost,
        tuple(fingers.faults),
        0 if bus is None else bus.unsent,
    )


def _loop(
    packed: hapjax.PackedStep,
    fingers: Fingers,
    first: Float[np.ndarray, "F 3"],
    gimbals,
    guard: ForceGuard,
    control: PassivityControl | None,
    log: "_Log",
    pacer: Pacer | None,
    bus: TickPublisher | None,
    inbox: Inbox | None,
    stopped: Callable[[], bool] | None,
) -> None:
    memory, hip = packed.start, first.astype(packed.dtype)
    angle = np.empty(len(gimbals), packed.dtype)
    inputs = (hip, angle) if gimbals else (hip,)
    output = np.empty((packed.fingers, 3))
    for tick in count() if log.ticks is None else range(log.ticks):
        late = 0 if pacer is None else pacer.wait()
        began = time.perf_counter_ns()
        fingers.read(tick, hip)
        for finger, device in enumerate(gimbals):
            angle[finger] = device.read_gimbal()
        if not np.isfinite(hip).all():
            raise DeviceError(f"tick {tick}: the devices read {hip.tolist()} m; a position must be finite")
        if not np.isfinite(angle).all():
            raise DeviceError(f"tick {tick}: the gimbals read {angle.tolist()} rad; an angle must be finite")
        if inbox is not None:
            memory = inbox.put(tick, memory)
        memory = packed.call(memory, *inputs)
        lost = packed.is_lost(memory)
        log.lost += lost
        force = guard(packed.force(memory))
        if control is not None:
            damped = control(force, hip)
            force = force if lost else guard(damped)
        fingers.write(tick, force, output)
        if control is not None:
            control.put_out(output)
        log.add(tick, hip, angle, output, memory)
        if bus is not None:
            worked = (time.perf_counter_ns() - began) * 1e-3
            missed = 0 if pacer is None else pacer.missed
            counts = (missed, guard.not_finite, guard.limited, log.lost)
            bus.publish(tick, began, late * 1e-3, worked, counts, fingers, hip, angle, output, memory)
        log.time(tick, late * 1e-3, (time.perf_counter_ns() - began) * 1e-3)
        if stopped is not None and stopped():
            break


class _Log:
    """The arrays of a recording, all made before the loop begins; of a run without an end, of its last second."""

    def __init__(self, ticks, rate, packed: hapjax.PackedStep, force_sensor, pose_tracker, turned: bool):
        self._rate, self.ticks, self._done = rate, ticks, 0
        self._force_sensor, self._pose_tracker = force_sensor, pose_tracker
        kept = max(1, round(LAST * rate)) if ticks is None else ticks
        self.hip = np.zeros((kept, packed.fingers, 3))
        self.gimbal = np.zeros((kept, packed.fingers)) if turned else None
        self._times = np.zeros((2, kept))
        self.lost = 0
        if force_sensor is not None:
            self._force_every = _every("force_sensor", force_sensor.rate, rate)
            self._force = np.zeros((-(-kept // self._force_every), packed.fingers, 3))
        if pose_tracker is not None:
            self._pose_every = _every("pose_tracker", pose_tracker.rate, rate)
            self._pose_at = _pose_places(packed)
            self._pose = np.zeros((kept // self._pose_every, *self._pose_at.shape))

    def add(self, tick: int, hip, angle, output, memory) -> None:
        """Note what a tick got, put out and moved."""
        row = tick % len(self.hip)
        self.hip[row] = hip
        if self.gimbal is not None:
            self.gimbal[row] = angle
        if self._force_sensor is not None and tick % self._force_every == 0:
            self._force[tick // self._force_every % len(self._force)] = self._force_sensor.measure(output)
        if self._pose_tracker is not None and (tick + 1) % self._pose_every == 0:
            pose = np.asarray(memory)[self._pose_at]
            self._pose[tick // self._pose_every % len(self._pose)] = self._pose_tracker.measure(pose)

    def time(self, tick: int, lateness_us: float, compute_us: float) -> None:
        """Note how late a tick began and how long it worked: it is done."""
        self._times[:, tick % len(self.hip)] = lateness_us, compute_us
        self._done = tick + 1

    def times(self) -> Float[np.ndarray, "2 T"]:
        """Lateness and work, us."""
        return _kept(self._times.T, self._done)[1].T

    def recording(self) -> Recording:
        """What was logged."""
        ticks, hip = _kept(self.hip, self._done)
        channels = {"hip": hip, "hip_t": ticks / self._rate}
        if self.gimbal is not None:
            channels |= {"gimbal": _kept(self.gimbal, self._done)[1], "gimbal_t": channels["hip_t"]}
        if self._force_sensor is not None:
            samples, force = _kept(self._force, -(-self._done // self._force_every))
            channels |= {"force": force, "force_t": samples * self._force_every / self._rate}
        if self._pose_tracker is not None and self._done >= self._pose_every and len(self._pose):
            samples, pose = _kept(self._pose, self._done // self._pose_every)
            channels |= {"pose": pose, "pose_t": (samples + 1) * self._pose_every / self._rate}
        return Recording(**channels)


def _kept(ring: Float[np.ndarray, "K ..."], count: int) -> tuple[np.ndarray, np.ndarray]:
    """Of so many rows that were put into a ring the numbers of those that it has still, and these rows."""
    rows = np.arange(max(0, count - len(ring)), count)
    return rows, ring[rows % len(ring)]


def _pose_places(packed: hapjax.PackedStep) -> np.ndarray:
    """Where in the memory the numbers of each object's pose are, (O, 7)."""
    # The memory's own places, taken apart as if they were a state. Unpacking itself is too slow for the loop.
    places = packed.state(jnp.arange(len(packed.start), dtype=packed.dtype))
    rows = [np.concatenate([m.position, m.orientation]) for m in places.motion.values()]
    return np.stack(rows).astype(int)


def _ticks(duration: float | None, rate: float) -> int | None:
    if not 0 < rate < np.inf:
        raise InputError(f"rate is {rate} Hz; allowed: above 0")
    if duration is None:
        return None
    if not 1 <= duration * rate < 1e9:
        raise InputError(f"duration is {duration} s; allowed: at least one period of {1 / rate:g} s, finite")
    return round(duration * rate)


def _every(name: str, sensor_rate: float, rate: float) -> int:
    every = round(rate / sensor_rate)
    if every < 1 or abs(every * sensor_rate - rate) > 1e-6 * rate:
        raise InputError(
            f"{name}'s rate is {sensor_rate} Hz; allowed: the loop's {rate} Hz divided by a whole number"
        )
    return every


def _percentiles(values: Float[np.ndarray, "T"]) -> dict[str, float]:
    p50, p99, p999 = np.percentile(values, [50, 99, 99.9]).tolist()
    return {"p50": p50, "p99": p99, "p99.9": p999, "max": float(np.max(values))}
