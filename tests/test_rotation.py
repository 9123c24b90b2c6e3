"""Rotations and safe divisions against SciPy and by hand, with their derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hapjax import rotation, safe


def test_matrices_and_products_are_those_of_scipy(dtype):
    draw = np.random.default_rng(5)
    p, q = (Rotation.from_quat(draw.normal(size=4)) for _ in range(2))
    first, second = (jnp.asarray(r.as_quat(scalar_first=True), dtype) for r in (p, q))
    near = {"rtol": 0, "atol": 20 * jnp.finfo(dtype).eps}
    np.testing.assert_allclose(rotation.to_matrix(first), p.as_matrix(), **near)
    both = np.asarray(rotation.product(first, second))
    expected = (p * q).as_quat(scalar_first=True)
    np.testing.assert_allclose(both * np.sign(both[0] * expected[0]), expected, **near)
    arms, forces = draw.normal(size=(2, 4, 3))
    a, b = jnp.asarray(arms[0], dtype), jnp.asarray(forces[0], dtype)
    for found in (rotation.cross(a, b), rotation.turn(rotation.cross_matrix(a), b)):
        np.testing.assert_allclose(found, np.cross(arms[0], forces[0]), **near)
    dyads = jnp.asarray(arms.T @ forces, dtype)
    np.testing.assert_allclose(rotation.cross_of_dyads(dyads), np.cross(arms, forces).sum(axis=0), **near)
    assert rotation.to_matrix(first).dtype == rotation.cross_matrix(a).dtype == both.dtype == dtype


@pytest.mark.slow
def test_lengths_and_quotients_have_all_derivatives():
    x = jnp.array([3.0, 4.0, 12.0])
    unit = np.asarray(x) / 13
    np.testing.assert_allclose(jax.grad(safe.norm)(x), unit, rtol=1e-14)
    np.testing.assert_allclose(jax.hessian(safe.norm)(x), (np.eye(3) - np.outer(unit, unit)) / 13, atol=1e-15)
    first = jax.grad(safe.divide, (0, 1))
    three, four = jnp.array([3.0, 4.0])
    assert first(three, four) == pytest.approx((0.25, -3 / 16))
    assert jax.grad(lambda y: first(three, y)[1])(four) == pytest.approx(6 / 64)


def test_lengths_and_quotients_are_0_where_they_have_no_value():
    nothing, two, zero = jnp.zeros(3), jnp.array(2.0), jnp.array(0.0)
    assert safe.norm(nothing) == 0 == safe.divide(two, zero)
    for found in (jax.grad(safe.norm)(nothing), jax.grad(safe.divide, (0, 1))(two, zero)):
        assert not np.any(np.asarray(found))
    assert np.all(np.isfinite(jax.hessian(safe.norm)(nothing)))
