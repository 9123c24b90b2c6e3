"""Points dragged over a plane under known loads."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hapjax

LOADS = np.array([2.0, 0.0, 5.0])


@jax.jit
def forces(points, loads, stiffness, mu, kinetic=None):
    friction = {"mu": mu} if kinetic is None else {"mu_static": mu, "mu_kinetic": kinetic}
    return hapjax.drag(hapjax.Surface(stiffness, **friction), points, loads)


def path(dtype, steps=400):
    """Three points on random paths that turn, stop and slide: (steps, 3, 3) m."""
    steps_taken = np.random.default_rng(0).standard_normal((steps, 3, 3)) * 2e-4
    steps_taken[100:140] = 0
    return np.cumsum(steps_taken, axis=0).astype(dtype)


def circle_rule(points, loads, stiffness, mu):
    """MHS's friction circle, one point and one step at a time."""
    force = np.zeros_like(points)
    for v, load in enumerate(loads):
        god = points[0, v, :2]
        for t, here in enumerate(points[:, v, :2]):
            away, radius = god - here, mu * load / stiffness
            if np.hypot(*away) > radius:
                god = here + radius * away / np.hypot(*away)
            force[t, v, :2] = stiffness * (god - here)
    return force


def test_obeys_the_friction_circle_on_any_path(dtype):
    given = [np.asarray(x, dtype) for x in (path(dtype), LOADS, 2e3, 0.3)]
    force = np.asarray(forces(*map(jnp.asarray, given)))
    expected = circle_rule(*(x.astype(float) for x in given))
    size = np.linalg.norm(expected, axis=-1)
    assert np.any(size[:, 0] < 0.59) and np.any(size[:, 0] > 0.5999)  # it sticks and it slides
    assert force.dtype == dtype
    assert force == pytest.approx(expected, abs=1e-9 if dtype == np.float64 else 2e-3)
    assert np.all(np.linalg.norm(force, axis=-1) <= 0.3 * LOADS * (1 + 4 * np.finfo(dtype).eps))


def test_a_long_slide_is_opposed_by_mu_times_the_load():
    points = np.linspace(0, 0.1, 50)[:, None, None] * np.array([[0.6, 0.8, 0.0]] * 3)
    force = forces(*map(jnp.asarray, (points, LOADS, 1e5, 0.3)))
    assert force[-1] == pytest.approx(-0.3 * LOADS[:, None] * np.array([0.6, 0.8, 0]), rel=1e-12)
    assert np.all(np.asarray(force[0]) == 0)


def test_breaks_away_at_the_static_and_slides_at_the_kinetic_limit():
    points = np.linspace(0, 1e-2, 1001)[:, None, None] * np.array([[1.0, 0, 0]])
    force = -np.asarray(forces(*map(jnp.asarray, (points, [5.0], 1e3, 0.5, 0.3))))[:, 0, 0]
    assert force.max() == pytest.approx(2.5, abs=0.01)  # one step of 10 um is 0.01 N
    assert force[-1] == pytest.approx(1.5, rel=1e-12)


@pytest.mark.slow
def test_gradients_are_finite_and_agree():
    def total(mu, stiffness):
        return jnp.sum(forces(jnp.asarray(path(np.float64, 60)), jnp.asarray(LOADS), stiffness, mu) ** 2)

    at = (jnp.asarray(0.3), jnp.asarray(2e3))
    forward, reverse = jax.jacfwd(total, (0, 1))(*at), jax.jacrev(total, (0, 1))(*at)
    for i, step in enumerate((1e-7, 1e-3)):
        up, down = (total(*(x + sign * step * (i == j) for j, x in enumerate(at))) for sign in (1, -1))
        assert forward[i] == pytest.approx(float(up - down) / (2 * step), rel=1e-6)
        assert forward[i] == pytest.approx(float(reverse[i]), rel=1e-12)


@pytest.mark.parametrize(
    ("extra", "says"),
    [
        ({"mu": 0.3, "damping": 1.0}, "dt is missing"),
        ({"mu": [0.3, 0.4]}, "one for each of the faces plane"),
    ],
)
def test_refuses_what_it_could_not_honour(extra, says):
    with pytest.raises(hapjax.InputError, match=says):
        hapjax.drag(hapjax.Surface(1e3, **extra), jnp.zeros((2, 1, 3)), jnp.ones(1))
