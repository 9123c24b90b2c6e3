"""Residuals that err alike: what a fit says of them."""

import numpy as np
import pytest

from fitting_cases import BOTH, SIGMA, floor, forces, stroke
from hapjax import Recording
from hapjax_fitting import fit
from hapjax_fitting.correlated import correlated


def drifting(length: int, memory: float, seed: int = 0) -> np.ndarray:
    noise = np.random.default_rng(seed).standard_normal((1, length, 3))
    for i in range(1, length):
        noise[:, i] += memory * noise[:, i - 1]
    return noise


@pytest.mark.parametrize("loss", ["squares", "huber", "student"])
def test_of_noise_with_a_memory_it_is_said_how_long_and_what_was_done(loss):
    (found,) = correlated([("force", drifting(4000, 0.8)), ("position", drifting(4000, 0.0))], (), loss)
    assert (found.channel, found.kind, found.done) == ("force", "correlated residuals", "intervals widened")
    count = int(found.sentence.split("about ")[1].split()[0])
    assert (
        (8 if loss == "squares" else 7) <= count <= 10
    )  # (1 + 0.8) / (1 - 0.8), less where outliers are cut off
    assert f"intervals are {int(np.sqrt(count))}." in found.sentence or "are 3.0 times" in found.sentence


def test_of_noise_that_was_given_intervals_are_as_given():
    (found,) = correlated([("angle", drifting(4000, 0.8))], {"angle"}, "squares")
    assert found.channel == "pose" and found.done == "only reported" and "do not account" in found.sentence


def test_a_drift_as_long_as_the_recording_is_told_apart():
    (found,) = correlated([("force", np.cumsum(drifting(400, 0.0), axis=1))], (), "squares")
    assert "may be too narrow" in found.sentence


@pytest.mark.parametrize("length", [20, 50, 400])
def test_white_noise_and_rounding_are_no_finding(length):
    said = [correlated([("force", drifting(length, 0.0, seed))], (), "squares") for seed in range(100)]
    assert sum(map(bool, said)) <= 1
    assert not correlated([("force", 1e-3 * drifting(400, 0.8))], (), "squares")


@pytest.mark.slow
def test_a_fit_says_so():
    t, path = stroke(150)
    noise = SIGMA * drifting(150, 0.8)[0][:, None]
    recording = Recording(hip=path, hip_t=t, force=forces(floor(), path) + noise, force_t=t)
    result = fit(floor(), recording, BOTH, starts=1)
    assert [finding.kind for finding in result.findings] == ["misfit", "correlated residuals"]
    assert "estimated; most" in str(result.findings[0]) and "unless noise errs alike" in str(
        result.findings[0]
    )
