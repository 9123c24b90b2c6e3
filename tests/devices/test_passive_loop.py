"""A loop of the packed step and a virtual device gives out no more energy than Colgate and Schenkel's damper takes."""

import functools

import numpy as np
import pytest

import hapjax
from hapjax import Object, Plane, Scene, Surface
from hapjax.benchmark.stability_loop import passive_stiffness
from hapjax_devices import Hand, VirtualDevice, waypoints
from hapjax_devices.virtual import ENCODER_STEP, FORCE_STEP

STIFFNESS = "object.wall.surface.stiffness"
FINE = {"resolution": 1e-12, "force_step": 1e-12, "force_limit": 1e6}  # a device that rounds next to nothing
SKITTISH = Hand(mass=0.05, stiffness=100.0, damping=0.01)  # most of these loops shake in it
FIRM = Hand(mass=0.15, stiffness=1e4)


@functools.cache
def wall(mu):
    scene = Scene({"wall": Object(Plane(), Surface(1000.0, mu=mu))})
    return hapjax.pack(hapjax.cast(scene, float), np.zeros((1, 3)), live=(STIFFNESS,))


def felt(path, period, stiffness, hand, mu=0.0, **device):
    """A run of the loop: how the finger moved in each tick, m, and the force (N) that pushed it meanwhile."""
    packed = wall(mu)
    memory = np.array(packed.start)
    memory[packed.live[STIFFNESS]] = stiffness
    moved, pushed = np.empty((2, len(path), 3))
    with VirtualDevice(path, period, hand, **device) as held:
        for n in range(len(path)):
            memory = packed.call(memory, held.read()[None])
            before = held.operator.position
            pushed[n] = held.write(packed.force(memory)[0])
            moved[n] = held.operator.position - before
    return moved, pushed


def surplus(moved, pushed, damping, period):
    """J that the loop has given out until each tick, less what a damper takes at least: that of an even motion."""
    return np.cumsum(np.sum(pushed * moved, axis=1) - damping * np.sum(moved**2, axis=1) / period)


def taps(period, seconds=1.0, seed=0):
    """Into the wall and out of it at several rhythms, and along it."""
    t = np.arange(round(seconds / period)) * period
    rhythm = np.random.default_rng(seed).uniform(1.0, 40.0, (3, 4))
    sums = np.sum(np.sin(2 * np.pi * rhythm[:, :, None] * t), axis=1)
    return 2e-3 * sums.T + [0.0, 0.0, 1e-3]


def dip(period, seconds=1.0):
    """Slowly into the wall, to and fro within it, and out again: what a sampled wall gives most for."""
    t = np.arange(round(seconds / period)) * period
    z = waypoints([0.0, 0.2, 0.8, 1.0], [0.0, -4e-3, -4e-3, 0.0], t) - 2e-3 * (1 - np.cos(2 * np.pi * 5 * t))
    return np.stack([0 * t, 0 * t, z], axis=1)


@pytest.mark.parametrize("period", [2e-3, 1e-3, pytest.param(2.5e-4, marks=pytest.mark.slow)])
@pytest.mark.parametrize("hand", [SKITTISH, FIRM], ids=["skittish", "firm"])
def test_no_motion_gets_more_out_of_a_passive_wall_than_the_damper_takes(hand, period):
    for path in (taps(period), dip(period)):
        for mu, stiffness in ((0.0, 300.0), (0.0, 3000.0), (0.5, 1000.0)):
            needed = stiffness / passive_stiffness(1.0, 1 / period, delay=1)
            moved, pushed = felt(path, period, stiffness, hand, mu, **FINE)
            energy = surplus(moved, pushed, needed, period)
            assert np.max(pushed[:, 2]) > 0.1  # it was felt
            assert np.max(energy) <= 1e-9 * np.sum(np.abs(pushed * moved))


@pytest.mark.parametrize("period", [2e-3, 1e-3, 2.5e-4])
def test_a_smaller_damper_does_not_take_all(period):
    """The wall's worst motion is a slow one that stays within it; five whole swings of 4 Hz."""
    t = np.arange(round(1.5 / period)) * period
    path = np.stack([0 * t, 0 * t, -5e-3 + 2e-3 * np.sin(2 * np.pi * 4 * t)], axis=1)
    moved, pushed = felt(path, period, 1000.0, FIRM, **FINE)
    swings = slice(-1 - round(1.25 / period), -1)  # the path ends in the last
    needed = 1000.0 / passive_stiffness(1.0, 1 / period, delay=1)
    lost = np.sum(moved[swings] ** 2) / period
    given_out = np.sum(pushed[swings] * moved[swings])
    assert given_out == pytest.approx(needed * lost, rel=0.02)


def test_what_the_encoder_rounds_is_given_out_and_coulomb_friction_takes_it():
    """N. Diolaiti and others, IEEE Transactions on Robotics 22, 2006: friction of K q / 2, and here half a step of force."""
    period, stiffness = 1e-3, 3000.0
    t = np.arange(2000) * period
    # Small beside a step of the encoder, about an edge between two.
    path = np.stack([0 * t, 0 * t, -20.5 * ENCODER_STEP + 1e-5 * np.sin(2 * np.pi * 20 * t)], axis=1)
    moved, pushed = felt(path, period, stiffness, FIRM)
    needed = stiffness / passive_stiffness(1.0, 1 / period, delay=1)
    assert np.max(surplus(moved, pushed, needed, period)) > 1e-6
    friction = stiffness * ENCODER_STEP / 2 + FORCE_STEP / 2
    taken = friction * np.cumsum(np.abs(moved[:, 2]))
    start = 0.5 * stiffness * (20.5 * ENCODER_STEP) ** 2  # the wall is pressed when the run begins
    assert np.max(surplus(moved, pushed, needed, period) - taken) <= start
