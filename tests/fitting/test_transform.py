import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hapjax import InputError
from hapjax_fitting.transform import Identity, Log, Logit

CASES = [
    (Identity(), [-3.0, 0.0, 2.5], lambda v: np.ones_like(v)),
    (Log(), [1e-6, 0.5, 2e4], lambda v: v),
    (Logit(0.1, 0.9), [0.1001, 0.3, 0.8999], lambda v: (v - 0.1) * (0.9 - v) / 0.8),
]


@pytest.mark.parametrize(("transform", "values", "slope"), CASES)
def test_round_trip(transform, values, slope, dtype):
    values = jnp.asarray(values, dtype)
    back = transform.value(transform.free(values))
    assert back.dtype == dtype
    np.testing.assert_allclose(back, values, rtol=30 * float(jnp.finfo(dtype).eps))


@pytest.mark.parametrize(("transform", "values", "slope"), CASES)
def test_slope(transform, values, slope):
    values = np.asarray(values)
    free = transform.free(jnp.asarray(values))
    np.testing.assert_allclose(jax.vmap(jax.grad(transform.value))(free), slope(values), rtol=1e-10)


@pytest.mark.parametrize("free", [-800.0, 800.0])
def test_a_logit_keeps_within_its_bounds(free):
    value, slope = jax.value_and_grad(Logit(0.1, 0.9).value)(jnp.asarray(free))
    assert 0.1 <= value <= 0.9 and np.isfinite(slope)


@pytest.mark.parametrize(
    ("transform", "value"),
    [(Log(), 0.0), (Log(), -1.0), (Log(), np.nan), (Logit(0.0, 1.0), 1.0), (Logit(0.0, 1.0), -0.1)],
)
def test_values_out_of_reach_are_refused(transform, value):
    with pytest.raises(InputError, match="mass starts at"):
        transform.check("mass", value)
