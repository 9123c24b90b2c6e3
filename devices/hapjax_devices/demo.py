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

    The strokes press with 1 to 2 N and slide 30 mm, so friction shows whatever one guesses of mu; neighbours go
    opposite ways, so that the cube stays put. The shaking turns and moves the cube along every axis at
    frequencies of its own, so mass and all moments of inertia show.

    **Arguments:** `seed` of the sensors' noise; `rate` of the servo loop, Hz.
    """
    duration = 8.5
    t = np.arange(round(duration * rate)) / rate
    stroke, above = _strokes(t), np.array([[-0.016, 0, 0.085], [0.016, 0, 0.085], [0, 0, 0.085]])
    del above
    spots = np.array([[-0.03, -0.018, 0.0], [-0.03, 0.018, 0.0], [0.03, 0.0, 0.0]])
    inward = np.array([[1.0, 0, 0], [1.0, 0, 0], [-1.0, 0, 0]])
    share = np.array([0.5, 0.5, 1.0])
    away = np.array([2.3, 3.0, 3.4, 8.0, 8.4])
    grip = waypoints([3.0, 3.4, 7.7, 8.0], [0.0, 6.0, 6.0, 0.0], t)
    gap = waypoints(away, [0.02, 0.02, 0.0, 0.0, 0.02], t)
    height = waypoints([3.6, 4.3, 6.9, 7.6], [0.0, 0.05, 0.05, 0.0], t)
    shake = waypoints([4.3, 4.6, 6.5, 6.8], [0.0, 1.0, 1.0, 0.0], t)[:, None]
    move = shake * _waves(t, frequency=(3.1, 2.3, 3.7), size=(0.008, 0.008, 0.006))
    move[:, 2] += height + SIDE / 2
    turn = shake * _waves(t, frequency=(4.3, 5.3, 4.7), size=np.radians((8.0, 8.0, 8.0)))
    paths = []
    for finger in range(3):
        held = _hold(spots[finger], inward[finger], share[finger] * grip, gap)
        held = move + _turned(turn, held)
        blend = waypoints([2.0, 2.7], [0.0, 1.0], t)[:, None]
        # outwards before down: the passage keeps above the cube until it is beside it
        side = held.copy()
        side[:, 2] += waypoints([2.5, 3.0], [0.055, 0.0], t)
        paths.append((1 - blend) * stroke[finger] + blend * side)
    return _task(paths, seed, rate, duration)


def two_finger_swing(seed: int, rate: float = 1000.0) -> Task:
    """Grip the cube off its centre between two fingers, lift it, and let it swing about the line through them.

    Gripped hard its friction circles exceed A_crit and it keeps its attitude; gripped softer it drops and swings, more
    freely the softer the grip.

    **Arguments:** as for `three_finger_lift`.
    """
    duration = 8.0
    t = np.arange(round(duration * rate)) / rate
    spots = np.array([[-0.03, 0.005, 0.01], [0.03, 0.005, 0.01]])
    inward = np.array([[1.0, 0, 0], [-1.0, 0, 0]])
    gap = waypoints([0.2, 0.6], [0.01, 0.0], t)
    grip = waypoints(
        [0.6, 1.0, 1.9, 2.2, 4.2, 4.5, 6.0, 6.3, 7.2, 7.5],
        [0, 4.2, 4.2, 2.6, 2.6, 2.15, 2.15, 3.0, 3.0, 4.2],
        t,
    )
    move = np.zeros((len(t), 3))
    move[:, 2] = SIDE / 2 + waypoints([1.0, 1.7], [0.0, 0.02], t)
    shake = waypoints([3.2, 3.5, 6.8, 7.1], [0.0, 1.0, 1.0, 0.0], t)
    move[:, 1] = shake * 0.008 * np.sin(2 * np.pi * 1.5 * t)
    paths = [move + _hold(spots[i], inward[i], grip, gap) for i in range(2)]
    return _task(paths, seed, rate, duration)


def _task(paths: list[np.ndarray], seed: int, rate: float, duration: float) -> Task:
    devices = [VirtualDevice(path, 1 / rate, HAND) for path in paths]
    return Task(scene(), devices, Sensors(ForceSensor(seed=seed), PoseTracker(seed=seed)), duration)


def _strokes(t: Float[np.ndarray, "T"]) -> list[Float[np.ndarray, "T 3"]]:
    """Three fingers that press on the cube's top and rub to and fro along lanes of their own."""
    along = waypoints([0.4, 0.9, 1.4, 1.8], [-0.015, 0.015, -0.015, 0.015], t)
    press = waypoints([0.0, 0.35, 0.9, 1.4, 1.8, 2.0], [0.0, 1.2, 2.0, 1.2, 1.8, 0.0], t)
    gap = waypoints([0.0, 0.2, 1.9, 2.1, 2.3], [0.01, 0.0, 0.0, 0.01, 0.025], t)
    paths = []
    for lane, way in ((-0.017, 1.0), (0.017, 1.0), (0.0, -1.0)):
        spot = np.stack([np.full_like(t, lane), way * along, np.full_like(t, SIDE)], axis=1)
        paths.append(_hold(spot, np.array([0.0, 0.0, -1.0]), press, gap))
    return paths


def _hold(spot, inward, force, gap) -> Float[np.ndarray, "T 3"]:
    """Where a hand wants to be so as to press with `force` (N) on `spot`, or to stay `gap` (m) away from it."""
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
