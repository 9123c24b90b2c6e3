"""The friction cone's law by itself."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hapjax import friction


def cone(offset, stiffness=500.0, viscous=None, limit=0.3, kinetic=None, sliding=None, dtype=np.float64):
    given = dict(offset=offset, stiffness=stiffness, viscous=viscous, static=limit)
    given |= dict(kinetic=kinetic, sliding=sliding, rounding=1e-15)
    return _cone(**{k: None if v is None else jnp.asarray(v, dtype) for k, v in given.items()})


@jax.jit
def _cone(offset, stiffness, viscous, static, kinetic, sliding, rounding):
    """Under a normal force of 1 N, so that mu and the limit are one number."""
    one = jnp.ones_like(stiffness)
    directed = None if kinetic is None else lambda pull: kinetic
    if kinetic is not None and sliding is None:
        sliding = 0 * one
    press = friction.Press(
        offset, stiffness, one, viscous, None, sliding, rounding, None, lambda pull: static, directed
    )
    return friction.Cone().hold(press)


def test_within_the_circle_the_offset_stays(dtype):
    law = cone([3e-4, -4e-4, 0.0], limit=0.2501, dtype=dtype)
    assert law.sliding is None
    assert np.array_equal(law.offset, np.asarray([3e-4, -4e-4, 0], dtype))
    assert law.force == pytest.approx(np.array([0.15, -0.2, 0]), rel=1e-6)
    assert law.force.dtype == law.offset.dtype == dtype


def test_beyond_it_the_offset_goes_to_the_edge(dtype):
    law = cone([3e-4, -4e-4, 0.0], limit=0.1, dtype=dtype)
    assert law.force == pytest.approx(np.array([0.06, -0.08, 0]), rel=1e-6)
    assert law.offset == pytest.approx(np.array([1.2e-4, -1.6e-4, 0]), rel=1e-6)


def test_the_viscous_share_counts_towards_the_limit():
    inside = cone([3e-4, 0, 0.0], viscous=[0, 0.1, 0.0], limit=0.2)
    assert inside.force == pytest.approx(np.array([0.15, 0.1, 0])) and inside.offset[1] == 0
    outside = cone([3e-4, 0, 0.0], viscous=[0, 0.2, 0.0], limit=0.1)
    assert outside.force == pytest.approx(np.array([0.06, 0.08, 0]))
    assert outside.offset == pytest.approx(
        np.array([2e-4, 0, 0])
    )  # of the spring's own part, 0.15 N, up to 0.1 N


@pytest.mark.parametrize(
    ("offset", "sliding", "force"),
    [(5.9e-4, 0, 0.295), (6.1e-4, 0, 0.2), (5.9e-4, 1, 0.2), (3.9e-4, 1, 0.195), (3.9e-4, 0, 0.195)],
)
def test_static_holds_until_passed_then_kinetic(offset, sliding, force):
    law = cone([offset, 0, 0.0], limit=0.3, kinetic=0.2, sliding=sliding)
    assert law.force[0] == pytest.approx(force, rel=1e-12)
    assert bool(law.sliding) == (force == 0.2)


def test_force_never_passes_the_limit():
    rng = np.random.default_rng(0)
    offsets, pulls = rng.standard_normal((2, 2000, 3)) * [[[1e-3]], [[0.5]]]
    limits = rng.uniform(0, 1, 2000)
    force = jax.vmap(lambda o, v, m: cone(o, viscous=v, limit=m).force)(
        *map(jnp.asarray, (offsets, pulls, limits))
    )
    assert np.all(np.linalg.norm(force, axis=1) <= limits * (1 + 4e-16))


def _force(offset, viscous, limit, kinetic):
    return cone(
        offset, viscous=viscous, limit=limit, kinetic=kinetic, sliding=None if kinetic is None else 1.0
    ).force


_gradients = [jax.jit(jacobian(_force, (0, 1, 2))) for jacobian in (jax.jacfwd, jax.jacrev)]


@pytest.mark.parametrize("offset", [0.0, 2e-4, 6e-4])
@pytest.mark.parametrize("limit", [0.0, 0.3])
@pytest.mark.parametrize("kinetic", [None, 0.0, 0.2])
def test_gradients_are_finite_everywhere(offset, limit, kinetic):
    at = (jnp.array([offset, 0.0, 0.0]), jnp.zeros(3), jnp.asarray(limit))  # 6e-4: on the cone's very edge
    forward, reverse = (gradient(*at, kinetic) for gradient in _gradients)
    for a, b in zip(forward, reverse, strict=True):
        assert np.all(np.isfinite(a)) and np.all(np.isfinite(b))
        assert a == pytest.approx(np.asarray(b), rel=1e-12, abs=1e-12)
