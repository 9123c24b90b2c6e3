"""Newton-Euler against NumPy's linear algebra."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hapjax
from hapjax import body as rigid
from helpers import matrix, quaternion

TURNED = quaternion((1, 2, -1), 0.8)
FULL = (
    matrix(quaternion((0, 1, 3), 0.4))
    @ np.diag([1.0, 2.0, 2.6])
    @ matrix(quaternion((0, 1, 3), 0.4)).T
    * 1e-4
)


@pytest.mark.parametrize("inertia", [np.array([1.0, 2.0, 2.6]) * 1e-4, FULL], ids=["principal", "matrix"])
@pytest.mark.parametrize("gyroscopic", [True, False])
def test_angular_acceleration_solves_eulers_equation(inertia, gyroscopic, dtype):
    turn, spin, torque = matrix(TURNED), np.array([3.0, -5.0, 8.0]), np.array([0.01, 0.02, -0.005])
    world = turn @ (np.diag(inertia) if inertia.ndim == 1 else inertia) @ turn.T
    expected = np.linalg.solve(world, torque - (np.cross(spin, world @ spin) if gyroscopic else 0))
    given = [jnp.asarray(x, dtype) for x in (inertia, turn, spin, torque)]
    got = jax.jit(rigid.angular_acceleration, static_argnums=4)(*given, gyroscopic)
    assert got.dtype == dtype
    assert got == pytest.approx(expected, rel=100 * float(jnp.finfo(dtype).eps))


def test_a_point_of_the_body_moves_with_it(dtype):
    spin, velocity, arms = [1.0, 2, 3], [0.1, 0.2, 0.3], [[0.01, 0, 0], [0, 0.02, -0.01]]
    motion = rigid.Motion(*(jnp.asarray(x, dtype) for x in ([0.0, 0, 0], TURNED, velocity, spin)))
    got = rigid.velocity_at(motion, jnp.asarray(arms, dtype))
    assert got.dtype == dtype
    assert got == pytest.approx(np.array(velocity) + np.cross(spin, arms), rel=1e-6)
    still = rigid.Motion(motion.position, motion.orientation, motion.velocity, None)
    assert np.array_equal(
        rigid.velocity_at(still, jnp.asarray(arms, dtype)), np.tile(motion.velocity, (2, 1))
    )


def test_centre_of_mass_turns_with_the_body():
    body = hapjax.Body(0.2, inertia=(1e-4,) * 3, centre=(0.01, 0.02, 0.0))
    centre = rigid.centre_of(
        body, hapjax.Box((0.1,) * 3), jnp.array([1.0, 2, 3]), jnp.asarray(matrix(TURNED))
    )
    assert centre == pytest.approx(np.array([1, 2, 3]) + matrix(TURNED) @ [0.01, 0.02, 0])


def test_inertia_is_the_one_given_or_that_of_uniform_density():
    box = hapjax.Box((0.1, 0.2, 0.3))
    assert rigid.inertia_of(hapjax.Body(1.2), box) == pytest.approx(np.array([0.013, 0.01, 0.005]))
    assert rigid.inertia_of(hapjax.Body(1.2, inertia=(1, 1, 1)), box) == pytest.approx(1.0)
