"""A cylinder that rocks, wobbles and rolls on its rims: their deepest point wanders, what friction holds does not."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hapjax
from helpers import G, away, matrix, quaternion
from test_pairs import MASS, UPRIGHT, over


def rocked(height, tilt, mu=0.5, damping=0.3, spin=(0.0, 0.0, 0.0), integrator=None):
    """Poses and energies (J) of a cylinder let go with a tilt just above a plane."""
    shape = hapjax.Cylinder(0.02, height)
    stiffness = 5e3
    scene = over(
        shape, quaternion((0.3, 1.0, 0.0), tilt), hapjax.Plane(), UPRIGHT, 2e-4, stiffness, damping, mu, 1
    )
    scene = dataclasses.replace(scene, integrator=integrator or hapjax.SemiImplicit(1e-4))
    hips = away(4000 if integrator is None else 1000)
    state = hapjax.init(scene, hips[0])
    state = eqx.tree_at(lambda s: s.motion["it"].spin, state, jnp.asarray(spin))
    _, reply = hapjax.rollout(scene, state, hips)
    pose = np.asarray(reply.pose[:, 0])
    pressed = np.asarray(reply.contact["pair"].normal_force)
    return pose, np.sum(pressed**2, axis=1) / (2 * stiffness) + MASS * G * pose[:, 2]


def tilts(pose):
    """From upright, rad."""
    return np.array([np.arccos(np.clip(matrix(q)[2, 2], -1, 1)) for q in pose[::20, 3:]])


@pytest.mark.parametrize("height", [0.02, 0.05])
def test_a_cylinder_let_go_tilted_comes_to_rest_on_its_end(height):
    pose, energy = rocked(height, 0.05)
    angle = tilts(pose)
    assert angle.max() < 0.2 and angle[-1] < 0.01
    assert np.linalg.norm(pose[-1, :2] - pose[0, :2]) < 0.01
    # Without the energy of motion: it never has more than at the start all the same.
    assert np.all(energy < energy[0] + 1e-4 * MASS * G * height)


def test_a_cylinder_that_spins_upright_is_slowed_by_friction_as_a_ring_is():
    """Four points at the radius r with a fourth of the weight each: d spin / dt = -mu m g r / (m r^2 / 2)."""
    spin, mu, r = 30.0, 0.3, 0.02
    pose, _ = rocked(
        0.02, 0.0, mu=mu, damping=2.0, spin=(0.0, 0.0, spin), integrator=hapjax.SemiImplicit(1e-4, 2)
    )
    turned = np.unwrap(2 * np.arctan2(pose[:, 6], pose[:, 3]))
    slowing = 2 * mu * G / r
    t = 1e-4 * np.arange(1, len(pose) + 1)
    expected = spin * t - slowing * t**2 / 2
    np.testing.assert_allclose(turned - turned[0], expected - expected[0], atol=0.03 * spin * t[-1])


def test_what_friction_holds_in_twist_outlasts_the_rocking_through_level():
    """Four springs k at the radius r: it swings about upright at w^2 = 4 k r^2 / (m r^2 / 2), while it rocks beside."""
    k, r, spin, dt = 5e3, 0.02, 0.3, 5e-5
    scene = over(
        hapjax.Cylinder(r, 0.02), UPRIGHT, hapjax.Plane(), UPRIGHT, -MASS * G / (4 * k), k, None, 0.8, 1
    )
    scene = dataclasses.replace(scene, integrator=hapjax.SemiImplicit(dt))
    hips = away(2000)
    state = hapjax.init(scene, hips[0])
    state = eqx.tree_at(lambda s: s.motion["it"].spin, state, jnp.array([spin, 0.0, spin]))
    _, reply = hapjax.rollout(scene, state, hips)
    turn, t = 2 * np.asarray(reply.pose[:, 0, 6]), dt * np.arange(1, len(hips) + 1)
    swing = np.sqrt(8 * k / MASS)
    rocked_by = 2 * np.asarray(reply.pose[:, 0, 4])
    assert np.count_nonzero(np.diff(np.sign(rocked_by))) > 20
    np.testing.assert_allclose(turn, spin / swing * np.sin(swing * t), atol=0.02 * spin / swing)


def test_memories_go_to_the_nearest_points():
    shape = hapjax.Cylinder(0.02, 0.05)

    def points(angle):
        return shape.points(lambda _: -jnp.array([jnp.cos(angle), jnp.sin(angle), 0.5]))

    for turn, quarters in ((0.3, 0), (-0.7, 0), (0.9, 1), (np.pi, 2), (-1.6, 3), (3.0, 2)):
        which = shape.goes_on(points(1.0), points(1.0 + turn))
        assert which is not None
        one = (np.arange(4) + quarters) % 4
        np.testing.assert_array_equal(which, np.concatenate([one, 4 + one]))
        way = np.linalg.norm(points(1.0 + turn) - points(1.0)[which], axis=1)
        assert np.all(way < 2 * 0.02 * np.sin(np.pi / 8) + 1e-9)


@pytest.mark.slow
def test_derivatives_of_a_rocking_cylinder_are_those_of_differences():
    """By its radius, by mu and by the tilt, while it rocks through level once."""
    hips = away(60)
    still = over(hapjax.Cylinder(0.02, 0.02), UPRIGHT, hapjax.Plane(), UPRIGHT, -1e-3, 500.0, 0.3, 0.5, 1)

    @jax.jit
    def end(numbers):
        scene = eqx.tree_at(
            lambda s: (s.object["it"].shape.radius, s.contact["pair"].mu), still, (numbers[0], numbers[1])
        )
        spin = numbers[2] * jnp.array([1.0, 0.3, 1.0])
        state = eqx.tree_at(lambda s: s.motion["it"].spin, hapjax.init(scene, hips[0]), spin)
        state, reply = hapjax.rollout(scene, state, hips)
        return jnp.concatenate(
            [state.motion["it"].spin, reply.contact["pair"].friction_force.sum(axis=(0, 1))]
        )

    at, h = jnp.array([0.02, 0.1, 1.5]), 1e-7
    forward, reverse = jax.jacfwd(end)(at), jax.jacrev(end)(at)
    np.testing.assert_allclose(forward, reverse, rtol=1e-8, atol=1e-8)
    for i in range(3):
        step = h * at[i] * jnp.eye(3)[i]
        slope = (end(at + step) - end(at - step)) / (2 * h * at[i])
        np.testing.assert_allclose(forward[:, i], slope, rtol=1e-4, atol=1e-4 * np.abs(forward[:, i]).max())
