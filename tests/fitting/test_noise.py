import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hapjax import InputError, Recording
from hapjax_fitting.noise import correlation_time, noise_of, spread_of

T = np.arange(4000) * 1e-3
RANDOM = np.random.default_rng(3)


def force_of(sigma):
    smooth = np.stack([np.sin(9 * T), 3 * np.cos(5 * T), T**2], axis=-1)[:, None]
    return smooth + sigma * RANDOM.standard_normal(smooth.shape)


@pytest.mark.parametrize("sigma", [1e-3, 0.02, 0.5])
def test_white_noise_on_a_smooth_signal_is_found(sigma):
    noise = noise_of([Recording(force=force_of(sigma), force_t=T)], None, np.float64)
    assert float(noise.force) == pytest.approx(sigma, rel=0.04)


@pytest.mark.parametrize("turned", [[0, 0, 0], [0.3, -1.2, 2.0]])
def test_noise_of_a_pose_is_found_in_any_attitude(turned):
    place = np.stack([0.1 * T, np.sin(3 * T), 0 * T], axis=-1) + 2e-4 * RANDOM.standard_normal((len(T), 3))
    attitude = Rotation.from_rotvec(np.outer(T, [0.5, 0.2, -0.4])) * Rotation.from_rotvec(turned)
    attitude = attitude * Rotation.from_rotvec(3e-3 * RANDOM.standard_normal((len(T), 3)))
    quaternion = attitude.as_quat(scalar_first=True) * RANDOM.choice([-1, 1], (len(T), 1))
    recording = Recording(pose=np.concatenate([place, quaternion], axis=1), pose_t=T)
    noise = noise_of([recording], None, np.float64)
    assert float(noise.position) == pytest.approx(2e-4, rel=0.04)
    assert float(noise.angle) == pytest.approx(3e-3, rel=0.04)


def test_samples_that_do_not_change_do_not_count():
    force = force_of(0.02)
    force[:3000] = 0  # a sensor that reads exactly 0 out of contact
    noise = noise_of([Recording(force=force, force_t=T)], None, np.float64)
    assert float(noise.force) == pytest.approx(0.02, rel=0.06)


def test_exact_data_have_a_noise_above_0():
    noise = noise_of([Recording(force=np.zeros((9, 1, 3)), force_t=T[:9])], None, np.float64)
    assert float(noise.force) > 0


def test_given_noise_is_taken():
    noise = noise_of([Recording(force=force_of(0.1), force_t=T)], {"force": 0.5}, np.float32)
    assert noise.force.dtype == np.float32 and float(noise.force) == 0.5


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_noise_that_is_no_number_above_0_is_refused(value):
    with pytest.raises(InputError, match="noise of force is .*; allowed: a number above 0"):
        noise_of([], {"force": value}, np.float64)


def test_noise_of_an_unknown_channel_is_refused():
    with pytest.raises(InputError, match="noise names torque; allowed: force, position, angle"):
        noise_of([], {"torque": 1.0}, np.float64)


def test_white_residuals_have_a_correlation_time_of_1():
    assert correlation_time([RANDOM.standard_normal((2, 5000, 3))]) == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize("phi", [0.5, 0.9])
def test_correlation_time_of_a_first_order_process(phi):
    r = RANDOM.standard_normal((4, 20_000, 3))
    for i in range(1, r.shape[1]):
        r[:, i] += phi * r[:, i - 1]
    assert correlation_time([r]) == pytest.approx((1 + phi) / (1 - phi), rel=0.1)


def test_a_constant_error_counts_once():
    assert correlation_time([np.ones((1, 1000, 1))]) == pytest.approx(1000, rel=0.01)


def test_given_noise_is_believed_and_estimated_noise_replaced():
    channels = [("force", 3 * RANDOM.standard_normal((1, 4000, 3))), ("position", np.full((1, 10, 1), 2.0))]
    size, variance = spread_of(channels, {"position": 1e-3}, free=2)
    assert size["force"] == pytest.approx(3, rel=0.03) and size["position"] == 2
    np.testing.assert_allclose(variance[:12000], 9, rtol=0.15)
    np.testing.assert_array_equal(variance[12000:], 1)
