"""The second-order integrator: its order, and the angular momentum that it carries."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hapjax
from helpers import angle_between, matrix, moving, order

INERTIA, SPIN = np.array([1.0, 2.0, 3.0]), np.array([0.5, 6.0, 0.3])  # nearly about the middle axis
STEPS = [4e-3, 2e-3, 1e-3]


@jax.jit
def final(scene, state, hips, dt):
    """The motion after a number of steps with the fingers at each of `hips`."""
    return jax.lax.scan(lambda s, hip: (hapjax.step(scene, s, hip, dt)[0], None), state, hips)[0].motion["it"]


def top(dt):
    body = hapjax.Body(1.0, inertia=INERTIA)
    thing = hapjax.Object(hapjax.Box((0.1, 0.1, 0.1)), None, body)
    scene = hapjax.Scene({"it": thing}, world=hapjax.World(gyroscopic=True), integrator=hapjax.LieMidpoint())
    hips = jnp.full((round(2 / dt), 1, 3), 9.0)
    return final(scene, moving(hapjax.init(scene, hips[0]), "it", spin=SPIN), hips, jnp.asarray(dt))


def truth():
    """Euler's equations and the quaternion's, by SciPy."""

    def rate(_, y):
        w, q = y[:3], y[3:]
        turning = np.cross(INERTIA * w, w) / INERTIA  # along the body's axes, as w is
        s, v = q[0], q[1:]
        return np.concatenate([turning, [-v @ w / 2], (s * w + np.cross(v, w)) / 2])

    end = solve_ivp(rate, (0, 2), [*SPIN, 1, 0, 0, 0], method="DOP853", rtol=1e-13, atol=1e-13).y[3:, -1]
    return end / np.linalg.norm(end)


def test_a_free_top_turns_as_it_should_and_keeps_its_angular_momentum():
    ends, true = [top(dt) for dt in STEPS], truth()
    errors = [angle_between(end.orientation, true) for end in ends]
    assert errors[-1] < 1e-5
    assert order(STEPS, errors) == pytest.approx(2, abs=0.05)
    for end in ends:
        turn = matrix(end.orientation)
        momentum = turn @ (INERTIA * (turn.T @ np.asarray(end.spin)))
        np.testing.assert_allclose(momentum, INERTIA * SPIN, atol=1.2e-9)


@pytest.mark.parametrize("damping, swing", [(None, 5e-4), (2.0, 0.0)])
def test_a_body_between_two_fingers_converges_at_second_order(damping, swing):
    """Springs between fingers that go to and fro; or a loss that goes with velocity, between fingers at rest.

    Not both: a finger's velocity is that of the way to where it is, half a step before.
    """
    surface, mass, seconds = hapjax.Surface(800.0, mu=5.0, damping=damping), 0.2, 0.3
    box = hapjax.Object(hapjax.Box((0.06, 0.04, 0.08)), surface, hapjax.Body(mass, rotation=False))
    scene = hapjax.Scene({"it": box}, integrator=hapjax.LieMidpoint())
    depth, rate, speed = 2e-3, 9.0, 0.05

    def led(t):  # the fingers go with x, along their line
        return swing * np.sin(rate * t)

    def run(dt):
        count = round(seconds / dt)
        hips = np.zeros((count, 2, 3))
        hips[:, :, 0] = np.array([0.03 - depth, -0.03 + depth])
        hips[:, :, 0] += led((np.arange(count) + 0.5) * dt)[:, None]
        start = moving(hapjax.init(scene, hips[0]), "it", velocity=(speed, 0, 0))
        return final(scene, start, jnp.asarray(hips), jnp.asarray(dt))

    def rate_of(t, y):
        x, v = y
        d = np.array([depth - (led(t) - x), depth + (led(t) - x)])
        right, left = 800 * d * (1 + (damping or 0) * np.array([v, -v]))
        return [v, (left - right) / mass]

    true = solve_ivp(rate_of, (0, seconds), [0, speed], method="DOP853", rtol=1e-12, atol=1e-15).y[:, -1]
    ends = [run(dt) for dt in STEPS]
    errors = [np.hypot(e.position[0] - true[0], (e.velocity[0] - true[1]) / 90) for e in ends]
    assert order(STEPS, errors) == pytest.approx(2, abs=0.2) and errors[-1] < 1e-5


def test_substeps_read_the_fingers_in_the_middle_of_each():
    """Where they are on the straight way from the place at the last step's end to that at this one's."""
    box = hapjax.Object(
        hapjax.Box((0.06, 0.04, 0.08)), hapjax.Surface(800.0, mu=5.0), hapjax.Body(0.2, rotation=False)
    )
    coarse, fine = (
        hapjax.Scene({"it": box}, integrator=hapjax.LieMidpoint(substeps=count)) for count in (3, 1)
    )
    hips = np.zeros((40, 2, 3))
    hips[:, :, 0] = 1e-3 * np.sin(0.2 * np.arange(40))[:, None] + np.array([0.028, -0.028])
    between = hips[:-1, None] + (np.arange(3)[:, None, None] + 0.5) / 3 * (hips[1:] - hips[:-1])[:, None]
    end = final(coarse, hapjax.init(coarse, hips[0]), jnp.asarray(hips[1:]), jnp.asarray(3e-3))
    finer = final(fine, hapjax.init(fine, hips[0]), jnp.asarray(between.reshape(-1, 2, 3)), jnp.asarray(1e-3))
    np.testing.assert_allclose(end.position, finer.position, atol=1e-15)
    np.testing.assert_allclose(end.velocity, finer.velocity, atol=1e-12)
    assert abs(end.velocity[0]) > 1e-3


def test_without_the_gyroscopic_term_the_spin_stays():
    thing = hapjax.Object(hapjax.Box((0.1, 0.1, 0.1)), None, hapjax.Body(1.0, inertia=INERTIA))
    scene = hapjax.Scene({"it": thing}, integrator=hapjax.LieMidpoint())
    hips = jnp.full((100, 1, 3), 9.0)
    end = final(scene, moving(hapjax.init(scene, hips[0]), "it", spin=SPIN), hips, jnp.asarray(1e-3))
    np.testing.assert_array_equal(end.spin, SPIN)


def test_the_centre_of_mass_goes_straight_on():
    body = dataclasses.replace(hapjax.Body(1.0, inertia=INERTIA), centre=jnp.array([0.01, -0.02, 0.03]))
    thing = hapjax.Object(hapjax.Box((0.1, 0.1, 0.1)), None, body)
    scene = hapjax.Scene({"it": thing}, world=hapjax.World(gyroscopic=True), integrator=hapjax.LieMidpoint())
    hips, velocity = jnp.full((500, 1, 3), 9.0), np.array([0.2, 0.0, -0.1])
    start = moving(hapjax.init(scene, hips[0]), "it", spin=SPIN, velocity=velocity)
    end = final(scene, start, hips, jnp.asarray(1e-3))
    centre = np.asarray(end.position) + matrix(end.orientation) @ np.asarray(body.centre)
    np.testing.assert_allclose(centre, np.asarray(body.centre) + 0.5 * velocity, atol=1e-12)
