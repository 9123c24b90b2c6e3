"""The rollout that remembers little: equal in value and gradient, and sparing of memory."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hapjax
from hapjax import Body, Box, Object, Scene, SemiImplicit, Sphere, Surface, World
from hapjax.integrate import Implicit
from helpers import order


def ball(integrator) -> Scene:
    thing = Object(Sphere(0.03), Surface(300.0, mu=0.1, damping=1.0), Body(0.2))
    return Scene({"ball": thing}, world=World(gravity=(0.0, 0.0, -9.81)), integrator=integrator)


def pinch(steps: int):
    """Two fingers on a ball, which is dragged sideways."""
    sides = jnp.array([[-0.025, 0.0, -0.01], [0.025, 0.002, -0.01]])
    return sides[None] + 1e-4 * jnp.arange(float(steps))[:, None, None] * jnp.array([[[0.0, 1.0, 0.0]]])


def loss(scene, hips, checkpoint, everything=True):
    end, reply = hapjax.rollout(scene, hapjax.init(scene, hips[0]), hips, checkpoint=checkpoint)
    place = jnp.sum(end.motion["ball"].position ** 2)
    return place + jnp.sum(reply.force**2) if everything else place


@pytest.mark.parametrize("steps", [1, 7, 12])
def test_values_are_the_same_for_any_number_of_steps(steps):
    scene, hips = ball(SemiImplicit()), pinch(steps)
    plain, spared = (
        hapjax.rollout(scene, hapjax.init(scene, hips[0]), hips, checkpoint=c) for c in (False, True)
    )
    for a, b in zip(jax.tree.leaves(plain), jax.tree.leaves(spared), strict=True):
        assert a.shape == b.shape and a.dtype == b.dtype
        np.testing.assert_allclose(a, b, rtol=1e-13, atol=1e-15)
    assert np.any(np.asarray(plain[1].force) != 0)


@pytest.mark.parametrize("integrator", [SemiImplicit(), pytest.param(Implicit(), marks=pytest.mark.slow)])
def test_gradients_are_the_same_for_a_prime_number_of_steps(integrator):
    scene, hips = ball(integrator), pinch(11)
    plain, spared = (jax.jit(jax.grad(lambda s, c=c: loss(s, hips, c)))(scene) for c in (False, True))
    for a, b in zip(jax.tree.leaves(plain), jax.tree.leaves(spared), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12)
    assert float(plain.object["ball"].surface.mu) != 0 and float(plain.object["ball"].body.mass) != 0


@pytest.mark.slow
def test_memory_grows_as_the_square_root_of_the_steps():
    counts = np.array([100, 400, 1600])

    def temporary(steps, checkpoint):
        hips = jax.ShapeDtypeStruct((steps, 2, 3), float)
        slope = jax.jit(jax.grad(lambda s, h: loss(s, h, checkpoint, everything=False)))
        analysis = slope.lower(ball(SemiImplicit()), hips).compile().memory_analysis()
        assert analysis is not None
        return analysis.temp_size_in_bytes

    assert order(counts, [temporary(n, True) for n in counts]) <= 0.6
    assert temporary(400, False) > 3 * temporary(400, True)


def test_a_gradient_remembers_which_face_holds_and_does_not_find_it_again():
    thing = Object(Box((0.04,) * 3), Surface(300.0, mu=0.1, damping=1.0), Body(0.2))

    def place(scene, hips):
        end, _ = hapjax.rollout(scene, hapjax.init(scene, hips[0]), hips)
        return jnp.sum(end.motion["box"].position ** 2)

    # In the loop of the steps, and not in that of their derivatives.
    assert str(jax.make_jaxpr(jax.grad(place))(Scene({"box": thing}), pinch(3))).count("argmax[") == 1
