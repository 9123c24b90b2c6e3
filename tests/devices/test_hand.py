"""A hand's reflex, tremor and goals against the solutions of their equations."""

import dataclasses

import numpy as np
import pytest

from hapjax import InputError
from hapjax_devices import Hand, Operator, Reflex, Tremor, VirtualDevice, waypoints

PERIOD = 1e-3
STILL = np.zeros((1, 3))
HAND = Hand(mass=0.15, stiffness=100.0, damping=5.0)


def pushed(hand, forces, period=PERIOD):
    """Where forces (T,) N along z push a hand, (T,) m, after each sample."""
    operator = Operator(STILL, period, hand)
    places = []
    for force in forces:
        operator.advance(np.array([0.0, 0.0, force]))
        places.append(operator.position[2])
    return np.array(places)


def with_reflex(*numbers):
    return dataclasses.replace(HAND, reflex=Reflex(*numbers))


# The reflex -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("delay", [0.03, 0.0305])
def test_until_its_delay_is_over_a_reflex_does_nothing_and_in_the_end_all(delay):
    forces = np.ones(3000)
    plain, late = pushed(HAND, forces), pushed(with_reflex(150.0, 1.0, delay), forces)
    silent = round(0.03 / PERIOD)
    np.testing.assert_array_equal(late[:silent], plain[:silent])
    assert np.all(late[silent + 2 : silent + 10] < plain[silent + 2 : silent + 10])
    assert late[-1] == pytest.approx(1.0 / 250.0, rel=1e-5)


def test_a_reflex_without_delay_to_speak_of_is_stiffness_and_damping():
    wrong = []
    for period in (4e-4, 2e-4):
        forces = np.ones(round(0.4 / period))
        late = pushed(with_reflex(150.0, 1.0, period), forces, period)
        at_once = pushed(dataclasses.replace(HAND, stiffness=250.0, damping=6.0), forces, period)
        wrong.append(np.max(np.abs(late - at_once)) / np.max(at_once))
    assert wrong[0] < 5e-3
    assert wrong[0] / wrong[1] == pytest.approx(2.0, rel=0.1)  # first order in the delay


@pytest.mark.parametrize("delay", [0.04, 0.0405])
@pytest.mark.parametrize("hertz", [1.0, 4.0, 6.0, 10.0])
def test_its_resonance_is_that_of_the_transfer_function(hertz, delay):
    """x / f = 1 / (m s^2 + c s + k + (c_r s + k_r) e^(-s d)) at s = j w."""
    reflex, w = Reflex(60.0, 0.5, delay), 2 * np.pi * hertz
    t = np.arange(round(6.0 / PERIOD)) * PERIOD
    places = pushed(dataclasses.replace(HAND, reflex=reflex), np.cos(w * (t + PERIOD / 2)))
    late = slice(-round(2.0 / PERIOD), None)  # whole periods
    seen = 2 * np.mean(places[late] * np.exp(-1j * w * (t + PERIOD)[late]))
    s = 1j * w
    dynamic = HAND.mass * s**2 + 5.0 * s + HAND.stiffness
    expected = 1 / (dynamic + (reflex.damping * s + reflex.stiffness) * np.exp(-s * delay))
    assert seen == pytest.approx(expected, rel=2e-3)


def swing_of(stiffness, delay):
    """How the swing after a tap grows from the third second to the sixth."""
    places = pushed(with_reflex(stiffness, 0.0, delay), np.where(np.arange(6000) < 20, 1.0, 0.0))
    return np.max(np.abs(places[-1000:])) / np.max(np.abs(places[2000:3000]))


@pytest.mark.parametrize("delay", [0.03, 0.06])
def test_it_shakes_where_the_characteristic_equation_has_a_root_to_the_right(delay):
    """m s^2 + c s + k + k_r e^(-s d) = 0 at s = j w: m w^2 = k + c w cot(w d), then k_r = c w / sin(w d)."""
    low, high = 1.0, np.pi / delay * (1 - 1e-9)
    for _ in range(80):
        w = (low + high) / 2
        slower = HAND.mass * w**2 < HAND.stiffness + 5.0 * w / np.tan(w * delay)
        low, high = (w, high) if slower else (low, w)
    border = 5.0 * w / np.sin(w * delay)
    assert swing_of(0.98 * border, delay) < 1 < swing_of(1.02 * border, delay)


# Tremor -----------------------------------------------------------------------------------------------------


def test_tremor_has_its_size_and_its_band_on_each_axis():
    tremor = Tremor(amplitude=0.05, seed=3)
    t = np.arange(round(60.0 / 5e-3)) * 5e-3
    force = np.array([tremor.force(x) for x in t])
    np.testing.assert_allclose(np.sqrt(np.mean(force**2, axis=0)), 0.05, rtol=0.05)
    power = np.abs(np.fft.rfft(force * np.hanning(len(t))[:, None], axis=0)) ** 2
    hertz = np.fft.rfftfreq(len(t), 5e-3)
    inside = (hertz > 7.9) & (hertz < 12.1)
    assert np.all(np.sum(power[inside], axis=0) > 0.999 * np.sum(power, axis=0))
    for low in (8.0, 9.0, 10.0, 11.0):  # even over the band
        part = np.sum(power[(hertz >= low) & (hertz < low + 1)], axis=0) / np.sum(power, axis=0)
        np.testing.assert_allclose(part, 0.25, atol=0.08)
    assert np.all(np.abs(np.corrcoef(force.T)[np.triu_indices(3, 1)]) < 0.1)


def test_a_trembling_hand_moves_as_its_impedance_lets_it():
    tremor = Tremor(0.05, 9.99, 10.01)
    places = pushed(dataclasses.replace(HAND, tremor=tremor), np.zeros(20_000))[-10_000:]
    w = 2 * np.pi * 10.0
    expected = 0.05 / abs(HAND.stiffness - HAND.mass * w**2 + 5.0j * w)
    force = np.array([tremor.force(x) for x in np.arange(10.0, 20.0, 5e-3)])[:, 2]
    assert np.std(places) == pytest.approx(expected * np.std(force) / 0.05, rel=0.02)


def test_tremor_is_the_same_again_and_in_a_longer_run():
    def run(seed, samples):
        return pushed(Hand(tremor=Tremor(seed=seed)), np.zeros(samples))

    np.testing.assert_array_equal(run(1, 300), run(1, 900)[:300])
    assert not np.allclose(run(1, 300), run(2, 300))


# Goals ------------------------------------------------------------------------------------------------------


def goals(operator, samples):
    found = []
    for _ in range(samples):
        found.append(operator.goal)
        operator.advance(np.zeros(3))
    return np.array(found)


def test_from_rest_a_goal_goes_as_waypoints_do():
    operator, point = Operator(STILL + 0.01, PERIOD, HAND), [0.03, -0.02, 0.05]
    operator.go_to(point, 0.4)
    found = goals(operator, 600)
    t = np.arange(600) * PERIOD
    np.testing.assert_allclose(found, waypoints([0.0, 0.4], [[0.01] * 3, point], t), atol=1e-15)
    np.testing.assert_allclose(goals(operator, 3000)[-1], point, atol=1e-15)
    np.testing.assert_allclose(operator.position, point, atol=1e-9)


def test_told_anew_a_goal_goes_on_without_a_jump_of_place_velocity_or_acceleration():
    operator = Operator(STILL, PERIOD, HAND)
    operator.go_to([0.05, 0.0, 0.0], 0.5)
    first = goals(operator, 170)
    operator.go_to([0.0, 0.05, 0.0], 0.3)
    found = np.concatenate([first, goals(operator, 400)])
    speed = np.diff(found, axis=0) / PERIOD
    acceleration = np.diff(speed, axis=0) / PERIOD
    jerk = np.diff(acceleration, axis=0) / PERIOD
    # A jump of the acceleration would be a jerk of its size over the period.
    assert np.max(np.abs(jerk)) * PERIOD < 0.05 * np.max(np.abs(acceleration))
    np.testing.assert_allclose(found[-1], [0.0, 0.05, 0.0], atol=1e-15)


def test_off_a_path_a_goal_keeps_the_paths_speed():
    path = np.outer(np.arange(1000) * PERIOD, [0.1, 0.0, 0.0])
    operator = Operator(path, PERIOD, HAND)
    before = goals(operator, 200)
    operator.go_to([0.0, 0.0, 0.0], 0.5)
    speed = np.diff(np.concatenate([before, goals(operator, 600)])[:, 0]) / PERIOD
    assert np.max(np.abs(np.diff(speed))) < 0.01 * 0.1 * 2
    assert speed[-1] == 0 and np.max(np.abs(speed)) < 0.2


def test_a_virtual_device_is_led_while_it_is_open():
    with VirtualDevice(STILL) as device:
        device.operator.go_to([0.0, 0.0, 0.02], 0.2)
        for _ in range(1000):
            device.write(np.zeros(3))
        np.testing.assert_allclose(device.read(), [0.0, 0.0, 0.02], atol=device.resolution)
    with device:
        np.testing.assert_array_equal(device.operator.goal, np.zeros(3))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda: Reflex(-1.0), "stiffness of the reflex is -1.0"),
        (lambda: Reflex(1.0, float("nan")), "damping of the reflex is nan"),
        (lambda: Reflex(1.0, 0.0, 0.0), "delay of the reflex is 0.0 s"),
        (
            lambda: Operator(STILL, 0.05, with_reflex(1.0)),
            "delay of the reflex is 0.04 s; allowed: the period",
        ),
        (lambda: Tremor(-0.1), "amplitude of the tremor is -0.1 N"),
        (lambda: Tremor(0.1, 12.0, 8.0), "low and high of the tremor are 12.0 and 8.0 Hz"),
        (lambda: Tremor(seed=-1), "seed of the tremor is -1"),
        (lambda: Operator(STILL, PERIOD, HAND).go_to([0.0, 1.0], 1.0), "point is"),
        (lambda: Operator(STILL, PERIOD, HAND).go_to([0.0, 1.0, np.nan], 1.0), "finite"),
        (lambda: Operator(STILL, PERIOD, HAND).go_to([0.0, 1.0, 0.0], 0.0), "duration is 0.0 s"),
    ],
)
def test_refusals(make, said):
    with pytest.raises(InputError, match=said):
        make()
