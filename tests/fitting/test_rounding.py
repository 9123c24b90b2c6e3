"""Forces that come in steps: which steps, and intervals that hold the truth all the same."""

from dataclasses import replace

import numpy as np
import pytest

from fitting_cases import BOTH, MU, STIFFNESS, floor, forces
from hapjax import Recording
from hapjax_devices.virtual import ENCODER_STEP, FORCE_STEP
from hapjax_fitting import fit
from hapjax_fitting.rounding import readings_of, sharpness, step_of, together

RANDOM = np.random.default_rng(0)
WHOLE = RANDOM.integers(-4000, 4000, 5000)


def in_steps(values, step):
    return np.rint(values / step) * step


@pytest.mark.parametrize(
    "values",
    [
        WHOLE * FORCE_STEP,
        (WHOLE * FORCE_STEP).astype(np.float32).astype(np.float64),
        WHOLE * FORCE_STEP + 0.37,  # a bias was taken off
        in_steps(0.03 * RANDOM.integers(-40, 40, 500), FORCE_STEP),  # 14 or 15 steps apart
    ],
    ids=["double", "single", "bias", "sparse"],
)
def test_steps_are_found(values):
    assert step_of(values) == pytest.approx(FORCE_STEP, rel=1e-4)


@pytest.mark.parametrize("values", [RANDOM.standard_normal(5000), np.zeros(9), np.array([0.0, 1.0, 0.0])])
def test_what_has_no_steps_has_none(values):
    assert step_of(values) == 0


@pytest.mark.parametrize(("noise", "least", "most"), [(0.0, 0.99, 1.0), (0.1, 0.5, 1.0), (1.0, 0.0, 1e-4)])
def test_noise_blurs_steps(noise, least, most):
    signal = np.full(4000, 0.3) + noise * RANDOM.standard_normal(4000)
    assert least <= sharpness(0.3 - np.rint(signal)) <= most


def pressed(seed: int, depth_step: float = ENCODER_STEP) -> tuple[dict[str, float], Recording]:
    """A finger that presses and moves to and fro, its place and its force in steps, as of a device; and the truth."""
    random, t = np.random.default_rng(seed), 1e-3 * np.arange(300)
    truth = {MU: random.uniform(0.3, 0.8), STIFFNESS: random.uniform(500, 1500)}
    z = 0.001 - np.minimum(t / 0.05, 1) * (random.uniform(0.001, 0.003) + 0.001)
    x = 0.005 * (1 - np.cos(2 * np.pi * t / t[-1]))
    path = in_steps(np.stack([x, 0 * x, z], axis=-1)[:, None], depth_step)
    return truth, Recording(
        hip=path, hip_t=t, force=forces(floor(truth[MU], truth[STIFFNESS]), path), force_t=t
    )


def test_intervals_hold_the_truth_of_forces_in_steps():
    held, off, error = 0, [], []
    for seed in range(10):
        truth, exact = pressed(seed)
        recording = replace(exact, force=in_steps(exact.force, FORCE_STEP))
        result = fit(floor(1.1 * truth[MU], 0.9 * truth[STIFFNESS]), recording, BOTH, starts=1)
        for name in BOTH:
            number = result.parameters[name]
            low, high = number.interval95
            assert low and high and number.estimate and number.standard_error
            held += low <= truth[name] <= high
            off.append(number.estimate / truth[name] - 1)
            error.append(number.standard_error / truth[name])
    assert held >= 18  # of 20
    assert 0.5 < np.sqrt(np.mean(np.square(off)) / np.mean(np.square(error))) < 1.5


def test_noise_that_is_given_does_not_make_up_for_steps():
    truth, exact = pressed(0)
    recording = replace(exact, force=in_steps(exact.force, FORCE_STEP))
    start = floor(1.1 * truth[MU], 0.9 * truth[STIFFNESS])
    rounding = {"force": FORCE_STEP / np.sqrt(12)}
    found, believed = (fit(start, recording, BOTH, starts=1, noise=noise) for noise in (None, rounding))
    for name in BOTH:
        error = believed.parameters[name].standard_error
        assert error == pytest.approx(found.parameters[name].standard_error, rel=0.1)


def test_recordings_of_one_finger_and_of_two_have_their_steps_counted_alike():
    truth, one = pressed(0)
    one = replace(one, force=in_steps(one.force, FORCE_STEP))
    assert one.hip is not None and one.force is not None
    two = replace(one, hip=np.repeat(one.hip, 2, axis=1), force=np.repeat(one.force, 2, axis=1))
    start = floor(1.1 * truth[MU], 0.9 * truth[STIFFNESS])
    alone, both = (fit(start, recordings, BOTH, starts=1) for recordings in ([one], [one, two]))
    for name in BOTH:
        # The first finger's, which pulls by two thirds, is rounded alike in both; the second one's is another sensor's.
        error = both.parameters[name].standard_error
        expected = np.hypot(2 / 3, 1 / 3) * alone.parameters[name].standard_error
        assert error == pytest.approx(expected, rel=0.02)


def test_a_force_that_is_itself_in_steps_is_exact():
    truth, recording = pressed(0, depth_step=1e-4)  # so many mN for each step of the depth
    assert recording.force is not None
    assert step_of(recording.force[:, 0, 2]) == pytest.approx(1e-4 * truth[STIFFNESS])
    number = fit(floor(), recording, BOTH, starts=1).parameters[STIFFNESS]
    assert number.standard_error and number.standard_error < 1e-6 * truth[STIFFNESS]


def test_samples_of_two_recordings_that_read_the_same_err_alike():
    read, pull = np.full(50, 3.0), np.full((50, 1), 0.01)
    one = readings_of(1.0, read, np.full(50, 0.2), pull)
    assert one.variance(1.0) == pytest.approx(0.5**2 / 12 - 50 * 1e-4 / 12)
    opposite = readings_of(1.0, -read, np.full(50, -0.2), -pull)
    both = together([one, opposite])
    assert both.variance(1.0) == pytest.approx(1 / 12 - 100 * 1e-4 / 12)
    # Half a step that the model sees them differ by leaves half a step unknown.
    spread = readings_of(1.0, read, np.linspace(-0.2, 0.3, 50), pull)
    assert spread.variance(1.0) == pytest.approx(0.5**2 * one.variance(1.0)[0])
