"""The operator's hand against the solution of its differential equation."""

import numpy as np
import pytest

from hapjax import InputError
from hapjax_devices import Hand, Operator, waypoints

PERIOD = 1e-3


def still(place=(0.0, 0.0, 0.0)):
    return np.array([place], float)


def critical(t, rate):
    """Step response of m x'' + 2 m w x' + m w^2 x = m w^2 at critical damping."""
    return 1 - np.exp(-rate * t) * (1 + rate * t)


def underdamped(t, w, zeta):
    fast = w * np.sqrt(1 - zeta**2)
    return 1 - np.exp(-zeta * w * t) * (np.cos(fast * t) + zeta * w / fast * np.sin(fast * t))


def overdamped(t, w, zeta):
    slow, quick = w * (zeta - np.sqrt(zeta**2 - 1)), w * (zeta + np.sqrt(zeta**2 - 1))
    return 1 - (quick * np.exp(-slow * t) - slow * np.exp(-quick * t)) / (quick - slow)


@pytest.mark.parametrize("period", [1e-4, 1e-3, 0.3])
@pytest.mark.parametrize("zeta", [0.2, 1.0, 2.5])
def test_step_response_to_a_force_is_the_analytic_one(zeta, period):
    mass, stiffness, force = 0.15, 400.0, np.array([1.0, -2.0, 0.5])
    w = np.sqrt(stiffness / mass)
    operator = Operator(still(), period, Hand(mass, stiffness, 2 * zeta * np.sqrt(stiffness * mass)))
    t = period * np.arange(1, 200)
    positions = []
    for _ in t:
        operator.advance(force)
        positions.append(operator.position)
    unit = critical(t, w) if zeta == 1 else (underdamped if zeta < 1 else overdamped)(t, w, zeta)
    np.testing.assert_allclose(positions, unit[:, None] * force / stiffness, atol=1e-12, rtol=1e-9)


def test_damping_left_out_is_critical():
    hand = Hand(0.2, 450.0)
    explicit = Hand(0.2, 450.0, 2 * np.sqrt(0.2 * 450.0))
    np.testing.assert_array_equal(hand.transition(PERIOD), explicit.transition(PERIOD))


def test_a_hand_on_a_steady_path_keeps_up_with_it():
    """The damper pulls towards the path's velocity, so a hand that moves at it feels no drag."""
    pace = np.array([0.1, 0.0, -0.05])
    path = pace * PERIOD * np.arange(500)[:, None]
    operator = Operator(path, PERIOD, Hand())
    operator.velocity = pace.copy()
    for row in path[1:]:
        operator.advance(np.zeros(3))
        np.testing.assert_allclose(operator.position, row, atol=1e-14)
    np.testing.assert_allclose(operator.velocity, pace, atol=1e-13)


def test_after_the_path_its_end_holds():
    operator = Operator(np.array([[0.0, 0, 0], [0.01, 0, 0]]), PERIOD, Hand())
    for _ in range(2000):
        operator.advance(np.zeros(3))
    np.testing.assert_allclose(operator.position, [0.01, 0, 0], atol=1e-12)


def test_waypoints_are_passed_at_rest_and_smoothly():
    t = np.linspace(-0.5, 3.5, 40_001)
    p = waypoints([0.0, 1.0, 3.0], [0.0, 0.02, -0.01], t)
    for time, value in ((-0.5, 0.0), (0.0, 0.0), (1.0, 0.02), (3.0, -0.01), (3.5, -0.01)):
        assert p[np.argmin(np.abs(t - time))] == pytest.approx(value, abs=1e-15)
    speed = np.gradient(p, t)
    acceleration = np.gradient(speed, t)
    for time in (0.0, 1.0, 3.0):
        assert abs(speed[np.argmin(np.abs(t - time))]) < 1e-6
        assert abs(acceleration[np.argmin(np.abs(t - time))]) < 1e-3
    # Peak speed of the least-jerk passage: 15/8 of the mean speed.
    assert np.max(np.abs(speed)) == pytest.approx(15 / 8 * 0.02, rel=1e-4)
    assert p[np.argmin(np.abs(t - 0.5))] == pytest.approx(0.01)


def test_waypoints_of_points_go_axis_by_axis():
    points = np.array([[0.0, 1.0, 2.0], [3.0, -1.0, 2.0]])
    t = np.linspace(0, 2, 7)
    both = waypoints([0.0, 2.0], points, t)
    for axis in range(3):
        np.testing.assert_array_equal(both[:, axis], waypoints([0.0, 2.0], points[:, axis], t))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Hand(mass=0.0), "mass of the hand is 0.0"),
        (lambda: Hand(stiffness=-1.0), "stiffness of the hand is -1.0"),
        (lambda: Hand(damping=float("nan")), "damping of the hand is nan"),
        (lambda: Operator(np.zeros((0, 3)), PERIOD, Hand()), "path has the shape"),
        (lambda: Operator(still((np.nan, 0, 0)), PERIOD, Hand()), "finite"),
        (lambda: Operator(still(), 0.0, Hand()), "period is 0.0 s"),
        (lambda: waypoints([0.0, 0.0], [1.0, 2.0], np.zeros(1)), "increase"),
        (lambda: waypoints([0.0, 1.0], [1.0], np.zeros(1)), "one for each"),
    ],
)
def test_refusals(make, said):
    with pytest.raises(InputError, match=said):
        make()
