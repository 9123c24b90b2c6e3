"""The virtual device: what it rounds, limits and delays."""

import numpy as np
import pytest

from hapjax_devices import Device, DeviceClosed, DeviceError, Hand, VirtualDevice
from hapjax_devices.virtual import ENCODER_STEP, FORCE_LIMIT, FORCE_STEP


def moving_path(samples=400):
    t = np.arange(samples)[:, None] * 1e-3
    return np.array([[0.01, -0.02, 0.1]]) + 0.02 * np.sin(2 * np.pi * t * np.array([[1.0, 2.0, 3.0]]))


def test_it_is_a_device():
    device = VirtualDevice(moving_path())
    assert isinstance(device, Device)
    assert device.force_limit == 8.5 and device.resolution == 3e-5


def test_positions_come_in_encoder_steps_and_one_sample_late():
    with VirtualDevice(moving_path(), resolution=3e-5) as device:
        positions, readings = [device.operator.position], []
        for _ in range(300):
            readings.append(device.read())
            device.write(np.zeros(3))
            positions.append(device.operator.position)
    readings, positions = np.array(readings), np.array(positions)
    counts = readings / 3e-5
    np.testing.assert_allclose(counts, np.rint(counts), atol=1e-9)
    assert len(np.unique(np.rint(counts[:, 0]))) > 50
    late = np.concatenate([positions[:1], positions[:299]])
    assert np.max(np.abs(readings - late)) <= ENCODER_STEP / 2 * (1 + 1e-9)
    # The hand moves by more than a step in a sample, so a device without the delay would be found out.
    assert np.max(np.abs(readings - positions[:300])) > 2 * ENCODER_STEP


def test_forces_come_in_steps_and_reach_the_hand():
    force = np.array([1.00003, -2.3456, 0.0004])
    with VirtualDevice(np.zeros((1, 3)), hand=Hand(stiffness=500.0)) as device:
        put_out = device.write(force)
        np.testing.assert_array_equal(put_out, device.output)
        for _ in range(3000):
            device.write(force)
        hand = device.operator.position
    np.testing.assert_allclose(put_out / FORCE_STEP, np.rint(put_out / FORCE_STEP), atol=1e-9)
    assert np.all(np.abs(put_out - force) <= FORCE_STEP / 2 * (1 + 1e-9))
    assert not np.array_equal(put_out, force)
    np.testing.assert_allclose(hand, put_out / 500.0, rtol=1e-9)


def test_no_force_over_the_limit_is_put_out():
    random = np.random.default_rng(0)
    with VirtualDevice(np.zeros((1, 3))) as device:
        for size in (8.4, 8.4999, 8.5, 8.5001, 9.0, 1e4):
            for _ in range(200):
                direction = random.standard_normal(3)
                direction /= np.linalg.norm(direction)
                put_out = device.write(size * direction)
                assert np.linalg.norm(put_out) <= FORCE_LIMIT * (1 + 1e-12)
                want = min(size, FORCE_LIMIT) * direction
                assert np.max(np.abs(put_out - want)) <= FORCE_STEP * (1 + 1e-9)


def test_a_device_that_is_not_open_refuses():
    device = VirtualDevice(np.zeros((1, 3)))
    for use in (device.read, lambda: device.write(np.zeros(3))):
        with pytest.raises(DeviceClosed):
            use()
    with device:
        device.write(np.ones(3))
    assert issubclass(DeviceClosed, DeviceError)
    np.testing.assert_array_equal(device.output, np.zeros(3))
    with pytest.raises(DeviceClosed):
        device.read()
    device.close()


def test_opened_again_it_starts_again():
    device = VirtualDevice(moving_path())
    runs = []
    for _ in range(2):
        with device:
            readings = []
            for _ in range(50):
                readings.append(device.read())
                device.write(np.array([0.0, 0.0, 1.0]))
        runs.append(readings)
    np.testing.assert_array_equal(runs[0], runs[1])


def test_a_path_that_is_gone_again_has_no_end():
    there = moving_path(100)
    way = np.concatenate([there, there[:0:-1]])  # and back, so that its end meets its beginning
    angle = np.arange(len(way)) / 100
    with VirtualDevice(way, hand=Hand(stiffness=1e6), gimbal=angle, again=True) as device:
        readings, angles = [], []
        for _ in range(3 * len(way)):
            readings.append(device.read())
            angles.append(device.read_gimbal())
            device.write(np.zeros(3))
    np.testing.assert_allclose(readings[1:], np.tile(way, (3, 1))[:-1], atol=1e-4)  # one sample late
    np.testing.assert_array_equal(angles[1:], np.tile(angle, 3)[:-1])


def test_a_force_that_is_no_number_is_refused_and_forgotten():
    with VirtualDevice(np.zeros((1, 3))) as device:
        with pytest.raises(DeviceError, match="nan"):
            device.write(np.array([np.nan, 0.0, 0.0]))
        device.write(np.zeros(3))
        assert np.all(np.isfinite(device.read())) and np.all(np.isfinite(device.output))
