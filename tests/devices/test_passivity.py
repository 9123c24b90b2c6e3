"""Passivity control: what it sees is the energy that flows, and a loop that shakes without it is calm with it."""

import numpy as np
import pytest

import hapjax_devices as devices
from hapjax import InputError, Object, Plane, Scene, Surface
from hapjax_devices import Hand, Passivity, PassivityControl, servo

RATE = 500.0  # Hz: one sample late, b > K T (1/2 + 1) asks a wall of 1500 N/m for 4.5 N s/m
HAND = Hand(mass=0.15, stiffness=100.0, damping=1.0)
STIFF, SOFT = 1500.0, 100.0  # N/m


def press(stiffness, passivity, force_limit=8.5):
    """A hand presses on a wall with 2 N for 2 s through a device; z of the finger, forces, and the loop's result."""
    wall = Scene({"wall": Object(Plane(), Surface(stiffness, mu=0.3))})
    t = np.arange(round(2 * RATE)) / RATE
    depth = 2 / HAND.stiffness + 2 / stiffness
    path = np.stack([0 * t, 0 * t, 0.01 - devices.waypoints([0.0, 0.5], [0.0, 0.01 + depth], t)], 1)
    device = devices.VirtualDevice(path, 1 / RATE, HAND, force_limit=force_limit)
    sensor = devices.ForceSensor(rate=RATE, noise=0.0)
    result = devices.run(wall, [device], 2.0, RATE, realtime=False, force_sensor=sensor, passivity=passivity)
    assert result.recording.hip is not None and result.recording.force is not None
    return result.recording.hip[:, 0, 2], result.recording.force[:, 0], result


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_the_energy_is_that_of_the_force_that_was_held_while_the_finger_moved(delay):
    rng = np.random.default_rng(0)
    place = np.cumsum(rng.normal(size=(40, 2, 3)), axis=0)  # where the fingers really are, m
    read = place[np.maximum(np.arange(40) - delay, 0)]
    force = rng.normal(size=(40, 2, 3))
    control = PassivityControl(Passivity(delay), 1e-3, place[0])
    for n in range(40):
        control(force[n], read[n])
        control.put_out(force[n])
    seen = 39 - delay  # samples of the path
    put_in = -np.sum(force[:seen] * np.diff(place, axis=0)[:seen], axis=(0, 2))
    np.testing.assert_allclose(control.energy, put_in, rtol=1e-12)


def test_the_damping_is_what_is_missing():
    """A force of 3 N that pushes a finger on at 0.1 m/s from nothing gives 0.3 W; damped, it gives none."""
    control = PassivityControl(Passivity(most_damping=100.0), 1e-3, np.zeros((1, 3)))
    along = np.array([[0.0, 1e-4, 0.0]])
    first = control(np.array([[1.0, 3.0, 0.0]]), along)
    np.testing.assert_allclose(first, [[1.0, 0.0, 0.0]], atol=1e-12)
    control.put_out(first)
    control(np.zeros((1, 3)), 2 * along)
    np.testing.assert_allclose(control.energy, 0, atol=1e-15)
    assert control.damped == 1


def test_the_added_damping_is_at_most_the_most():
    control = PassivityControl(Passivity(most_damping=20.0), 1e-3, np.zeros((1, 3)))
    force = control(np.array([[0.0, 3.0, 0.0]]), np.array([[0.0, 1e-4, 0.0]]))
    np.testing.assert_allclose(force, [[0.0, 3.0 - 20.0 * 0.1, 0.0]])


@pytest.mark.slow
def test_a_wall_that_shakes_without_it_is_calm_with_it():
    late = slice(-round(RATE), None)
    z, _, result = press(STIFF, None)
    assert np.ptp(z[late]) > 20e-3 and result.passivity is None
    z, force, result = press(STIFF, Passivity(delay=1))
    assert np.ptp(z[late]) < 1e-3
    np.testing.assert_allclose(np.mean(force[late, 2]), 2.0, rtol=0.02)  # it still is a wall
    control = result.passivity
    assert control is not None and control.damped > 0
    assert control.energy[0] > 0 > control.lowest[0]  # what it was short of was taken back


def test_the_energy_does_not_stay_negative():
    """From the recording alone: the spells in which the device has given more than it got are short."""
    z, force, _ = press(STIFF, Passivity(delay=1))
    energy = np.concatenate([[0, 0], np.cumsum(-force[:-2, 2] * np.diff(z)[1:])])  # z is one sample late
    spells = np.flatnonzero(np.diff(np.concatenate([[0], energy < -1e-6, [0]])))
    assert 0 < len(spells) and np.max(np.diff(spells)[::2]) < 0.2 * RATE


@pytest.mark.slow
def test_a_wall_that_is_passive_is_left_alone():
    z, force, result = press(SOFT, Passivity(delay=1))
    assert result.passivity is not None and result.passivity.damped == 0
    plain_z, plain_force, _ = press(SOFT, None)
    np.testing.assert_array_equal(z, plain_z)
    np.testing.assert_array_equal(force, plain_force)


def test_the_force_keeps_to_the_devices_limit():
    _, force, result = press(STIFF, Passivity(delay=1, most_damping=1e6), force_limit=3.0)
    assert np.max(np.linalg.norm(force, axis=1)) <= 3.0 and result.limited > 0


def test_a_lost_step_puts_out_no_force_with_it_either(monkeypatch):
    """The control would damp a finger that moves; a wall so stiff that each step is lost asks for none at all."""
    monkeypatch.setattr(PassivityControl, "__call__", lambda self, force, hip: force - 1.0)
    _, force, result = press(1e16, Passivity())
    assert result.lost > 100
    pressed = np.linalg.norm(force, axis=1) > 0
    assert np.count_nonzero(~pressed) >= result.lost and np.any(pressed)


def test_off_it_is_not_there(monkeypatch):
    def refuse(*_):
        raise AssertionError("made though it is off")

    monkeypatch.setattr(servo, "PassivityControl", refuse)
    press(SOFT, None)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"delay": -1}, "delay of the passivity control is -1"),
        ({"delay": 101}, "delay of the passivity control is 101"),
        ({"most_damping": 0.0}, "most_damping of the passivity control is 0.0"),
        ({"most_damping": float("nan")}, "most_damping of the passivity control is nan"),
    ],
)
def test_refusals(change, said):
    with pytest.raises(InputError, match=said):
        Passivity(**change)
