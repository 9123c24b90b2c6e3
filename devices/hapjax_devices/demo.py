"""The demonstration's scene and its two tasks: what the operator's fingers try to do, from start to end."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from hapjax import Body, Box, Contact, GravityDrop, Object, Plane, Scene, SemiImplicit, Surface, World

from .operator import Hand, waypoints
from .sensor import ForceSensor, PoseTracker
from .virtual import VirtualDevice

SIDE = 0.06  # m, edge of the cube
HAND = Hand(mass=0.15, stiffness=400.0)
STIFFNESS = 800.0  # N/m, of the cube's surface


class Sensors(NamedTuple):
    """What measures a task."""

    force: ForceSensor
    pose: PoseTracker


class Task(NamedTuple):
    """All that `hapjax_devices.run` needs; `duration` in s."""

    scene: Scene
    devices: list[VirtualDevice]
    sensors: Sensors
    duration: float


def scene() -> Scene:
    """A cube of 60 mm and 0.2 kg on a floor; the truth that a fit is to find again."""
    cube = Object(
        Box((SIDE, SIDE, SIDE)),
        Surface(STIFFNESS, mu=0.6, damping=1.0),
        Body(0.2, inertia=(1.1e-4, 1.25e-4, 1.4e-4)),
        position=(0.0, 0.0, SIDE / 2),
    )
    return Scene(
        object={"cube": cube, "floor": Object(Plane())},
        contact={"cube_on_floor": Contact(5000.0, mu=0.5, damping=0.5, between=("cube", "floor"))},
        torsion=GravityDrop(2e-5, twist_damping=5e-4),
        world=World(gravity=(0.0, 0.0, -9.81), gyroscopic=True),
        integrator=SemiImplicit(dt=1e-3),
    )


def three_finger_lift(seed: int, rate: float = 1000.0) -> Task:
    """Stroke the cube's top with three fingers, grip it between two and one, lift, shake and put it down.

    The strokes press with 1 to 2 N and slide 30 mm, so friction shows whatever one guesses of mu; the
    middle one goes against the outer ones, so that the cube stays put. The shaking grows slowly, and moves
    and turns the cube along every axis at a frequency of its own, so mass and all moments of inertia show.

    **Arguments:** `seed` of the sensors' noise; `rate` of the servo loop, Hz.
    """
    duration = 6.5
    t = np.arange(round(duration * rate)) / rate
    spots = np.array([[-0.03, -0.018, 0.0], [-0.03, 0.018, 0.0], [0.03, 0.0, 0.0]])
    inward = np.array([[1.0, 0.0, 0.0], [1.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    grip = waypoints([2.2, 2.6, 5.9, 6.2], [0.0, 7.0, 7.0, 0.0], t)
    gap = waypoints([1.9, 2.2, 6.1, 6.4], [0.02, 0.0, 0.0, 0.02], t)
    shake = waypoints([2.9, 4.4, 4.9, 5.2], [0.0, 1.0, 1.0, 0.0], t)[:, None]
    move = shake * _waves(t, frequency=(3.1, 2.3, 3.7), size=(0.008, 0.008, 0.006))
    move[:, 2] += SIDE / 2 + waypoints([2.7, 3.3, 5.2, 5.8], [0.0, 0.05, 0.05, 0.0], t)
    turn = shake * _waves(t, frequency=(4.3, 5.3, 4.7), size=np.radians((7.0, 8.0, 8.0)))
    # From the strokes to the sides, outwards before downwards: never through the cube.
    over = waypoints([1.2, 1.7], [0.0, 1.0], t)[:, None]
    down = np.array([0.0, 0.0, 1.0]) * waypoints([1.6, 2.0], [0.055, 0.0], t)[:, None]
    paths = []
    for stroke, spot, way, share in zip(_strokes(t), spots, inward, (0.5, 0.5, 1.0), strict=True):
        held = move + _turned(turn, _hold(spot, way, share * grip, gap))
        paths.append((1 - over) * stroke + over * (held + down))
    return _task(paths, seed, rate, duration)


def two_finger_swing(seed: int, rate: float = 1000.0) -> Task:
    """Grip the cube off its centre with two fingers, lift it, and let it swing about the line through them.

    Gripped hard, its friction circles exceed A_crit and it keeps its attitude; gripped softer, it drops and
    swings, the more freely the softer. The lift is low: a cube that slips in a wrong guess lands before the
    fingers lose it.

    **Arguments:** as for `three_finger_lift`.
    """
    duration = 6.5
    t = np.arange(round(duration * rate)) / rate
    gap = waypoints([0.1, 0.4], [0.01, 0.0], t)
    grip = waypoints(
        [0.4, 0.8, 1.5, 1.8, 3.3, 3.5, 4.7, 5.0, 5.7, 6.0],
        [0.0, 4.2, 4.2, 2.6, 2.6, 2.2, 2.2, 3.0, 3.0, 4.2],
        t,
    )
    shake = waypoints([2.6, 2.9, 5.3, 5.6], [0.0, 1.0, 1.0, 0.0], t)[:, None]
    move = shake * _waves(t, frequency=(0.0, 1.5, 0.0), size=(0.0, 0.008, 0.0))
    move[:, 2] += SIDE / 2 + waypoints([0.8, 1.4], [0.0, 0.02], t)
    paths = []
    for side in (-1.0, 1.0):
        spot, inward = np.array([side * SIDE / 2, 0.005, 0.01]), np.array([-side, 0.0, 0.0])
        paths.append(move + _hold(spot, inward, grip, gap))
    return _task(paths, seed, rate, duration)


def _task(paths: list[np.ndarray], seed: int, rate: float, duration: float) -> Task:
    devices = [VirtualDevice(path, 1 / rate, HAND) for path in paths]
    return Task(scene(), devices, Sensors(ForceSensor(seed=seed), PoseTracker(seed=seed)), duration)


def _strokes(t: Float[np.ndarray, "T"]) -> list[Float[np.ndarray, "T 3"]]:
    """Three fingers that press on the cube's top and rub to and fro along lanes of their own."""
    along = waypoints([0.35, 0.75, 1.15], [-0.015, 0.015, -0.015], t)
    press = waypoints([0.0, 0.3, 0.75, 1.15, 1.3], [0.0, 1.2, 2.0, 1.4, 0.0], t)
    gap = waypoints([0.0, 0.2, 1.15, 1.35], [0.01, 0.0, 0.0, 0.025], t)
    paths = []
    for lane, way in ((-0.017, 1.0), (0.017, 1.0), (0.0, -1.0)):
        spot = np.stack([np.full_like(t, lane), way * along, np.full_like(t, SIDE)], axis=1)
        paths.append(_hold(spot, np.array([0.0, 0.0, -1.0]), press, gap))
    return paths


def _hold(spot, inward, force, gap) -> Float[np.ndarray, "T 3"]:
    """Where a hand wants to be to press on `spot` with `force` (N), or to stay `gap` (m) away from it."""
    depth = force / STIFFNESS + force / HAND.stiffness - gap
    return spot + depth[:, None] * inward


def _waves(t, frequency, size) -> Float[np.ndarray, "T 3"]:
    """A sine along each axis, of its own frequency (Hz) and size."""
    return np.asarray(size) * np.sin(2 * np.pi * np.asarray(frequency) * t[:, None])


def _turned(vector: Float[np.ndarray, "T 3"], points: Float[np.ndarray, "T 3"]) -> Float[np.ndarray, "T 3"]:
    """`points` turned by rotation vectors in rad (Rodrigues' formula)."""
    angle = np.linalg.norm(vector, axis=1, keepdims=True)
    axis = vector / np.where(angle > 0, angle, 1.0)
    along = np.sum(axis * points, axis=1, keepdims=True) * axis
    return along + np.cos(angle) * (points - along) + np.sin(angle) * np.cross(axis, points)
