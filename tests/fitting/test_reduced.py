"""The Jacobian and the residuals in few rows: what least squares needs of them is the same."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fitting_cases import MU, STIFFNESS, floor, held_cube, problem_for, products, recorded, shaken_cube
from hapjax_fitting.problem import channels_of, residuals_at, stacked_residuals
from hapjax_fitting.reduced import reduced
from hapjax_fitting.solve import jacobian


@pytest.mark.slow
def test_inner_products_are_those_of_all_rows():
    """Of recordings of two lengths, each with a mu of its own, with a prior, and a loss other than squares."""
    recordings = [recorded(floor(0.9), i, steps=steps) for i, steps in enumerate((60, 60, 45))]
    problem = problem_for(floor(), recordings, [MU, STIFFNESS], (MU,), {STIFFNESS: (700.0, 0.1)}, "huber")
    free = problem.start() + 0.1
    whole = jax.jit(lambda x, p: jacobian(stacked_residuals, x, p))(free, problem)
    few = jax.jit(reduced)(free, problem)
    assert len(few[1]) == 5 + 1 < len(whole[1])
    np.testing.assert_allclose(products(*few), products(*whole), rtol=1e-10, atol=1e-8)


@pytest.mark.slow
def test_channels_keep_their_rows():
    problem = problem_for(held_cube(), [shaken_cube(steps=60)], ["object.cube.body.mass"])
    free = problem.start() + 0.1
    channels = dict(channels_of(residuals_at(free, problem), problem))
    matrix, found = jax.jit(reduced)(free, problem)
    for i, (key, r) in enumerate(channels.items()):
        assert jnp.linalg.norm(found[2 * i : 2 * i + 2]) == pytest.approx(float(np.linalg.norm(r))), key
    assert list(channels) == ["force", "position", "angle"] and len(matrix) == 6
