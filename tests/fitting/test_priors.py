"""Priors: the posterior of a linear model, and numbers that only a prior fixes."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.signal import lfilter

from fitting_cases import MU, SIGMA, STIFFNESS, floor, forces, recorded, stroke
from hapjax import InputError
from hapjax_fitting import fit, profile

BIAS = "sensor.force_bias"
OPTIONS: dict[str, Any] = {"noise": {"force": SIGMA}, "starts": 1}
NO_SLIP: dict[str, Any] = {"length": 2e-4}


def number(result, name) -> Any:
    p = result.parameters[name]
    assert p.identified
    return p.estimate, p.standard_error


@pytest.mark.slow
def test_the_posterior_of_a_linear_model_is_the_analytic_one():
    recording = recorded(floor())
    assert recording.force is not None
    off = (recording.force - forces(floor(), stroke()[1]))[:, 0]
    known = {f"{BIAS}[0]": (0.01, 2e-3), f"{BIAS}[2]": (-0.02, 5e-4)}
    result = fit(floor(), recording, BIAS, priors=known, **OPTIONS)
    for i in range(3):
        mean, deviation = known.get(f"{BIAS}[{i}]", (0.0, np.inf))
        weights = np.array([len(off) / SIGMA**2, 1 / deviation**2])
        estimate, error = number(result, f"{BIAS}[{i}]")
        assert estimate == pytest.approx(weights @ [off[:, i].mean(), mean] / weights.sum(), rel=1e-6)
        assert error == pytest.approx(weights.sum() ** -0.5, rel=1e-6)
    rows = [(number(result, name)[0] - mean) / sd for name, (mean, sd) in known.items()]
    at_best = off - [number(result, f"{BIAS}[{i}]")[0] for i in range(3)]
    expected = 0.5 * (np.sum((at_best / SIGMA) ** 2) + np.sum(np.square(rows)))
    assert result.loss == pytest.approx(expected, rel=1e-9)


@pytest.mark.slow
def test_a_prior_and_data_of_unknown_noise_are_weighed_by_what_each_is_worth():
    """Neighbours err alike, and by more than their differences show. The data are worth their effective variance."""
    path = stroke()[1]
    wander = lfilter([0.03], [1, -0.95], np.random.default_rng(2).standard_normal(path.shape), axis=0)
    recording = replace(recorded(floor()), force=forces(floor(), path) + wander)
    alone, name = fit(floor(), recording, BIAS, starts=1), f"{BIAS}[1]"
    assert alone.variance > 100
    best, error = alone.parameters[name].estimate, alone.noise["force"] * np.sqrt(alone.variance / len(path))
    mean, deviation = best + 0.8 * error, 0.7 * error
    result = fit(floor(), recording, BIAS, priors={name: (mean, deviation)}, starts=1)
    weights, estimate = np.array([1 / error**2, 1 / deviation**2]), result.parameters[name].estimate
    likely = weights.sum() ** -0.5
    assert estimate == pytest.approx(weights @ [best, mean] / weights.sum(), abs=0.05 * likely)
    error = number(result, name)[1]
    assert likely == pytest.approx(error / result.widened[1], rel=0.05)
    ends = profile(result, name).interval95
    middle, half = number(result, name)[0], 1.96 * error
    assert ends == pytest.approx((middle - half, middle + half), abs=0.05 * error)


@pytest.mark.slow
def test_a_prior_fixes_a_mu_that_nothing_shows():
    recording = recorded(floor(), **NO_SLIP)
    alone = fit(floor(0.9), recording, [MU, STIFFNESS], **OPTIONS)
    assert not alone.parameters[MU].identified
    result = fit(floor(0.9), recording, [MU, STIFFNESS], priors={MU: (0.8, 0.1)}, **OPTIONS)
    mu, error = number(result, MU)
    assert mu == pytest.approx(0.8, rel=1e-4) and error == pytest.approx(0.08, rel=1e-3)
    assert result.parameters[MU].interval95 == pytest.approx(
        (0.8 * np.exp(-0.196), 0.8 * np.exp(0.196)), rel=1e-3
    )
    np.testing.assert_allclose(number(result, STIFFNESS), number(alone, STIFFNESS), rtol=0.2)


@pytest.mark.slow
def test_a_prior_on_one_of_two_that_only_show_together_fixes_both():
    free = [STIFFNESS, "sensor.force_gain"]
    known = {"sensor.force_gain": (1.0, 0.03)}
    result = fit(floor(0.6, 700.0), recorded(floor()), free, priors=known, **OPTIONS)
    stiffness, error = number(result, STIFFNESS)
    assert abs(stiffness - 800) < 3 * error and 0.02 < error / 800 < 0.032
    gain, error = number(result, "sensor.force_gain[1]")  # which nothing moves along
    assert gain == pytest.approx(1, abs=0.02) and error == pytest.approx(0.03, rel=0.05)


@pytest.mark.slow
def test_between_bounds_a_prior_is_gaussian():
    recording, bounds = recorded(floor(), **NO_SLIP), {MU: (0.5, 3.0)}
    result = fit(floor(0.9), recording, MU, bounds=bounds, priors={MU: (1.2, 0.05)}, **OPTIONS)
    assert number(result, MU) == pytest.approx((1.2, 0.05), rel=1e-3)


@pytest.mark.parametrize(
    ("priors", "message"),
    [
        ({STIFFNESS: (800.0, 0.1)}, f"priors names {STIFFNESS}, which is not free; allowed: {MU}"),
        ({MU: (0.5, 0.0)}, "the latter above 0"),
        ({MU: (0.5, np.nan)}, "the latter above 0"),
        ({MU: (-0.5, 0.1)}, "has the mean -0.5; allowed: above 0"),
    ],
)
def test_refusals(priors, message):
    with pytest.raises(InputError, match=message):
        fit(floor(), recorded(floor()), MU, priors=priors)


def test_no_number_has_two_priors():
    priors = {BIAS: (0.0, 1.0), f"{BIAS}[1]": (0.0, 2.0)}
    with pytest.raises(InputError, match=r"names sensor.force_bias\[1\] twice"):
        fit(floor(), recorded(floor()), BIAS, priors=priors)
