"""When a search for least squares ends."""

import jax.numpy as jnp
import numpy as np

from hapjax_fitting.solve import solve

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
