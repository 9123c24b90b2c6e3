"""The servo loop: read the fingers, step the scene, push the fingers, a thousand times a second."""

import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack, nullcontext
from dataclasses import dataclass
from itertools import count

import numpy as np
from jaxtyping import Float

import hapjax
from hapjax import InputError, Scene
from hapjax.recording import Recording

from .bus import About, Broadcast, Inbox, TickPublisher
from .bus.about import pose_places
from .device import Device, DeviceError, GimbalDevice
from .ending import Ending
from .event import Diary, Event
from .fingers import DeviceFault, Fingers
from .passivity import Passivity, PassivityControl
from .realtime import MonotonicClock, Pacer, uncollected, undisturbed
from .safety import Counts, Limits, Safety
from .sensor import ForceSensor, PoseTracker

LAST = 1.0  # s of a run without an end that its result has
WARM_UP = 50  # calls before the first deadline: the first ones of a compiled function are slow
_COLD = 4  # so many times as long as one of many in a row takes a call after a sleep


@dataclass(frozen=True)
class ServoResult:
    """What a run of the servo loop leaves behind.

    `recording`; for each tick how late it began, `lateness_us`, how long it worked, `compute_us`, and how long of that
    the step took, `step_us` (T,) us; `missed` deadlines; `safety`, how many force commands of each device were changed;
    `refused`, a sentence for each privilege that the system did not grant; `passivity`, what its control saw and did,
    `None` where it was off; `lost`, at how many ticks the scene left the range of sense, and no force was put out; the
    `faults` of devices that came back, or might have, or failed when they were let go; how many ticks the bus did not
    take, `unsent`; `overrun`, how many ticks came far too late; `events`, all that happened, in words. Of a run without
    an end the recording and the times are those of its last second.
    """

    recording: Recording
    lateness_us: Float[np.ndarray, "T"]
    compute_us: Float[np.ndarray, "T"]
    step_us: Float[np.ndarray, "T"]
    missed: int
    safety: tuple[Counts, ...]
    refused: tuple[str, ...]
    passivity: PassivityControl | None = None
    lost: int = 0
    faults: tuple[DeviceFault, ...] = ()
    unsent: int = 0
    overrun: int = 0
    events: tuple[Event, ...] = ()

    @property
    def not_finite(self) -> int:
        """How many forces of all devices were not finite."""
        return sum(counts.not_finite for counts in self.safety)

    @property
    def limited(self) -> int:
        """How many forces were over their device's limit."""
        return sum(counts.limited for counts in self.safety)

    def summary(self) -> dict[str, dict[str, float] | int]:
        """p50, p99, p99.9 and max of lateness, of work and of the step in us; ticks done and ticks missed."""
        return {
            "lateness_us": _percentiles(self.lateness_us),
            "compute_us": _percentiles(self.compute_us),
            "step_us": _percentiles(self.step_us),
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
    limits: Limits | Sequence[Limits] = Limits(),  # noqa: B008
    overrun: int = 20,
    packed: hapjax.PackedStep | None = None,
) -> ServoResult:
    """Let the fingers on `devices` feel a scene for `duration` seconds, and record it.

    The recording's clock is the servo clock: tick n is at n / rate. `hip` is exactly what the step got, and
    `model_force` exactly what it answered: through `hapjax.rollout` the one gives the other, to the last bit. The forces
    of tick n push until tick n + 1 and are measured at tick n; its poses are those that the step ends with, and are
    measured at tick n + 1. The forces are off again when the loop ends, in whatever way it does.

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
    - `limits`: what the devices may be told to do, of all of them or of each; see `Limits` and `Safety`.
    - `overrun`: after more deadlines missed at once than this, 0 or above, no force is put out, and the fingers are let in
        anew.
    - `packed`: the step, compiled before: of this scene, with this `rate` and these `live` paths. `None`: it is compiled.

    A scene whose torsion is a gimbal needs devices that are each a `GimbalDevice`; the recording then has the channel
    `gimbal`, exactly what the step got.

    While a `RecoverableDevice` has a fault, its finger stays where it was and gets no force, and the others go on; once it
    is back it is let in. Signals that end the process end the loop first: see `Ending`.

    **Raises:** `InputError` for arguments out of range; `DeviceError` from a device that is not a `RecoverableDevice`, or
    that does not even open, and where one reads NaN.
    """
    ticks = _ticks(duration, rate)
    if not isinstance(overrun, int) or isinstance(overrun, bool) or overrun < 0:
        raise InputError(f"overrun is {overrun!r}; allowed: 0 ticks or more")
    if live and broadcast is None:
        raise InputError(f"live is {', '.join(live)} without a broadcast; allowed: with one")
    turned = scene.torsion is not None and scene.torsion.needs_gimbal
    if turned and not all(isinstance(device, GimbalDevice) for device in devices):
        raise InputError(
            "the scene's torsion is a gimbal, but a device has no read_gimbal; allowed: a GimbalDevice for each finger"
        )
    if not devices:
        raise InputError("devices is empty; allowed: one device or more")
    if packed is not None and (packed.fingers != len(devices) or set(packed.live) != set(live)):
        raise InputError(
            f"packed has {packed.fingers} fingers and the live numbers {sorted(packed.live)}; allowed: "
            f"{len(devices)} and {sorted(live)}, as the devices and live have"
        )
    if pose_tracker is not None and not scene.moving():
        raise InputError(
            "pose_tracker is given, but no object of the scene has a body; allowed: no pose_tracker"
        )
    diary = Diary(rate)
    safety = Safety([device.force_limit for device in devices], rate, limits, diary)
    fingers = Fingers(devices, rate, safety, diary)
    with ExitStack() as stack:
        ending, last = stack.enter_context(Ending()), stack.enter_context(ExitStack())
        stack.enter_context(fingers)
        hip = np.stack([device.read() for device in devices])
        gimbals = [device for device in devices if isinstance(device, GimbalDevice)] if turned else []
        angles = [np.array([device.read_gimbal() for device in gimbals])] if turned else []
        if packed is None:
            packed = hapjax.pack(scene, hip, 1 / rate, *angles, live=live)
        log = _Log(ticks, rate, packed, force_sensor, pose_tracker, turned)
        control = None if passivity is None else PassivityControl(passivity, 1 / rate, hip)
        bus = inbox = None
        if broadcast is not None:
            about = About.of(broadcast.run, rate, scene, packed, devices, len(gimbals))
            bus = last.enter_context(TickPublisher(about))
            last.callback(_tell_all, diary, bus)
            inbox = stack.enter_context(Inbox(about, scene, bus)) if live else None
            bus.wait_for(broadcast.readers, broadcast.patience)
        cold = _COLD * _warmed_up(packed, [x.astype(packed.dtype) for x in (hip, *angles)])
        stack.enter_context(uncollected())
        refused = stack.enter_context(undisturbed() if realtime else nullcontext([]))
        stack.enter_context(fingers.let_go())
        check = stack.enter_context(ending.between())
        watch = _Watch(rate if realtime else None, overrun, fingers, safety, diary, check)
        _loop(packed, fingers, hip, gimbals, watch, cold, control, log, bus, inbox, stopped)
    diary.end()
    recording = log.recording()
    lateness_us, compute_us, step_us = log.times()
    return ServoResult(
        recording,
        lateness_us,
        compute_us,
        step_us,
        watch.missed,
        tuple(safety.counts),
        tuple(refused),
        control,
        watch.lost,
        tuple(fingers.faults),
        0 if bus is None else bus.unsent,
        watch.overrun,
        tuple(diary.events),
    )


def _warmed_up(packed: hapjax.PackedStep, inputs: Sequence[np.ndarray]) -> int:
    """How long (ns) a call of the step takes in a row of them."""
    taken = []
    for _ in range(WARM_UP):
        began = time.perf_counter_ns()
        packed.force(packed.call(packed.start, *inputs))
        taken.append(time.perf_counter_ns() - began)
    return min(taken)


def _loop(
    packed: hapjax.PackedStep,
    fingers: Fingers,
    first: Float[np.ndarray, "F 3"],
    gimbals,
    watch: "_Watch",
    cold: int,
    control: PassivityControl | None,
    log: "_Log",
    bus: TickPublisher | None,
    inbox: Inbox | None,
    stopped: Callable[[], bool] | None,
) -> None:
    hip = first.astype(packed.dtype)
    angle = np.empty(len(gimbals), packed.dtype)
    inputs = (hip, angle) if gimbals else (hip,)
    output = np.zeros((packed.fingers, 3))
    # Compiling has taken seconds: where the fingers are now is where they begin.
    fingers.let_in()
    _read(0, fingers, gimbals, hip, angle)
    memory = packed.begin(*inputs)
    if control is not None:
        control(output, hip)

    def rehearsal() -> None:
        # While the loop sleeps, others fill the processor's caches: without this a step takes more than twice as long.
        packed.force(packed.call(memory, *inputs))

    watch.start(rehearsal, cold)
    for tick in count() if log.ticks is None else range(log.ticks):
        late, began = watch.wait(tick)
        if tick:
            _read(tick, fingers, gimbals, hip, angle)
        if inbox is not None:
            memory = inbox.put(tick, memory)
        asked = time.perf_counter_ns()
        memory = packed.call(memory, *inputs)
        lost = packed.is_lost(memory)
        step_us = (time.perf_counter_ns() - asked) * 1e-3
        watch.lost += lost
        wanted = force = packed.force(memory)
        if control is not None:
            damped = control(watch.safety.within(force), hip)
            wanted = force if lost else damped
        fingers.write(tick, wanted, output)
        if control is not None:
            control.put_out(output)
        log.add(tick, hip, angle, force, output, memory)
        if lost:
            watch.diary.count("lost")
        if bus is not None:
            worked = (time.perf_counter_ns() - began) * 1e-3
            bus.publish(
                tick, began, late * 1e-3, worked, watch.counts(), fingers.down, hip, angle, output, memory
            )
            watch.diary.tell(bus.tell)
        log.time(tick, late * 1e-3, (time.perf_counter_ns() - began) * 1e-3, step_us)
        if stopped is not None and stopped():
            break


def _read(tick: int, fingers: Fingers, gimbals, hip, angle) -> None:
    """Put what the devices read into `hip`, m, and `angle`, rad. **Raises:** `DeviceError` for what is not finite."""
    fingers.read(tick, hip)
    for finger, device in enumerate(gimbals):
        angle[finger] = device.read_gimbal()
    if not np.isfinite(hip).all():
        raise DeviceError(f"tick {tick}: the devices read {hip.tolist()} m; a position must be finite")
    if not np.isfinite(angle).all():
        raise DeviceError(f"tick {tick}: the gimbals read {angle.tolist()} rad; an angle must be finite")


class _Watch:
    """Waits for each tick, and sees to it that what goes wrong is counted and answered.

    **Arguments:** `rate` in Hz, `None`: nothing is waited for; `most` deadlines that may be missed at once; `fingers`,
    which are let in anew after more; `safety`; `diary`; `check`, which ends the loop where it has to.

    **Attributes:** `overrun`, `lost`: at how many ticks so far.
    """

    def __init__(
        self,
        rate: float | None,
        most: int,
        fingers: Fingers,
        safety: Safety,
        diary: Diary,
        check: Callable[[], None],
    ):
        self._rate, self._most, self._fingers, self._check = rate, most, fingers, check
        self._pacer: Pacer | None = None
        self.safety, self.diary = safety, diary
        self.overrun = self.lost = 0

    def start(self, rehearsal: Callable[[], object], needs: int) -> None:
        """The first deadline is one period from now; `rehearsal` and what it `needs` (ns) as for `MonotonicClock`."""
        if self._rate is not None:
            self._pacer = Pacer(round(1e9 / self._rate), MonotonicClock(rehearsal, needs))

    @property
    def missed(self) -> int:
        """How many deadlines were missed so far."""
        return 0 if self._pacer is None else self._pacer.missed

    def wait(self, tick: int) -> tuple[int, int]:
        """Wait for a tick; how late it begins, ns, and when."""
        self._check()
        if self._pacer is None:
            began = time.perf_counter_ns()
            self.diary.turn(tick, began)
            return 0, began
        before = self._pacer.missed
        late, began = self._pacer.wait(), time.perf_counter_ns()
        self.diary.turn(tick, began)
        if missed := self._pacer.missed - before:
            self.diary.count("missed", by=missed)
        if missed > self._most:
            self.overrun += 1
            self._fingers.let_in()
            self.diary.count("overrun")
        return late, began

    def counts(self) -> tuple[int, ...]:
        """All that is counted so far, as the bus has it."""
        of = self.safety.total
        return self.missed, of.not_finite, of.limited, self.lost, of.slewed, of.ramped, self.overrun


def _tell_all(diary: Diary, bus: TickPublisher) -> None:
    diary.end()
    diary.tell(bus.tell)


class _Log:
    """The arrays of a recording, all made before the loop begins; of a run without an end, of its last second."""

    def __init__(self, ticks, rate, packed: hapjax.PackedStep, force_sensor, pose_tracker, turned: bool):
        self._rate, self.ticks, self._done = rate, ticks, 0
        self._force_sensor, self._pose_tracker = force_sensor, pose_tracker
        kept = max(1, round(LAST * rate)) if ticks is None else ticks
        self.hip, self._model = np.zeros((2, kept, packed.fingers, 3))
        self.gimbal = np.zeros((kept, packed.fingers)) if turned else None
        self._times = np.zeros((3, kept))
        if force_sensor is not None:
            self._force_every = _every("force_sensor", force_sensor.rate, rate)
            self._force = np.zeros((-(-kept // self._force_every), packed.fingers, 3))
        if pose_tracker is not None:
            self._pose_every = _every("pose_tracker", pose_tracker.rate, rate)
            self._pose_at = pose_places(packed)
            self._pose = np.zeros((kept // self._pose_every, *self._pose_at.shape))

    def add(self, tick: int, hip, angle, force, output, memory) -> None:
        """Note what a tick got, answered, put out and moved."""
        row = tick % len(self.hip)
        self.hip[row], self._model[row] = hip, force
        if self.gimbal is not None:
            self.gimbal[row] = angle
        if self._force_sensor is not None and tick % self._force_every == 0:
            self._force[tick // self._force_every % len(self._force)] = self._force_sensor.measure(output)
        if self._pose_tracker is not None and (tick + 1) % self._pose_every == 0:
            pose = np.asarray(memory)[self._pose_at]
            self._pose[tick // self._pose_every % len(self._pose)] = self._pose_tracker.measure(pose)

    def time(self, tick: int, lateness_us: float, compute_us: float, step_us: float) -> None:
        """Note how late a tick began and how long it worked, and the step in that: it is done."""
        self._times[:, tick % len(self.hip)] = lateness_us, compute_us, step_us
        self._done = tick + 1

    def times(self) -> Float[np.ndarray, "3 T"]:
        """Lateness, work and step, us."""
        return _kept(self._times.T, self._done)[1].T

    def recording(self) -> Recording:
        """What was logged."""
        ticks, hip = _kept(self.hip, self._done)
        channels = {"hip": hip, "hip_t": ticks / self._rate}
        model = _kept(self._model, self._done)[1]
        fit = np.isfinite(model).all(axis=(1, 2))  # a recording has no place for others; they are counted
        if fit.any():
            channels |= {"model_force": model[fit], "model_force_t": channels["hip_t"][fit]}
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
