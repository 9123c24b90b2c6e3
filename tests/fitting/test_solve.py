"""When a search for least squares ends."""

import jax.numpy as jnp
import numpy as np

from hapjax_fitting.solve import Solutions, solve
from hapjax_fitting.uncertainty import certainty

NOISE = np.random.default_rng(0).standard_normal(200)


def bent(free, bend):
    """Noise that nothing explains, and numbers whose loss is least at a bend, which a linear model looks beyond."""
    return jnp.concatenate([jnp.asarray(NOISE), bend * jnp.array([1.0, 2.0]) + jnp.abs(free)])


def ends_of(bend: float):
    start = jnp.array([[0.8, -0.5]])
    return solve(bent, start, jnp.arange(1), jnp.asarray(bend), 1e-8, 1e-8, 30)


def test_bends_far_below_the_noise_keep_no_search_going():
    ends, sharp = ends_of(0.01), ends_of(1.0)
    assert ends.converged.all() and int(ends.steps[0]) < 15 < int(sharp.steps[0])
    assert np.abs(ends.free).max() < 0.05


def test_slopes_that_are_not_finite_claim_no_number():
    jacobian = jnp.array([[1.0, 2.0], [3.0, jnp.nan], [5.0, 6.0]])
    ends = Solutions(jnp.zeros((1, 2)), jnp.ones(1), jnp.ones(1, bool), jnp.ones(1, int), jacobian)
    known = certainty(ends.slopes, np.ones(3), np.full(2, np.inf), np.ones(2, bool))
    assert not known.identified.any() and not known.covariance.any()
