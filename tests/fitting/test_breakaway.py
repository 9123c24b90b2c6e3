"""The static mu: a search that no jump stops, and a likelihood that is a staircase."""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from hapjax_fitting import fit
from hapjax_fitting.benchmark import efficiency
from hapjax_fitting.benchmark.cases import CASES
from hapjax_fitting.breakaway import Posterior, _losses
from hapjax_fitting.parameters import free_parameters, values_of, with_values
from hapjax_fitting.problem import loss_at

CASE = CASES["static, kinetic, viscous"]
# Recordings in whose search a jump is in the way: the better mu_static is so only together with other numbers (689), or
# the numbers so far lie at a jump (852).
HINDERED = (689, 852)


def test_a_staircase_of_likelihood():
    flat = Posterior(np.array([0.0, 1.0, 2.0]), np.array([0.5, 0.5]))
    assert flat.mean() == 1 and flat.deviation() == pytest.approx(2 / np.sqrt(12))
    np.testing.assert_allclose(flat.central(0.95), [0.05, 1.95])
    np.testing.assert_allclose(replace(flat, cut=True).central(0.95), [0, 1.9])
    steep = Posterior(np.array([0.0, 1.0, 3.0]), np.array([0.1, 0.9]))
    np.testing.assert_allclose(steep.central(0.5), [1 + 2 * 0.15 / 0.9, 1 + 2 * 0.65 / 0.9])


def fitted(seed: int) -> tuple[Any, float]:
    """A fit of one of the benchmark's recordings, and the loss at the truth."""
    truth, recording = CASE.truth(), CASE.recorded(seed)
    parameters = free_parameters(truth, CASE.free)
    values = values_of(truth, parameters)
    off = 1 + 0.03 * np.random.default_rng(seed).uniform(-1, 1, 3)
    start = with_values(truth, parameters, values * jnp.asarray(off))
    result = fit(start, recording, CASE.free, noise=CASE.noise, starts=1)
    there = jnp.stack([p.transform.free(v) for p, v in zip(parameters, values, strict=True)])
    return result, float(loss_at(there, result.problem))


def by_quadrature(result: Any) -> Posterior:
    """The likelihood of mu_static with the other numbers on a grid of 4 standard deviations, instead of drawn."""
    root = np.linalg.cholesky(result.covariance[1:, 1:])
    grid = np.stack(np.meshgrid(*[np.linspace(-4, 4, 11)] * 2), axis=-1).reshape(-1, 2)
    others = result.free + np.concatenate([np.zeros((len(grid), 1)), grid @ root.T], axis=1)
    low, high = result.parameters[CASE.free[0]].interval99
    edges = np.linspace(low - 0.2 * (high - low), high + 0.2 * (high - low), 25)
    middles = (edges[1:] + edges[:-1]) / 2
    losses = _losses(np.tile(others, (24, 1)), result.problem, 0, np.repeat(middles, len(grid)))
    weight = np.exp(result.loss - losses.reshape(24, -1)).sum(axis=1)
    return Posterior(edges, weight / weight.sum())


@pytest.mark.slow
def test_static_mu_is_as_near_as_can_be_and_its_intervals_hold_it():
    draws, allowed = 8, 3 / np.sqrt(2 * 8)  # 3 standard deviations of what chance makes of so few
    row, _ = efficiency.measure("static, kinetic, viscous", draws)
    assert [p["identified"] for p in row["parameters"]] == [draws] * 3
    assert all(abs(p["ratio"] - 1) < 0.05 + allowed for p in row["parameters"])
    assert min(p["cover"] for p in row["parameters"]) > 0.93 - 3 * np.sqrt(0.95 * 0.05 / draws)
    fits = [fitted(seed) for seed in HINDERED]
    for result, at_truth in fits:
        assert result.loss <= at_truth and result.converged
    # The errors of the other numbers move the jumps of this recording by as much as these lie apart.
    result, _ = fits[0]
    found, other = result.parameters[CASE.free[0]], by_quadrature(result)
    width = float(np.diff(other.central(0.95))[0])
    np.testing.assert_allclose(found.interval95, other.central(0.95), atol=0.1 * width)
    assert found.estimate == pytest.approx(other.mean(), abs=0.03 * width)
