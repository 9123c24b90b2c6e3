"""The Falcon's legs: there and back, and against the closed form of their Jacobian."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hapjax_devices.falcon import kinematics
from hapjax_devices.falcon.stance import Stance, counts_at, stance_of


@pytest.fixture(scope="module")
def places():
    """Positions all over the workspace: 40 mm around z, from 75 mm to where the legs are almost stretched."""
    random = np.random.default_rng(0)
    radius, angle = 0.040 * np.sqrt(random.random(2000)), 2 * np.pi * random.random(2000)
    z = 0.075 + 0.097 * random.random(2000)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


@pytest.fixture(scope="module")
def reference(places):
    """The arms' angles there, and their derivatives."""
    both = jax.jit(jax.vmap(lambda p: (kinematics.inverse(p), kinematics.jacobian(p))))
    return [np.asarray(x) for x in both(jnp.asarray(places))]


def closed_form(position):
    """The Jacobian leg by leg, from Stamper's three angles (with c, d, e, f and s of the Falcon)."""
    a, b, c, ends, f, r, s = 0.060, 0.1025, 0.01443, 0.01125 + 0.01125, -0.025, 0.040, -0.02309
    rows = []
    for phi in np.radians([105.0, -15.0, -135.0]):
        u = position[0] * np.cos(phi) + position[1] * np.sin(phi) - r + c
        v = -position[0] * np.sin(phi) + position[1] * np.cos(phi) - s
        w = position[2]
        third = np.arccos((v + f) / b)
        long = ends + b * np.sin(third)
        first = np.arctan2(w, u) - np.arccos((u**2 + w**2 + a**2 - long**2) / (2 * a * np.hypot(u, w)))
        second = np.arctan2(w - a * np.sin(first), u - a * np.cos(first))
        row = np.array([np.cos(second) * np.sin(third), np.cos(third), np.sin(second) * np.sin(third)])
        row /= a * np.sin(third) * np.sin(second - first)
        turn = np.array([[np.cos(phi), -np.sin(phi), 0], [np.sin(phi), np.cos(phi), 0], [0, 0, 1]])
        rows.append(turn @ row)
    return np.array(rows)


def test_there_and_back(places, dtype):
    with jax.enable_x64(True):
        found = jax.jit(jax.vmap(lambda p: kinematics.forward(kinematics.inverse(p))))(
            jnp.asarray(places, dtype)
        )
    assert found.dtype == dtype
    assert np.max(np.abs(np.asarray(found) - places)) < (1e-9 if dtype == jnp.float64 else 1e-5)


def test_the_jacobian_is_that_of_the_closed_form(places, reference):
    for position, slope in zip(places[:200], reference[1], strict=False):
        np.testing.assert_allclose(slope, closed_form(position), rtol=1e-9, atol=1e-9)


def known(counts, near=None) -> Stance:
    stance = stance_of(counts, near)
    assert stance is not None
    return stance


def test_derivatives_of_forward_in_both_modes():
    counts = np.array([-110.0, 82.0, 0.0])
    angles = kinematics.AT_ZERO + kinematics.COUNT * counts
    expected = np.linalg.inv(closed_form(known(counts).position))
    both = jax.jit(lambda a: (jax.jacfwd(kinematics.forward)(a), jax.jacrev(kinematics.forward)(a)))
    for found in both(angles):
        np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_the_servos_plain_numbers_are_those_of_the_reference(places, reference):
    """There and back, angles and Jacobian, from the workspace's middle and from the position before."""
    places, angles, slopes = (x[::5] for x in (places, *reference))
    counts = np.array([counts_at(position) for position in places])
    np.testing.assert_allclose(kinematics.AT_ZERO + kinematics.COUNT * counts, angles, rtol=1e-12, atol=1e-12)
    for starts in ([None] * len(places), np.roll(places, 1, axis=0)):
        stances = [known(*pair) for pair in zip(counts, starts, strict=True)]
        np.testing.assert_allclose([stance.position for stance in stances], places, rtol=0, atol=1e-9)
        np.testing.assert_allclose([stance.jacobian for stance in stances], slopes, rtol=1e-7, atol=1e-7)


def test_forces_there_and_back(places):
    """What pushes the grip comes back, and the power of arms and grip is the same."""
    random = np.random.default_rng(1)
    for position in places[:200]:
        stance = known(counts_at(position))
        force, velocity = 8 * random.standard_normal(3), random.standard_normal(3)
        torques = stance.torques(force)
        np.testing.assert_allclose(stance.force(torques), force, atol=1e-9)
        np.testing.assert_allclose(torques @ (closed_form(position) @ velocity), force @ velocity, rtol=1e-9)


def test_at_a_count_of_0_all_arms_are_at_35_degrees():
    low = known(np.zeros(3)).position
    np.testing.assert_allclose(low[:2], 0, atol=1e-12)  # all legs alike: on the axis
    np.testing.assert_allclose(np.degrees(kinematics.inverse(jnp.asarray(low))), 35.0, rtol=1e-12)


@pytest.mark.parametrize("counts", [(32767, -32768, 5), (3000, 0, 0), (0, -3000, 3000), (np.nan, 0, 0)])
def test_counts_that_no_position_has(counts):
    assert stance_of(counts) is None
    angles = kinematics.AT_ZERO + kinematics.COUNT * np.array(counts, float)
    assert np.isnan(jax.jit(kinematics.forward)(angles)).all()


def test_a_place_out_of_reach():
    with pytest.raises(ValueError):
        counts_at((0.0, 0.0, 0.25))
    assert np.isnan(jax.jit(kinematics.inverse)(jnp.array([0.0, 0.0, 0.25]))).any()
