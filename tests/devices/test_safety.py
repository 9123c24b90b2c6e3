"""No force that goes to a device is ever NaN, infinite or over the limit."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from hapjax_devices import ForceGuard


@given(arrays(np.float64, (3, 3), elements=st.floats(allow_nan=True, allow_infinity=True)))
def test_whatever_comes_in_finite_and_limited_goes_out(forces):
    limits = np.array([8.5, 1.0, 1e-3])
    out = ForceGuard(limits)(forces)
    assert np.all(np.isfinite(out))
    assert np.all(np.linalg.norm(out, axis=1) <= limits)


@given(arrays(np.float32, (2, 3), elements=st.floats(width=32, allow_nan=True, allow_infinity=True)))
def test_the_same_in_float32(forces):
    out = ForceGuard(np.array([8.5, 2.0]))(forces)
    assert np.all(np.isfinite(out)) and np.all(np.linalg.norm(out, axis=1) <= [8.5, 2.0])


def test_a_force_within_the_limit_passes_untouched():
    forces = np.array([[1.0, 2.0, 2.0], [0.0, 0.0, 0.0]])
    guard = ForceGuard(np.array([3.0, 3.0]))
    np.testing.assert_array_equal(guard(forces), forces)
    assert guard.limited == 0 and guard.not_finite == 0


def test_over_the_limit_the_direction_stays_and_the_norm_counts():
    guard = ForceGuard(np.array([5.0, 5.0]))
    # No axis of the second is over 5 N, but its norm is.
    out = guard(np.array([[30.0, 40.0, 0.0], [4.0, 4.0, 4.0]]))
    np.testing.assert_allclose(out, [[3.0, 4.0, 0.0], [5 / 3**0.5] * 3], rtol=1e-12)
    assert guard.limited == 2


def test_a_force_that_is_not_finite_becomes_none_and_is_counted():
    guard = ForceGuard(np.array([8.5, 8.5, 8.5]))
    for _ in range(2):
        out = guard(np.array([[1.0, np.nan, 2.0], [0.0, 0.0, np.inf], [1.0, 1.0, 1.0]]))
    np.testing.assert_array_equal(out, [[0, 0, 0], [0, 0, 0], [1, 1, 1]])
    assert guard.not_finite == 4 and guard.limited == 0
