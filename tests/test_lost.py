"""A step that leaves the range of sense: no forces, and the objects stay where they were."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hapjax
from hapjax.integrate import METHODS


def scene(method, stiffness, dtype):
    """A cube in free fall beside a finger that goes into it."""
    cube = hapjax.Object(
        hapjax.Box((0.04,) * 3), hapjax.Surface(stiffness, mu=0.5, damping=0.5), hapjax.Body(0.05)
    )
    world = hapjax.World(gravity=(0, 0, -9.81))
    return hapjax.cast(hapjax.Scene(object={"cube": cube}, world=world, integrator=METHODS[method]()), dtype)


def finite(tree):
    return all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(tree))


@pytest.mark.parametrize("method", METHODS)
def test_a_lost_step_puts_out_no_force_and_keeps_the_objects(method, dtype):
    hip = jnp.array([[0.019, 0.0, 0.0]], dtype)
    start = hapjax.init(scene(method, 800.0, dtype), hip)
    felt, reply = hapjax.step(scene(method, 800.0, dtype), start, hip)
    assert not reply.lost and np.linalg.norm(reply.force) > 0.1
    after, reply = hapjax.step(scene(method, 800.0, dtype), felt, hip.at[0, 1].set(1e30))
    assert reply.lost and not np.any(reply.force) and finite((after, reply))
    np.testing.assert_array_equal(after.motion["cube"].position, felt.motion["cube"].position)
    assert not np.any(after.motion["cube"].velocity)
    np.testing.assert_array_equal(reply.pose[0, :3], felt.motion["cube"].position)
    _, reply = hapjax.step(scene(method, 800.0, dtype), after, hip)
    assert not reply.lost


@pytest.mark.parametrize("wrong", [np.nan, np.inf, 1e300])
def test_no_number_of_a_hip_makes_a_force_that_is_not_finite(wrong):
    made = scene("semi_implicit", 800.0, "float64")
    hip = jnp.array([[0.019, 0.0, 0.0]])
    state, _ = hapjax.step(made, hapjax.init(made, hip), hip)
    after, reply = hapjax.step(made, state, hip.at[0, 1].set(wrong))
    assert reply.lost and not np.any(reply.force) and finite((after, reply))


@pytest.mark.parametrize("method", ["semi_implicit", "implicit"])
def test_the_derivatives_through_a_lost_step_are_finite(method, dtype):
    wrong = 1e200 if dtype == "float64" else 1e38
    hips = jnp.zeros((6, 1, 3), dtype).at[:, 0, 0].set(0.019).at[3, 0, 1].set(wrong)

    def end(made, hips):
        state, replies = hapjax.rollout(made, hapjax.init(made, hips[0]), hips)
        return jnp.sum(replies.force) + jnp.sum(state.motion["cube"].position), replies.lost

    made = scene(method, 800.0, dtype)
    slopes, lost = jax.jit(jax.grad(end, (0, 1), has_aux=True, allow_int=True))(made, hips)
    assert lost.tolist() == [False] * 3 + [True] + [False] * 2
    assert finite([x for x in jax.tree.leaves(slopes) if x.dtype == dtype])
    assert np.any(slopes[0].object["cube"].surface.stiffness)


def test_the_packed_step_says_that_it_was_lost():
    hip = np.array([[0.019, 0.0, 0.0]])
    fine, mad = (hapjax.pack(scene("semi_implicit", k, "float64"), hip) for k in (800.0, 1e16))
    assert not fine.is_lost(fine.call(fine.start, hip))
    assert mad.is_lost(mad.call(mad.start, hip))


def test_substeps_that_were_lost_make_a_lost_step():
    cube = hapjax.Object(hapjax.Box((0.04,) * 3), hapjax.Surface(1e16, mu=0.5), hapjax.Body(0.05))
    made = hapjax.Scene(object={"cube": cube}, integrator=hapjax.SemiImplicit(substeps=2))
    outside, inside = jnp.array([[0.03, 0.0, 0.0]]), jnp.array([[0.01, 0.0, 0.0]])
    state = hapjax.init(made, outside)
    assert not hapjax.step(made, state, outside)[1].lost
    _, reply = hapjax.step(made, state, inside)
    assert reply.lost and not np.any(reply.force)


def test_a_step_is_lost_if_its_first_substep_was():
    made = scene("semi_implicit", 800.0, "float64")
    made = hapjax.Scene(object=made.object, integrator=hapjax.SemiImplicit(substeps=2))
    state = hapjax.init(made, jnp.array([[1e13, 0.0, 0.0]]))
    state, reply = hapjax.step(made, state, jnp.array([[0.019, 0.0, 0.0]]))
    assert reply.lost and not np.any(reply.force)
    _, reply = hapjax.step(made, state, jnp.array([[0.019, 0.0, 0.0]]))
    assert not reply.lost and np.any(reply.force)  # one mad sample does not spoil those after it
