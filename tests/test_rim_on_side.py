"""The circle of a cylinder's rim against a round side, and what stands on a cylinder beside its axis."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hapjax
from hapjax import crossing, rotation
from hapjax.contact import Placed
from helpers import G, away, matrix, quaternion
from test_pairs import LYING_X, MASS, UPRIGHT, over

DRUM, ROD = hapjax.Cylinder(0.02, 0.05), hapjax.Capsule(0.01, 0.1)


@jax.jit
def crossings(place, frame):
    """Where a rod crosses the two rims of a drum at the origin: place (m) and rotation matrix of the rod."""
    return crossing.find(Placed(ROD, place, frame), Placed(DRUM, jnp.zeros(3), jnp.eye(3)))


def test_a_rim_touches_where_its_circle_is_nearest_to_the_axis():
    """Against a search over 200,000 points of the circle; lines through the middle of the cap, at slopes up to 0.6 rad."""
    around = np.linspace(0, 2 * np.pi, 200_001)
    circle = np.stack([0.02 * np.cos(around), 0.02 * np.sin(around), np.full(around.shape, 0.025)], axis=1)
    rng = np.random.default_rng(0)
    for _ in range(20):
        turn = Rotation.from_euler("yz", [np.pi / 2 + rng.uniform(-0.6, 0.6), rng.uniform(0, 2 * np.pi)])
        place = np.append(rng.uniform(-0.009, 0.009, 2), 0.025 + 0.0102)
        found = crossings(jnp.asarray(place), jnp.asarray(turn.as_matrix()))
        assert found.depth.shape == (5,)  # and the sides
        u = turn.apply([0.0, 0.0, 1.0])
        gap = circle - place - ((circle - place) @ u)[:, None] * u
        distance = np.linalg.norm(gap, axis=1)
        least = distance[:-1][(distance[:-1] <= np.roll(distance[:-1], 1)) & (distance[:-1] < distance[1:])]
        upper = np.sort(np.asarray(found.depth)[:2])[::-1]
        np.testing.assert_allclose(upper[0], 0.01 - distance.min(), atol=1e-9)
        np.testing.assert_allclose(upper[: len(least)], np.sort(0.01 - least)[::-1], atol=1e-9)
        rim = np.asarray(found.point + found.depth[:, None] * found.normal)[:2]
        np.testing.assert_allclose(np.linalg.norm(rim - np.array([0, 0, 0.025]), axis=1), 0.02, atol=1e-9)


def test_two_places_that_become_one_push_as_one():
    """The rod slides over the edge of the drum: what both push together changes by no more than stiffness times way."""
    ys = jnp.linspace(0.0, 0.03, 3001)

    def pushed(y):
        found = crossings(jnp.array([0.0, y, 0.025 + 0.0095]), jnp.asarray(matrix(LYING_X)))
        return jnp.sum(jnp.where(found.admissible, jnp.maximum(found.depth, 0), 0))

    total = np.asarray(jax.vmap(pushed)(ys))
    assert total[0] == pytest.approx(2 * 0.0005) and total[-1] == 0
    assert total[np.searchsorted(ys, 0.0201)] == pytest.approx(0.01 - np.hypot(0.0001, 0.0095), abs=1e-5)
    assert np.abs(np.diff(total)).max() < 2 * (ys[1] - ys[0])


@pytest.mark.parametrize("tilt", [0.0, 1e-3])
def test_logs_that_lie_along_each_other_touch_alike_however_they_are_rolled(tilt):
    """Each rim of the short one is as deep as the other, whichever of its points is the lowest."""
    deep = 1e-5
    short, long = hapjax.Cylinder(0.02, 0.05), hapjax.Capsule(0.02, 0.2)

    @jax.jit
    @jax.vmap
    def pushed(roll):
        turned = rotation.product(
            rotation.from_rotation_vector(jnp.array([tilt, 0.0, 0.0])),
            rotation.from_rotation_vector(roll * jnp.array([0.0, 0.0, 1.0])),
        )
        upper = Placed(short, jnp.array([0.04 - deep, 0.0, 0.0]), rotation.to_matrix(turned))
        found = crossing.find(upper, Placed(long, jnp.zeros(3), jnp.eye(3)))
        active = crossing.is_active(found, jnp.zeros_like(found.depth))
        depth = jnp.where(active, found.depth, 0)
        return jnp.sum(depth), jnp.sum(depth[:, None] * found.normal, axis=0)

    total, push = pushed(jnp.linspace(0, 2 * jnp.pi, 2001))
    lifted = 0.025 * np.sin(tilt)  # the rims' centres swing out sideways by so much
    expected = 2 * (0.04 - np.hypot(0.04 - deep, lifted)) + deep * (tilt**2)
    np.testing.assert_allclose(total, max(expected, 0), rtol=5e-3 if tilt else 1e-9)
    np.testing.assert_allclose(push[:, 1], 0, atol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("rod", [ROD, hapjax.Cylinder(0.01, 0.1)])
def test_a_rod_laid_across_a_drum_rests_at_every_heading(rod):
    """Also without friction: nothing about a circle prefers a heading."""

    @jax.jit
    @jax.vmap
    def end(wxyz, mu):
        scene = over(rod, LYING_X, DRUM, UPRIGHT, 2e-4, damping=8.0)
        scene = eqx.tree_at(lambda s: (s.object["it"].orientation, s.contact["pair"].mu), scene, (wxyz, mu))
        hips = away(1000)
        state, reply = hapjax.rollout(scene, hapjax.init(scene, hips[0]), hips)
        return reply.pose[-1, 0], state.motion["it"].velocity, reply.contact["pair"].normal_force[-1]

    yaws = np.arange(8) * np.pi / 16
    lying = Rotation.from_quat(LYING_X, scalar_first=True)
    turns = [(Rotation.from_rotvec([0, 0, yaw]) * lying).as_quat(scalar_first=True) for yaw in yaws]
    pose, velocity, pushes = end(jnp.asarray(turns), jnp.asarray(4 * [0.5, 0.0]))
    np.testing.assert_allclose(pose[:, :2], 0, atol=1e-9)
    np.testing.assert_allclose(velocity, 0, atol=1e-7)
    for turn, now in zip(turns, pose[:, 3:], strict=True):
        np.testing.assert_allclose(matrix(now), matrix(turn), atol=1e-8)
    np.testing.assert_allclose(np.sort(pushes, axis=1)[:, -2:], MASS * G / 2, rtol=1e-6)
    assert np.count_nonzero(pushes) == 16


@pytest.mark.slow
@pytest.mark.parametrize("small", [hapjax.Cylinder(0.005, 0.01), hapjax.Box((0.01, 0.01, 0.01))])
def test_what_stands_on_a_drum_beside_its_axis_stays_there(small):
    """Its edges lie well within the drum's radius of the axis, and yet touch the cap and not the side."""
    scene = over(small, quaternion((0, 0, 1), 0.3), DRUM, UPRIGHT, 5e-4, damping=8.0)
    scene = eqx.tree_at(lambda s: s.object["it"].position, scene, replace_fn=lambda x: x.at[0].set(0.012))
    hips = away(700)
    state, reply = hapjax.rollout(scene, hapjax.init(scene, hips[0]), hips)
    np.testing.assert_allclose(reply.pose[-1, 0, :2], [0.012, 0], atol=1e-6)
    assert np.abs(state.motion["it"].velocity).max() < 1e-6
    assert np.asarray(reply.contact["pair"].normal_force[-1]).sum() == pytest.approx(MASS * G, rel=1e-4)


@pytest.mark.slow
def test_derivatives_of_a_rim_s_touch_are_those_of_differences():
    """By the drum's radius, and the rod's place and turn: along the cap's middle, where nothing is singular but symmetry."""

    @jax.jit
    def touch(numbers):
        frame = rotation.to_matrix(rotation.from_rotation_vector(numbers[4:7]))
        rod = Placed(ROD, numbers[1:4], frame)
        found = crossing.find(
            rod, Placed(hapjax.Cylinder(numbers[0], jnp.asarray(0.05)), jnp.zeros(3), jnp.eye(3))
        )
        return jnp.concatenate([found.depth[:2], found.point[:2].ravel(), found.normal[:2].ravel()])

    for y, turn in ((0.0, [0, np.pi / 2, 0]), (0.004, [0.1, 1.4, 0.3])):
        at = jnp.array([0.02, 0.0, y, 0.0348, *turn])
        forward, reverse = jax.jacfwd(touch)(at), jax.jacrev(touch)(at)
        np.testing.assert_allclose(forward, reverse, rtol=1e-9, atol=1e-9)
        h = 1e-6
        slopes = [(touch(at + h * e) - touch(at - h * e)) / (2 * h) for e in jnp.eye(7)]
        np.testing.assert_allclose(forward, np.stack(slopes, axis=1), rtol=1e-5, atol=2e-5)
