"""Places around the end of a search: as far off as they are said to be, each the best of its shell."""

import jax.numpy as jnp
import numpy as np
import pytest

from fitting_cases import BOTH, floor, problem_for, recorded
from hapjax_fitting.around import lowest_around
from hapjax_fitting.problem import loss_at
from hapjax_fitting.reduced import reduced
from hapjax_fitting.solve import Solutions


@pytest.mark.slow
def test_places_are_so_many_standard_errors_off_and_never_absurdly_far():
    problem = problem_for(floor(), [recorded(floor(), steps=100)], BOTH)
    free = problem.start()
    ends = Solutions(
        free[None],
        loss_at(free, problem)[None],
        jnp.ones(1, bool),
        jnp.ones(1, int),
        reduced(free, problem)[0],
    )
    places, losses = lowest_around(ends, problem, 4.0, 3, seed=0)
    assert places.shape == (3, 2) and (np.diff(losses) > 0).all()
    np.testing.assert_allclose(losses, [float(loss_at(place, problem)) for place in places])
    moved = np.linalg.norm(np.asarray(ends.jacobian) @ (np.asarray(places) - np.asarray(free)).T, axis=0)
    np.testing.assert_allclose(moved[:2], 2 * np.array([3.0, np.sqrt(3000)]), rtol=1e-6)
    assert np.abs(np.asarray(places) - np.asarray(free)).max() == pytest.approx(
        np.log(2)
    )  # 1000 standard errors are farther


def test_of_each_shell_the_best_place_is_given():
    problem = problem_for(floor(), [recorded(floor(), steps=100)], BOTH)
    free = problem.start()
    ends = Solutions(
        free[None] + 0.01, jnp.zeros(1), jnp.ones(1, bool), jnp.ones(1, int), reduced(free, problem)[0]
    )
    found = [float(lowest_around(ends, problem, 1.0, 1, seed)[1][0]) for seed in range(3)]
    at_end = float(loss_at(ends.free[0], problem))
    assert max(found) < at_end  # downhill, which half of all ways are
