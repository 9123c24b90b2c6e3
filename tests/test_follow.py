"""A finger on shapes whose faces meet at edges: no jump of the force, nothing falls through."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hapjax
from helpers import matrix, quaternion

STIFFNESS = 1000.0
BOX, CYLINDER = hapjax.Box((0.06, 0.05, 0.04)), hapjax.Cylinder(0.03, 0.05)
SHAPES = {"box": BOX, "cylinder": CYLINDER}


@jax.jit
def forces(scene, path):
    """The force on one finger along a path (T, 3)."""
    return hapjax.rollout(scene, hapjax.init(scene, path[:1]), path[:, None])[1].force[:, 0]


def fixed(shape, mu: Any = 0.0, turn=(1.0, 0.0, 0.0, 0.0), place=(0.0, 0.0, 0.0)):
    return hapjax.Scene({"it": hapjax.Object(shape, hapjax.Surface(STIFFNESS, mu=mu), None, place, turn)})


def around(shape, seed):
    """A path that presses 1 mm deep and slides over edges and corners, off the shape, and back on to it."""
    rng = np.random.default_rng(seed)
    half = np.array([0.03, 0.025, 0.02]) if isinstance(shape, hapjax.Box) else np.array([0.03, 0.03, 0.025])
    corners = [np.array([0.0, 0.0, half[2] + 2e-3])]
    for _ in range(12):
        point = rng.uniform(-1.2, 1.2, 3) * half
        axis = rng.integers(3)
        point[axis] = np.sign(point[axis]) * (half[axis] - rng.uniform(-2e-3, 3e-3))
        corners.append(point)
    return np.concatenate(
        [
            np.linspace(a, b, 400, endpoint=False)
            for a, b in zip(corners, [*corners[1:], corners[0]], strict=True)
        ]
    )


@pytest.mark.parametrize("mu", [0.0, 0.6])
@pytest.mark.parametrize("name", SHAPES)
def test_the_force_never_jumps(name, mu):
    """Without friction by no more than stiffness times the finger's own step; with, by its cone's slope besides."""
    turn, place = quaternion((1, 2, -1), 0.7), np.array([0.01, -0.02, 0.03])
    scene = fixed(SHAPES[name], mu, turn, place)
    touched = 0
    for seed in range(12):
        path = around(SHAPES[name], seed)
        force = np.asarray(forces(scene, jnp.asarray(path @ matrix(turn).T + place)))
        steps = np.linalg.norm(np.diff(force, axis=0), axis=1)
        own = STIFFNESS * np.linalg.norm(np.diff(path, axis=0), axis=1)
        # On a cylinder the normal turns with the finger; friction follows the normal force and its direction.
        allowed = own * (1 + 1e-6) if mu == 0 else 2 * np.sqrt(1 + mu**2) * own
        assert np.all(steps <= allowed + 1e-9)
        touched += np.count_nonzero(force.any(axis=1))
    assert touched > 2000


def straight(start, *ends, step=1e-4):
    parts, here = [np.asarray(start, float)[None]], np.asarray(start, float)
    for end in np.asarray(ends, float):
        count = int(np.ceil(np.linalg.norm(end - here) / step))
        parts.append(here + np.arange(1, count + 1)[:, None] / count * (end - here))
        here = end
    return np.concatenate(parts)


def test_a_finger_that_slides_off_an_edge_is_let_go_within_its_own_depth():
    path = straight([0, 0, 0.021], [0, 0, 0.019], [0.034, 0, 0.019])
    force = np.asarray(forces(fixed(BOX), jnp.asarray(path)))
    on_top = (path[:, 0] <= 0.03) & (path[:, 2] < 0.0191)
    assert force[on_top][1:] == pytest.approx(np.tile([0, 0, 1.0], (on_top.sum() - 1, 1)), abs=0.11)
    gone = path[:, 0] > 0.0311
    assert np.all(force[gone] == 0) and gone.any()
    easing = force[(path[:, 0] > 0.03) & ~gone]
    assert np.all(np.diff(easing[:, 2]) <= 1e-12) and easing[:, 2].max() > 0.8


def test_a_face_holds_although_another_is_nearer():
    """Pressed in from the top near the edge, deeper than the edge is away, it does not pop out of the side."""
    path = straight([0.029, 0, 0.021], [0.029, 0, 0.015])
    force = np.asarray(forces(fixed(BOX), jnp.asarray(path)))
    assert force[-1] == pytest.approx(np.array([0, 0, 5.0]))


def test_a_thin_plate_is_not_passed_through():
    plate = hapjax.Box((0.1, 0.1, 1e-3))
    path = np.array([[0, 0, 0.01], [0, 0, -0.01], [1e-4, 0, -0.01], [0, 0, 0.01]])
    force = np.asarray(forces(fixed(plate), jnp.asarray(path)))
    assert force[1:3] == pytest.approx(np.tile([0, 0, 10.5], (2, 1)))
    assert np.all(force[3] == 0)


def test_every_face_has_its_own_mu_when_slid_onto_it():
    mu = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6])
    scene = fixed(BOX, mu)
    for face in range(6):
        axis, sign = face // 2, 1 - 2 * (face % 2)
        half = np.asarray(BOX.size) / 2
        deep, aside = np.zeros(3), np.zeros(3)
        deep[axis], aside[(axis + 1) % 3] = sign * (half[axis] - 1e-3), 0.01
        path = straight(deep * (half[axis] + 1e-3) / (half[axis] - 1e-3), deep, deep + aside)
        force = np.asarray(forces(scene, jnp.asarray(path)))[-1]
        assert force[axis] == pytest.approx(sign * 1.0)
        assert force[(axis + 1) % 3] == pytest.approx(-mu[face])


# Nothing falls through ------------------------------------------------------------------------------------


def _inside(name, x):
    if name == "box":
        return np.all(np.abs(x) < np.asarray(BOX.size) / 2, axis=-1)
    return (np.hypot(x[..., 0], x[..., 1]) < 0.03) & (np.abs(x[..., 2]) < 0.025)


def _on_surface(name, rng, count):
    """Points on faces, on edges and on corners, in equal parts."""
    half = np.asarray(BOX.size) / 2
    x = rng.uniform(-1, 1, (count, 3))
    if name == "box":
        for pinned in range(3):  # 1, 2 or 3 coordinates at their limit
            rows = slice(pinned * count // 3, (pinned + 1) * count // 3)
            which = np.argsort(rng.random(x[rows].shape), axis=1) <= pinned
            x[rows] = np.where(which, np.sign(x[rows]), x[rows])
        return x * half
    angle = rng.uniform(0, 2 * np.pi, count)
    rim = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1) * 0.03
    rim[:, 2] = np.where(np.arange(count) % 2, x[:, 2], np.sign(x[:, 2])) * 0.025
    return rim


@jax.jit
def approach(scene, hips):
    """The force on each of N fingers after each of the steps of its way (N, T, 3)."""
    return jax.vmap(lambda path: forces(scene, path))(hips)


@pytest.mark.slow
@pytest.mark.parametrize("name", SHAPES)
def test_no_random_approach_falls_through(name):
    """From outside to the surface itself, and on to the inside: there is a force once inside, and it points back out."""
    rng = np.random.default_rng(3)
    count = 100_000
    target = _on_surface(name, rng, count)
    inner = target * rng.uniform(0.9, 0.999, (count, 1))
    start = rng.standard_normal((count, 3))
    start = start / np.linalg.norm(start, axis=1)[:, None] * 0.1
    ways = np.stack([start, (start + target) / 2, target, inner], axis=1)
    force = np.asarray(approach(fixed(SHAPES[name]), jnp.asarray(ways)))
    inside = _inside(name, inner)
    assert inside.all()
    assert np.count_nonzero(~force[:, 3].any(axis=1)) == 0
    assert not force[:, 0].any()
