"""Recordings whose truth is known: the scenes, and motions that differ a little from recording to recording."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hapjax import (
    Body,
    Box,
    GravityDrop,
    Object,
    Plane,
    Recording,
    Scene,
    Surface,
    Viscous,
    World,
    cast,
    init,
    rollout,
)

DT = 1e-3
_FLOOR, _CUBE = "object.floor.surface.", "object.cube.body."
_HALF = 0.03  # m, of the cube's edge


@dataclass(frozen=True)
class Case:
    """Which numbers are looked for in which scene, and how it is touched.

    `motion` makes the fingers' path (T, F, 3) m from a random generator; `noise`: standard deviations of force (N) and,
    where poses are seen, position (m) and angle (rad).
    """

    scene: Scene
    free: tuple[str, ...]
    motion: Callable[[np.random.Generator], Float[np.ndarray, "T F 3"]]
    noise: dict[str, float]

    def truth(self) -> Scene:
        """The scene in double precision."""
        return cast(self.scene, jnp.float64)

    def recorded(self, seed: int) -> Recording:
        """One recording: a motion, and what is measured of it, with white noise."""
        random = np.random.default_rng(seed)
        path = self.motion(random)
        force, pose = (np.array(x) for x in answer(self.truth(), jnp.asarray(path)))
        t = DT * np.arange(len(path))
        channels = {"force": force + self.noise["force"] * random.standard_normal(force.shape), "force_t": t}
        if "position" in self.noise:
            place, turn = (random.standard_normal((*pose.shape[:2], 3)) for _ in range(2))
            pose[..., :3] += self.noise["position"] * place
            pose[..., 3:] = _turned(pose[..., 3:], self.noise["angle"] * turn)
            channels |= {"pose": pose, "pose_t": t + DT}  # a step's pose belongs to its end
        return Recording(hip=path, hip_t=t, **channels)


@jax.jit
def answer(scene: Scene, path: Float[Array, "T F 3"]) -> tuple[Float[Array, "T F 3"], Float[Array, "T O 7"]]:
    """The forces (N) on the fingers and the objects' poses."""
    _, reply = rollout(scene, init(scene, path[0]), path)
    return reply.force, reply.pose


def _turned(quaternion: Float[np.ndarray, "*n 4"], by: Float[np.ndarray, "*n 3"]) -> np.ndarray:
    """Orientations turned by small rotation vectors (rad) in their own frame."""
    w, v, half = quaternion[..., :1], quaternion[..., 1:], by / 2
    scalar = w - np.sum(v * half, axis=-1, keepdims=True)
    turned = np.concatenate([scalar, v + w * half + np.cross(v, half)], axis=-1)
    return turned / np.linalg.norm(turned, axis=-1, keepdims=True)


def _floor(**surface) -> Scene:
    return Scene(object={"floor": Object(Plane(), Surface(800.0, **surface))})


def stroke(random: np.random.Generator, strokes: int = 4, steps: int = 120) -> Float[np.ndarray, "T 1 3"]:
    """A finger that comes down, moves away faster and faster and slower again, and lifts off; so many times."""
    paths = []
    for _ in range(strokes):
        t = np.arange(steps) / steps
        depth = np.interp(t, [0, 0.08, 0.92, 1], [-0.001, 0.0025, 0.0025, -0.001])
        length, way = random.uniform(0.008, 0.012), random.uniform(0, 2 * np.pi)
        x = length * (1 - np.cos(2 * np.pi * np.clip(t - 0.08, 0, None))) / 2
        paths.append(np.stack([np.cos(way) * x, np.sin(way) * x, -depth], axis=-1))
    return np.concatenate(paths)[:, None]


def _cube(centre: tuple[float, float, float], **parts) -> Scene:
    cube = Object(
        Box((2 * _HALF,) * 3),
        Surface(800.0, mu=0.6, damping=1.0),
        Body(0.2, inertia=(1.1e-4, 1.25e-4, 1.4e-4), centre=centre),
    )
    return Scene(object={"cube": cube}, world=World(gravity=(0.0, 0.0, -9.81), gyroscopic=True), **parts)


def swing(random: np.random.Generator, steps: int = 400) -> Float[np.ndarray, "T 2 3"]:
    """Two fingers that hold the cube beside its centre, so that it swings about the line through them."""
    t = DT * np.arange(steps)
    phase, rate = random.uniform(0, 2 * np.pi), random.uniform(12, 18)
    depth = 0.003 + 0.0004 * np.sin(rate * t + phase)
    ends = [np.stack([side * (_HALF - depth), 0 * t + 0.005, 0 * t + 0.01], axis=-1) for side in (-1, 1)]
    return np.stack(ends, axis=1)


def shake(random: np.random.Generator, steps: int = 500) -> Float[np.ndarray, "T 4 3"]:
    """Four fingers that hold the cube by two faces, and move and turn it along every axis."""
    t = DT * np.arange(steps)
    grown = np.minimum(t / 0.1, 1)[:, None]
    phase = random.uniform(0, 2 * np.pi, (2, 3))
    move = 0.006 * grown * np.sin(2 * np.pi * np.array([4.1, 5.3, 4.7]) * t[:, None] + phase[0])
    turn = 0.08 * grown * np.sin(2 * np.pi * np.array([5.9, 6.7, 7.3]) * t[:, None] + phase[1])
    spots = [(-1, -0.018, -0.012), (-1, 0.018, 0.012), (1, -0.018, 0.012), (1, 0.018, -0.012)]
    paths = []
    for side, y, z in spots:
        spot = np.array([side * (_HALF - 0.006), y, z])
        paths.append(move + spot + np.cross(turn, spot))  # turns are small
    return np.stack(paths, axis=1)


_POSE = {"force": 0.02, "position": 1e-4, "angle": 1e-3}
CASES = {
    "mu, stiffness": Case(
        _floor(mu=0.6), (_FLOOR + "mu", _FLOOR + "stiffness"), partial(stroke, strokes=3), {"force": 0.02}
    ),
    "static, kinetic, viscous": Case(
        _floor(mu_static=0.6, mu_kinetic=0.4, friction=Viscous(1.0)),
        (_FLOOR + "mu_static", _FLOOR + "mu_kinetic", _FLOOR + "friction.coefficient"),
        stroke,
        {"force": 0.02},
    ),
    "critical area": Case(
        _cube((0.0, 0.0, 0.0), torsion=GravityDrop(2e-5, twist_damping=5e-4)),
        ("torsion.critical_area",),
        swing,
        _POSE,
    ),
    "mass, centre, inertia": Case(
        _cube((0.004, -0.003, 0.002)), (_CUBE + "mass", _CUBE + "centre", _CUBE + "inertia"), shake, _POSE
    ),
}
