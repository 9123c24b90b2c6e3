"""Recordings of about the same length are filled up to the longest: nothing but the number of programs changes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fitting_cases import MU, STIFFNESS, floor, problem_for, products, recorded
from hapjax_fitting import lengths
from hapjax_fitting.observation import observation_of
from hapjax_fitting.problem import channels_of, loss_at, residuals_at
from hapjax_fitting.reduced import reduced

SHORT, LONG = 50, 60
RECORDINGS = [recorded(floor(0.9), i, steps=steps, every=3) for i, steps in enumerate((LONG, SHORT, 40))]


def problem(monkeypatch, most):
    monkeypatch.setattr(lengths, "ALIKE", most)
    return problem_for(floor(), RECORDINGS, [MU, STIFFNESS, "sensor.force_delay"], (MU,))


@pytest.mark.slow
def test_the_fit_is_that_of_each_as_long_as_it_is(monkeypatch):
    filled, apart = problem(monkeypatch, 1.25), problem(monkeypatch, 1.0)
    assert [g.count for g in filled.groups] == [2, 1] and [g.count for g in apart.groups] == [1, 1, 1]
    assert filled.measured() == apart.measured() == sum(np.size(np.asarray(r.force)) for r in RECORDINGS)
    free = filled.start().at[-1].set(-0.004)  # later than the end
    assert float(loss_at(free, filled)) == pytest.approx(float(loss_at(free, apart)), rel=1e-12)
    squares = [
        sorted(np.sum(r**2) for _, r in channels_of(residuals_at(free, p), p)) for p in (filled, apart)
    ]
    np.testing.assert_allclose(*squares, rtol=1e-12)
    both = [products(*jax.jit(reduced)(free, p)) for p in (filled, apart)]
    np.testing.assert_allclose(*both, rtol=1e-10, atol=1e-8)


def test_only_what_is_alike_is_put_together():
    laid = [observation_of(floor(), r, ("force",), "r") for r in RECORDINGS]
    filled = lengths.alike(laid)
    assert [len(group) for group in filled] == [2, 1]
    assert filled[1][0] is laid[2]
    short = filled[0][1]
    assert short.steps is not None and short.force is not None
    assert short.hips.shape == laid[0].hips.shape and int(short.steps) == SHORT
    np.testing.assert_array_equal(
        short.hips[SHORT:], np.broadcast_to(short.hips[SHORT - 1], (LONG - SHORT, 1, 3))
    )
    assert lengths.alike(laid[:1])[0][0] is laid[0]
    assert jnp.all(short.force.only(jnp.ones(20))[17:] == 0)
