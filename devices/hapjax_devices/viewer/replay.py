"""A recording played back on a page, with a time bar: what was recorded, and the touches that a scene makes of it."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import hapjax
from hapjax import InputError, Scene, load_scene
from hapjax.body import Motion, centre_within
from hapjax.errors import within
from hapjax.paths import part_at
from hapjax.progress import following
from hapjax.recording import Recording

from . import plots
from .geometry import placed
from .live import at_first, frames, looks, newest
from .moments import Moments, moments
from .plots import Plots
from .process import stop_asked
from .recorded import STILL, Live, attached_scene, recorded_numbers
from .server import serving
from .stage import Stage, camera

RATE = 100.0  # Hz, at which moments are kept
HELD = 0.5  # s, for which the bar does not go on by itself after a user has moved it
_SAME = 1e-9  # s, by which two times of one moment may differ
SPEEDS = {"0.1": 0.1, "0.3": 0.3, "1": 1.0, "3": 3.0}


def replay(file: Path, scene: Path | None, host: str, port: int) -> int:
    """Show a recording on a page at `host` and `port` until Ctrl-C or SIGTERM; the exit code.

    **Arguments:** `scene`, its scene's file; `None`: the scene that `hapjax run` recorded with it.

    **Raises:** `InputError` for a recording without the fingers' path, without a scene, or of other objects than that has.
    """
    with jax.enable_x64(True):
        with following(None, doing="reading"):
            recording = Recording.load(file)
            given = attached_scene(file) if scene is None else load_scene(scene)
            live = recorded_numbers(file, given) if scene is None else STILL
        with within(f"{file}: "), following(None, doing="following the recording"):
            course = course_of(given, recording, live)
    asked = stop_asked()  # until here Ctrl-C interrupts
    with serving(f"hapjax: {file.name}", host, port, camera(given)) as server:
        player = Player(server, given, course)
        for now in frames(lambda: bool(asked)):
            player.take(now)
    return 0


def course_of(scene: Scene, recording: Recording, live: Live = STILL) -> Moments:
    """The moments of a recording, `RATE` a second.

    **Arguments:** `live`, what became of numbers of the scene meanwhile.

    The objects are where they were recorded, and go where the scene lets them where they were not; the touches are those
    of the scene's surfaces, the forces those recorded, or the scene's where there are none.

    **Raises:** `InputError` where the recording has no path of the fingers, or poses of other objects.
    """
    dt = float(scene.integrator.dt)
    hips = recording.hip_every(dt)
    assert recording.hip_t is not None
    every = max(1, round(1 / (RATE * dt)))
    count = len(hips) // every * every
    if not count:
        raise InputError(f"hip lasts {len(hips) * dt:g} s; allowed: {every * dt:g} s or more")
    times = recording.hip_t[0] + dt * np.arange(count)
    turned = scene.torsion is not None and scene.torsion.needs_gimbal
    gimbals = recording.gimbal_at(times) if turned else None
    motions = None if recording.pose is None else _motions(scene, recording, times + dt, dt)
    numbers = live.at(times)
    stack = jax.tree.map(
        lambda x: x[:count].reshape(-1, every, *x.shape[1:]), (hips, gimbals, motions, numbers)
    )
    force, pose, touch = jax.device_get(_course(scene, *stack))
    kept = slice(every - 1, count, every)
    if recording.force is not None or recording.model_force is not None:
        force = _recorded_force(recording, times[kept])
    everything = np.tile(at_first(scene), (len(force), 1, 1))
    names = list(scene.object)
    everything[:, [names.index(name) for name in scene.moving()]] = pose
    felt = [names.index(name) for name in scene.touchable()]
    critical = np.full(count, float(getattr(scene.torsion, "critical_area", np.nan)))
    critical = numbers.get("torsion.critical_area", critical)[kept]
    clock = times[kept] - recording.hip_t[0]
    return moments(clock, hips[:count][kept], force, everything, felt, touch, critical)


@jax.jit
def _course(scene: Scene, hips: Any, gimbals: Any, motions: Any, numbers: dict[str, Any]) -> Any:
    """The force, the poses and the touches at the end of each group of steps; `motions`: see `_motions`; `numbers` of the
    scene that are others at each step, by path."""
    state = hapjax.init(scene, hips[0, 0], None if gimbals is None else gimbals[0, 0])
    if motions is not None:
        state = replace(state, motion=_moved(state.motion, motions[0, 0]))

    def one(state: hapjax.State, x: Any) -> Any:
        hip, gimbal, motion, numbers = x
        now = eqx.tree_at(lambda s: [part_at(s, path) for path in numbers], scene, list(numbers.values()))
        after, reply = hapjax.step(now, state, hip, gimbal=gimbal)
        if motion is not None:
            after = replace(after, motion=_moved(after.motion, motion))
        pose = [jnp.concatenate([m.position, m.orientation]) for m in after.motion.values()]
        touch = [
            {"point": god.point, "depth": god.depth, **vars(reply.touch[name])}
            for name, god in after.finger.items()
        ]
        poses = jnp.stack(pose) if pose else jnp.zeros((0, 7), hip.dtype)
        return after, (reply.force, poses, jax.tree.map(lambda *parts: jnp.stack(parts), *touch))

    def group(state: hapjax.State, x: Any) -> Any:
        state, found = jax.lax.scan(one, state, x)
        return state, jax.tree.map(lambda each: each[-1], found)

    return jax.lax.scan(group, state, (hips, gimbals, motions, numbers))[1]


def _moved(motion: dict[str, Motion], known: Float[Array, "O 13"]) -> dict[str, Motion]:
    """The objects where they are known to be."""
    parts = {}
    for index, (name, before) in enumerate(motion.items()):
        position, orientation, velocity, spin = jnp.split(known[index], (3, 7, 10))
        parts[name] = Motion(position, orientation, velocity, None if before.spin is None else spin)
    return type(motion)(parts)


def _motions(
    scene: Scene, recording: Recording, times: Float[np.ndarray, "T"], dt: float
) -> Float[np.ndarray, "T O 13"]:
    """Where the recorded objects are at these times: position, orientation, velocity of the centre of mass, spin."""
    assert recording.pose is not None and recording.pose_t is not None
    moving = scene.moving()
    if recording.pose.shape[1] != len(moving):
        raise InputError(
            f"pose has {recording.pose.shape[1]} objects; allowed: {len(moving)}, those of the scene that move"
        )
    pose = np.array(recording.pose)
    turns = np.cumsum(np.sum(pose[1:, :, 3:] * pose[:-1, :, 3:], axis=2) < 0, axis=0) % 2
    pose[1:, :, 3:] *= np.where(turns, -1, 1)[..., None]  # a quaternion and its negative are the same turn
    flat = pose.reshape(len(pose), -1)
    paths = [np.interp(times, recording.pose_t, column) for column in flat.T]
    pose = np.stack(paths, axis=1).reshape(len(times), -1, 7)
    pose[..., 3:] /= np.linalg.norm(pose[..., 3:], axis=2, keepdims=True)
    centre = np.zeros((len(moving), 3))
    for index, name in enumerate(moving):
        body, shape = scene.object[name].body, scene.object[name].shape
        assert body is not None
        own = centre_within(body, shape)
        centre[index] = 0 if own is None else own
    # As a step has it that has just moved the object.
    middle = placed(pose, centre)
    velocity = np.diff(middle, axis=0, prepend=middle[:1]) / dt
    spin = np.diff(pose[..., 3:], axis=0, prepend=pose[:1, :, 3:]) / dt
    w, x, y, z = np.moveaxis(pose[..., 3:], 2, 0)
    # 2 q' q*, without its real part, which is 0.
    rows = np.array([[-x, w, -z, y], [-y, z, w, -x], [-z, -y, x, w]])
    return np.concatenate([pose, velocity, 2 * np.einsum("ijto,toj->toi", rows, spin)], axis=2)


def _recorded_force(recording: Recording, times: Float[np.ndarray, "T"]) -> Float[np.ndarray, "T F 3"]:
    """The forces on the fingers at these times, measured, or as the servo loop answered."""
    measured, at = recording.force, recording.force_t
    if measured is None or at is None:
        measured, at = recording.model_force, recording.model_force_t
    assert measured is not None and at is not None
    paths = [np.interp(times, at, column) for column in measured.reshape(len(at), -1).T]
    return np.stack(paths, axis=1).reshape(len(times), *measured.shape[1:])


class Player:
    """A time bar, and what is shown at its time.

    **Arguments:** `server`; the `scene`; its `course`.
    """

    def __init__(self, server: Any, scene: Scene, course: Moments):
        self._server, self._course, self._last = server, course, None
        self._drawn, self._held, self._moved = -np.inf, 0.0, False
        self._stage = Stage(server, scene, course.hip.shape[1])
        with server.gui.add_folder("time"):
            self.playing = server.gui.add_checkbox("playing", initial_value=True)
            end = float(course.time[-1])
            self.bar = server.gui.add_slider("time (s)", min=0.0, max=end, step=1 / RATE, initial_value=0.0)
            self.speed = server.gui.add_dropdown("speed", tuple(SPEEDS), initial_value="1")
            self.bar.on_update(self._hold)
        self._plots = Plots(server, course.hip.shape[1])
        looks(server, self._stage)

    def _hold(self, event: Any) -> None:
        if event.client is not None:
            self._moved = True

    def take(self, now: float) -> None:
        """Show the moment of the bar, which goes on while it plays and is not held; `now`: the time on a clock, s."""
        passed = 0.0 if self._last is None else now - self._last
        self._last = now
        if self._moved:
            self._moved, self._held = False, HELD
        elif self._held > 0:
            self._held -= passed
            if self._held <= 0:
                # What came late to the page is there now instead of what was set; viser tells it no value twice.
                self.bar.value = np.nextafter(self.bar.value, self._course.time[-1] / 2)
        elif self.playing.value:
            end = self._course.time[-1]
            gone = float(self.bar.value) + passed * SPEEDS[self.speed.value]
            self.bar.value = gone if gone <= end else 0.0
        until = int(np.searchsorted(self._course.time, self.bar.value + _SAME, side="right"))
        seen = self._course[: max(until, 1)]
        with self._server.atomic():
            self._stage.show(seen[-1:])
            if now > self._drawn + plots.PERIOD:
                self._drawn = now
                self._plots.show(newest(seen))
        self._server.flush()  # see `live.Page.take`
