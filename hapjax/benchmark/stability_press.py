"""Two fingers press each object that moves and that they feel, from opposite sides: does it come to rest between them?"""

import dataclasses
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from ..errors import InputError
from ..integrate import METHODS, Implicit
from ..scene import Scene, cast
from ..simulate import init, step
from ._sweep import when
from .error_scene import spot_of
from .stability_cells import AWAY, BLOWN_UP, QUIET, RINGING, SETTLED, WILD, energy, scale_of

SECONDS, CLOSING, LATEST = (
    1.0,
    0.5,
    0.9,
)  # s: all of it, until the fingers are in, and from when it is to be quiet
REST = 1000  # steps of 1 ms in which objects come to rest before fingers come
FORCE, GAP, DEEPEST = 1.0, 1e-3, 0.1  # N of a finger; m outside at the start; of the object's width, deepest
HOLD, ASIDE = 0.75, 0.02  # of weight / mu, which each of two fingers has at least; of the width


def touched(scene: Scene) -> list[str]:
    """The objects that move and that fingers feel."""
    return [name for name in scene.touchable() if scene.object[name].body is not None]


def rested(scene: Scene) -> Scene:
    """The scene with its objects where they come to rest by `implicit`, whatever its own integrator makes of it."""
    quiet = dataclasses.replace(scene, integrator=Implicit(dt=1e-3))
    hip, gimbal = jnp.full((1, 3), AWAY, jnp.float64), _gimbal(scene, 1, jnp.float64)

    @jax.jit
    def end(scene, state):
        return jax.lax.fori_loop(0, REST, lambda _, s: step(scene, s, hip, gimbal=gimbal)[0], state)

    state = end(quiet, init(quiet, hip, gimbal))
    objects = OrderedDict(scene.object)
    for name, motion in state.motion.items():
        changes: dict[str, Any] = {"position": motion.position}
        if motion.spin is not None:
            changes["orientation"] = motion.orientation
        objects[name] = dataclasses.replace(objects[name], **changes)
    return dataclasses.replace(scene, object=objects)


def fingers(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Where two fingers each begin, GAP outside, and where they end, at the depth of their force, (F, 3) m."""
    outside, inside = [], []
    for name in touched(scene):
        thing = scene.object[name]
        surface, body = thing.surface, thing.body
        assert surface is not None and body is not None
        gravity = 0.0 if scene.world.gravity is None else float(jnp.linalg.norm(scene.world.gravity))
        mu = float(np.min(np.asarray(surface.mu if surface.mu_kinetic is None else surface.mu_kinetic)))
        force = max(FORCE, HOLD * float(body.mass) * gravity / max(mu, 0.1))
        spots, inward = _opposite(scene, name)
        width = float(np.linalg.norm(spots[1] - spots[0]))
        depth = min(force / float(np.max(np.asarray(surface.stiffness))), DEEPEST * width)
        outside.append(spots - GAP * inward)
        inside.append(spots + depth * inward)
    return np.concatenate(outside), np.concatenate(inside)


def path(scene: Scene, count: int, steps: int) -> np.ndarray:
    """Where `count` fingers are that come in over a quarter of `steps`, and then press, (T, F, 3) m: the same two on each
    object, in turn, so that some press at one place where there are more.
    """
    outside, inside = (places[np.arange(count) % len(places)] for places in fingers(scene))
    share = np.clip(4 * np.arange(steps) / steps, 0, 1)[:, None, None]
    return outside + share * (inside - outside)


def press(scene: Scene, method: str, dtype: str) -> Callable[[float], str]:
    """The verdict, for any dt (s), on a press of the scene's objects, which are at rest; compiled once.

    Settled: over the last 0.1 s the energy of all motion stays under QUIET m g L; blown up: it is above WILD m g L at some
    time, or a step was lost.
    """
    outside, inside = (jnp.asarray(x, dtype) for x in fingers(scene))
    scene = cast(dataclasses.replace(scene, integrator=METHODS[method](dt=1e-3)), jnp.dtype(dtype))
    gimbal, part = _gimbal(scene, len(inside), dtype), when(method)

    @jax.jit
    def live(scene, dt, count):
        scale = sum(scale_of(scene, name) for name in scene.moving())

        def body(i, carry):
            state, loud, peak, lost = carry
            t = (i.astype(dt.dtype) + part) * dt
            share = jnp.clip(t / CLOSING, 0, 1)
            hip = outside + (0.5 - 0.5 * jnp.cos(jnp.pi * share)) * (inside - outside)
            state, reply = step(scene, state, hip, dt, gimbal)
            now = energy(scene, state, None) / scale
            return state, jnp.where(now < QUIET, loud, i + 1), jnp.maximum(peak, now), lost | reply.lost

        start = (init(scene, outside, gimbal), jnp.int32(0), jnp.zeros_like(dt), jnp.zeros((), bool))
        return jax.lax.fori_loop(0, count, body, start)[1:]

    def verdict(dt: float) -> str:
        count = jnp.asarray(round(SECONDS / dt), jnp.int32)
        loud, peak, lost = live(scene, jnp.asarray(dt, dtype), count)
        if lost or not peak <= WILD:
            return BLOWN_UP
        return SETTLED if float(loud) * dt <= LATEST else RINGING

    return verdict


def _opposite(scene: Scene, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Two points of an object's surface, m, on opposite sides along x, or y, or z, where rays first find them; the
    directions into it. They are a little ASIDE of each other, for a press in line would not start what rocks.
    """
    for axis in np.eye(3):
        sides = np.stack([-axis, axis])
        try:
            low, high = (spot_of(scene, name, side, np.zeros(3)) for side in sides)
            across = ASIDE * np.linalg.norm(high - low) * (np.roll(axis, 1) + 0.7 * np.roll(axis, 2))
            spots = [spot_of(scene, name, side, side @ axis * across) for side in sides]
        except InputError:
            continue
        return np.stack(spots), -sides
    raise InputError(
        f"fingers do not find object.{name} along x, y or z; allowed: a surface around its origin, within 1 m"
    )


def _gimbal(scene: Scene, count: int, dtype: Any):
    return jnp.zeros(count, dtype) if scene.torsion is not None and scene.torsion.needs_gimbal else None
