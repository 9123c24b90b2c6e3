"""Draws from the posterior: the parabola's where the model is linear."""

import sys
from functools import cache
from typing import Any

import jax
import numpy as np
import pytest

from fitting_cases import BOTH, MU, SIGMA, STIFFNESS, floor, recorded
from hapjax import InputError
from hapjax_fitting import fit, posterior
from helpers import followed


@cache
def fitted(length=0.02) -> Any:
    recording = recorded(floor(), steps=100, length=length)
    return fit(floor(0.5, 700.0), recording, BOTH, noise={"force": SIGMA}, starts=2)


@pytest.mark.slow
def test_with_little_noise_the_posterior_is_the_gauss_newton_one(monkeypatch):
    pytest.importorskip("blackjax")
    result = fitted()
    bars = followed(monkeypatch, sys.modules["hapjax_fitting.posterior"])
    found: Any = posterior(result, samples=500, progress=True)
    jax.effects_barrier()
    assert [(bar["total"], bar["told"]) for bar in bars] == [(1600.0, 1600.0), (None, 0.0)]
    for name in BOTH:
        p = result.parameters[name]
        error = p.standard_error / np.sqrt(found.effective[name])
        assert found.draws[name].shape == (2, 500) and found.effective[name] > 200
        assert abs(found.mean[name] - p.estimate) < 4 * error
        assert found.deviation[name] == pytest.approx(p.standard_error, rel=0.12)
        np.testing.assert_allclose(found.interval95[name], p.interval95, atol=0.4 * p.standard_error)
        assert found.rhat[name] < 1.02
    drawn = np.corrcoef(*(np.log(found.draws[name]).ravel() for name in BOTH))
    np.testing.assert_allclose(drawn, result.correlation, atol=0.1)
    assert found.divergent == 0 and not found.section().sentences
    assert "Posterior" in found.section().html() and "<img" in found.section().html()
    assert set(found.to_dict()["parameters"]) == set(BOTH)


@pytest.mark.slow
def test_refusals(monkeypatch):
    with pytest.raises(InputError, match="samples is 10; allowed: a whole number from 50 to 100000"):
        posterior(fitted(), samples=10)
    with pytest.raises(InputError, match=f"{MU} is not .nothing slipped.; allowed: numbers that the data or"):
        posterior(fitted(2e-4))
    monkeypatch.setitem(sys.modules, "blackjax", None)
    with pytest.raises(InputError, match=r"hapjax\[posterior\]"):
        posterior(fitted())
    assert STIFFNESS in fitted().parameters
