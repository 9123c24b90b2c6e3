"""The noise of the sensors: its size, its independence, its seed."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hapjax import InputError
from hapjax_devices import ForceSensor, PoseTracker

SAMPLES = 4000
# The estimate of a standard deviation from n samples has one of its own: a fraction 1 / sqrt(2 n) of it.
FOUR_SIGMA = 4 / np.sqrt(2 * SAMPLES)


def test_force_noise_is_white_and_of_the_given_size():
    sensor = ForceSensor(noise=0.02, seed=3)
    truth = np.array([[1.0, -2.0, 3.0], [0.0, 0.0, 5.0]])
    noise = np.array([sensor.measure(truth) - truth for _ in range(SAMPLES)]).reshape(SAMPLES, 6)
    np.testing.assert_allclose(noise.std(axis=0), 0.02, rtol=FOUR_SIGMA)
    assert np.all(np.abs(noise.mean(axis=0)) < 4 * 0.02 / np.sqrt(SAMPLES))
    correlation = np.corrcoef(np.hstack([noise[1:], noise[:-1]]).T) - np.eye(12)
    assert np.max(np.abs(correlation[:6])) < 5 / np.sqrt(SAMPLES)


def test_pose_noise_is_of_the_given_size_in_place_and_rotation():
    tracker = PoseTracker(place_noise=1e-4, angle_noise=np.radians(0.1), seed=4)
    turn = Rotation.from_rotvec([0.5, -1.0, 2.0])
    truth = np.concatenate([[0.1, 0.2, 0.3], turn.as_quat(scalar_first=True)])[None]
    found = np.array([tracker.measure(truth)[0] for _ in range(SAMPLES)])
    np.testing.assert_allclose((found[:, :3] - truth[0, :3]).std(axis=0), 1e-4, rtol=FOUR_SIGMA)
    np.testing.assert_allclose(np.linalg.norm(found[:, 3:], axis=1), 1.0, atol=1e-14)
    vector = (Rotation.from_quat(found[:, 3:], scalar_first=True) * turn.inv()).as_rotvec(degrees=True)
    np.testing.assert_allclose(vector.std(axis=0), 0.1, rtol=FOUR_SIGMA)
    assert np.all(np.abs(vector.mean(axis=0)) < 4 * 0.1 / np.sqrt(SAMPLES))


def test_a_large_rotation_noise_is_the_exponential_of_the_vector():
    """Against SciPy: the same draws, turned into rotations there."""
    turn = Rotation.from_rotvec([[0.3, 0.2, 0.1], [-2.0, 0.0, 1.0]])
    truth = np.concatenate([np.zeros((2, 3)), turn.as_quat(scalar_first=True)], axis=1)
    found = PoseTracker(place_noise=0.0, angle_noise=1.0, seed=5).measure(truth)
    random = np.random.default_rng([5, 2])
    random.standard_normal((2, 3))
    want = Rotation.from_rotvec(random.standard_normal((2, 3))) * turn
    assert np.max((Rotation.from_quat(found[:, 3:], scalar_first=True) * want.inv()).magnitude()) < 1e-12


def test_without_noise_the_truth_is_measured():
    pose = np.array([[0.1, 0.2, 0.3, 0.5, 0.5, -0.5, 0.5]])
    np.testing.assert_array_equal(PoseTracker(place_noise=0.0, angle_noise=0.0).measure(pose), pose)


def test_the_seed_decides():
    def draw(seed):
        return ForceSensor(seed=seed).measure(np.zeros((1, 3)))

    np.testing.assert_array_equal(draw(1), draw(1))
    assert not np.array_equal(draw(1), draw(2))


@pytest.mark.parametrize(
    "make",
    [
        lambda: ForceSensor(rate=0.0),
        lambda: ForceSensor(noise=-1.0),
        lambda: PoseTracker(rate=float("inf")),
        lambda: PoseTracker(place_noise=float("nan")),
        lambda: PoseTracker(angle_noise=-0.1),
    ],
)
def test_refusals(make):
    with pytest.raises(InputError, match="sensor's|tracker's"):
        make()
