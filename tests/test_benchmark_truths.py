"""The truths that integrators are measured against, beside independent programs."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp
from scipy.spatial.transform import Rotation

from hapjax.benchmark._sweep import Program
from hapjax.benchmark.cases import CASES, _springs, ball, disc, lift, rod, sliding, top
from hapjax.integrate import METHODS

KNOWN: dict[str, Any] = dict(CASES)


def free_matrix(inertia, spin, seconds):
    """A free body's matrix by Runge and Kutta's method on the body's own spin."""

    def rate(_, y):
        q, w = y[:4], y[4:]
        turning = 0.5 * np.array([-w @ q[1:], *(q[0] * w + np.cross(q[1:], w))])
        return np.concatenate([turning, -np.cross(w, inertia * w) / inertia])

    y = solve_ivp(rate, (0, seconds), [1, 0, 0, 0, *spin], "DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return Rotation.from_quat(y[:4], scalar_first=True).as_matrix()


@pytest.mark.parametrize("spin", [(0.5, 6.0, 0.3), (-1.0, 6.0, 3.0)])
def test_the_free_top_is_what_another_program_finds(spin):
    spin = np.array(spin)
    expected = free_matrix(top.INERTIA, spin, 2.0)
    np.testing.assert_allclose(top.free_truth(spin=spin), expected, atol=1e-9)


def held(**changes):
    parts: dict[str, Any] = dict(
        mass=0.2,
        inertia=top.INERTIA,
        anchors=np.zeros((1, 3)),
        stiffness=50.0,
        fingers=lambda t: np.array([[0.0, 0.0, 0.1]]),
        gravity=np.array([0.0, 0.0, -2.0]),
    )
    return _springs.Held(**(parts | changes))


START = _springs.Place(np.zeros(3), np.eye(3), np.zeros(3), top.SPIN)


def test_a_body_on_a_spring_at_its_centre_swings_and_spins_as_known():
    place = _springs.solve(held(), START, 1.0)
    middle, omega = 0.1 - 2.0 * 0.2 / 50.0, np.sqrt(50.0 / 0.2)
    np.testing.assert_allclose(place.position, [0, 0, middle * (1 - np.cos(omega))], atol=1e-10)
    np.testing.assert_allclose(place.matrix, top.free_truth(seconds=1.0), atol=1e-9)


def test_a_body_on_springs_off_its_centre_keeps_its_energy():
    """And with a share of the torque and a loss about the axis, what a body on an axis does."""
    anchors = np.array([[0.02, 0.01, 0.0], [0.02, -0.01, 0.0]])
    body = held(anchors=anchors, fingers=lambda t: anchors * [1, 0.5, 1])

    def energy(place):
        turning = place.matrix.T @ place.spin
        stretch = body.fingers(0.0) - place.position - anchors @ place.matrix.T
        kinetic = body.mass * place.velocity @ place.velocity + turning @ (body.inertia * turning)
        height = -body.mass * body.gravity @ place.position
        return kinetic / 2 + body.stiffness * np.sum(stretch**2) / 2 + height

    assert energy(_springs.solve(body, START, 0.5)) == pytest.approx(energy(START), rel=1e-10)
    axis = np.array([0.0, 0.0, 1.0])
    alone = held(axis=axis, share=0.0, loss=1e-3, anchors=anchors, inertia=np.full(3, 1e-4))
    still = alone._replace(fingers=lambda t: anchors + [0, 0, 0.1])
    spun = _springs.solve(still, START._replace(spin=3 * axis), 0.02)
    assert spun.spin[2] == pytest.approx(3 * np.exp(-1e-3 / 1e-4 * 0.02), rel=1e-3)


def test_a_rebound_is_what_the_equation_of_motion_gives():
    def rate(_, y):
        return [y[1], (500.0 * -y[0] * (1 - 1.3 * y[1]) if y[0] < 0 else 0.0) / 0.05]

    left = solve_ivp(rate, (0, 0.06), [0, -1], "DOP853", rtol=1e-11, atol=1e-13, max_step=1e-4).y[1, -1]
    assert ball.rebound(1.3) == pytest.approx(left, abs=1e-7)
    slope = (ball.rebound(1.3 + 1e-5) - ball.rebound(1.3 - 1e-5)) / 2e-5
    assert ball.rebound_per_loss(1.3) == pytest.approx(slope, rel=1e-6)


def test_the_time_of_bounces_is_what_the_equation_of_motion_gives(monkeypatch):
    def rate(_, y):
        return [y[1], -9.81 + max(-y[0], 0) * ball.SPRING / ball.LIGHT]

    start = [ball.DROP, 0]
    ended = solve_ivp(rate, (0, ball.AIR), start, "DOP853", rtol=1e-11, atol=1e-13, max_step=1e-4)
    assert ball.bounced()[0] == pytest.approx(ended.y[0, -1], abs=1e-7)
    slope, values = ball.bounced_per_stiffness()[0], []
    for stiffness in (499.0, 501.0):
        monkeypatch.setattr(ball, "SPRING", stiffness)
        values.append(ball.bounced()[0])
    assert slope == pytest.approx((values[1] - values[0]) / 2, rel=1e-5)


def drag(speed, mass, stiffness, seconds, rolls=False):
    """Where a block or ball comes to, whose friction is a spring that yields at mu m g, with the cases' damping."""
    load = mass * 9.81
    limit, loss = 0.5 * load, 20.0 * load

    def rate(_, y):
        slip = y[1] - y[3]
        pull = stiffness * y[2] - loss * slip
        force = np.clip(pull, -limit, limit)
        yielding = stiffness * abs(y[2]) >= limit and slip * y[2] < 0
        return [y[1], force / mass, 0.0 if yielding else -slip, -2.5 * force / mass if rolls else 0.0]

    return solve_ivp(rate, (0, seconds), [0, speed, 0, 0], "LSODA", rtol=1e-9, atol=1e-12, max_step=2e-4).y[
        0, -1
    ]


def test_a_slide_and_a_roll_end_where_the_equation_of_motion_says():
    slide, roll = KNOWN["slide"], KNOWN["roll"]
    assert slide.truth()[0] == pytest.approx(drag(1.0, sliding.MASS, 4 * sliding.STIFF, 0.5), abs=2e-8)
    assert roll.truth()[0] == pytest.approx(drag(1.0, ball.MASS, ball.STIFF, 0.3, rolls=True), abs=5e-8)
    # The rigid law is the limit of stiff springs.
    assert (
        slide.law()[0] == pytest.approx(1 / (2 * 0.5 * 9.81))
        and abs(slide.law()[0] - slide.truth()[0]) < 1e-6
    )


def test_a_disc_without_spin_slides_as_a_block(monkeypatch):
    monkeypatch.setattr(disc, "SPIN", 0.0)
    monkeypatch.setattr(disc, "SECONDS", 0.01)
    expected = 0.4 * 0.01 - 2 * disc.MU * disc.NORMAL / disc.MASS * 0.01**2 / 2
    np.testing.assert_allclose(disc.slid(None), [expected, 0, 0], atol=1e-9)
    assert disc.slid()[0] == pytest.approx(expected, abs=1e-9)


def test_a_pendulum_falls_in_the_time_that_its_energy_gives(monkeypatch):
    monkeypatch.setattr(rod, "LOSS", 0.0)
    monkeypatch.setattr(rod, "TIME", 0.2)
    x, _, z = rod.pendulum(0.5)
    reach, inertia = -rod.GRASP, rod.INERTIA[1] + 0.5 * rod.MASS * rod.GRASP**2
    angle = np.arctan2(-z, x - rod.GRASP)
    # sqrt(sin) is singular at the start: with s = u^2 it is not.
    pace = 2 * 0.5 * rod.MASS * 9.81 * reach / inertia
    spent = quad(lambda u: 2 * u / np.sqrt(pace * np.sin(u**2)), 0, np.sqrt(angle), epsabs=1e-12)[0]
    assert 0 < angle < np.pi / 2 and spent == pytest.approx(rod.TIME, rel=1e-7)


@pytest.mark.parametrize("case", [c for c in CASES.values() if c.gradient is not None], ids=lambda c: c.name)
def test_a_gradient_has_the_size_of_what_is_compared(case):
    scene = case.scene(METHODS["semi_implicit"]())
    assert case.gradient.where(scene).shape == np.shape(case.gradient.along)
    if case.name not in ("heavy_top", "pendulum", "disc", "rod"):  # which take seconds
        assert np.shape(case.gradient.truth()) == np.shape(case.truth())


@pytest.mark.slow
def test_a_tipped_cube_lies_flat_on_four_corners_that_yield():
    case = KNOWN["tip_rest"]
    late = Program(case, "semi_implicit").run(1500)[0]
    np.testing.assert_allclose(late, case.truth(), atol=1e-12)
    early = Program(dataclasses.replace(case, seconds=0.05), "semi_implicit").run(50)[0]
    assert np.linalg.norm(early - case.truth()) > 5e-3  # it still stands on an edge


@pytest.mark.slow
def test_the_rods_gradient_is_that_of_the_independent_equations(monkeypatch):
    """Its first 0.1 s; of order 2, so that half the step has a quarter of the error."""
    monkeypatch.setattr(rod, "SECONDS", 0.1)
    short = dataclasses.replace(KNOWN["rod"], seconds=0.1)
    slope, truth = Program(short, "lie_midpoint").compile_gradient(), short.gradient.truth()
    errors = [np.linalg.norm(slope(steps) - truth) / np.linalg.norm(truth) for steps in (1000, 2000)]
    assert errors[1] < 1e-3 and errors[0] / errors[1] == pytest.approx(4, rel=0.1)


def test_gradients_by_a_complex_step_are_differences():
    def least(part):
        return top.free_truth(top.INERTIA * [1 + part, 1, 1]).ravel() / np.sqrt(2) / top.INERTIA[0]

    def soft(part):
        return lift._loaded(lift.YIELDING * (1 + part)) / lift.YIELDING

    def lossy(part):
        loss = rod.LOSS * (1 + part)
        axis = np.array([0.0, 1.0, 0.0])
        place = held(axis=axis, share=0.5, loss=loss, anchors=np.array([[0.02, 0.01, 0.0]]))
        return _springs.solve(place, START, 0.1).matrix.ravel() / rod.LOSS

    def pulled(part):
        up = -9.81 * (1 + part)
        place = held(gravity=np.array([0, 0, up]), anchors=np.array([[0.02, 0.01, 0.0]]))
        return _springs.solve(place, START, 0.1).position / -9.81

    for value, step, slope in (
        (least, 1e-4, KNOWN["top"].gradient.truth()),
        (soft, 1e-3, KNOWN["load_step"].gradient.truth()),
        (lossy, 1e-2, _springs.slope(lossy, 0.0)),
        (pulled, 1e-2, _springs.slope(pulled, 0.0)),
    ):
        ends = [value(n * step) for n in (-2, -1, 1, 2)]
        found = (ends[0] - 8 * ends[1] + 8 * ends[2] - ends[3]) / (12 * step)
        np.testing.assert_allclose(found, slope, atol=1e-6 * np.max(np.abs(slope)))
