"""A mu for each finger: factors on that of the surface."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hapjax
from hapjax.benchmark import stability_press, stability_scene
from hapjax.integrate import METHODS

FACTORS = np.array([1.0, 0.5])
TWO = dict(mu_static=0.6, mu_kinetic=0.4)
SPEED = 0.02  # m/s
KINDS = {  # numbers of a surface, the mu of sliding, and what is added to it
    "cone": (TWO, 0.4, 0),
    "faces": (dict(mu=(0.9, 0.9, 0.9, 0.9, 0.4, 0.9)), 0.4, 0),
    "across the grain": (dict(mu=0.8, anisotropy=0.5, grain=(0.0, 1.0, 0.0)), 0.4, 0),
    "lugre": (TWO | dict(friction=hapjax.LuGre(0.02, 0.5, 0.002)), 0.4, 0.5 * SPEED),
}


def ratios(replies, name):
    """Tangential over normal force of each finger, over time."""
    touch = replies.touch[name]
    return np.linalg.norm(touch.friction_force, axis=-1) / np.maximum(touch.normal_force, 1e-9)


@pytest.mark.parametrize("kind", KINDS)
def test_each_finger_slides_at_its_own_cone(kind, dtype):
    numbers, mu, more = KINDS[kind]
    surface = hapjax.Surface(2000.0, finger_mu=FACTORS, **numbers)
    block = hapjax.Object(hapjax.Box((0.2, 0.2, 0.1)), surface, position=(0, 0, -0.05))
    scene = hapjax.cast(hapjax.Scene(object={"it": block}), dtype)
    x = SPEED * 1e-3 * np.arange(200)
    hips = np.stack([np.stack([x, 0 * x + y, 0 * x - 1e-3], -1) for y in (0, 0.05)], axis=1)
    hips[0, :, 2] = 1e-3
    found = ratios(hapjax.rollout(scene, hapjax.init(scene, hips[0]), jnp.asarray(hips, dtype))[1], "it")
    np.testing.assert_allclose(found[-1], mu * FACTORS + more, rtol=1e-3)
    if kind == "cone":  # neither broke away before its own static limit
        assert np.all(found.max(axis=0) > 0.9 * 0.6 * FACTORS)
        assert np.all(found.max(axis=0) <= (1 + 1e-5) * 0.6 * FACTORS)


@pytest.mark.parametrize("method", ["semi_implicit", "implicit"])
def test_what_is_held_slips_from_the_finger_with_the_smaller_mu(method):
    """A heavy block that stands still between two fingers, which both slide up its sides."""
    surface = hapjax.Surface(800.0, mu=0.5, damping=0.5, finger_mu=FACTORS)
    block = hapjax.Object(hapjax.Box((0.06,) * 3), surface, hapjax.Body(1e4, inertia=(1e2,) * 3))
    scene = hapjax.Scene(object={"it": block}, integrator=METHODS[method]())
    z = 0.1 * 1e-3 * np.arange(60)
    hips = np.stack([np.stack([side * 0.028 + 0 * z, 0 * z, z], -1) for side in (1, -1)], axis=1)
    _, replies = hapjax.rollout(scene, hapjax.init(scene, hips[0]), hips)
    np.testing.assert_allclose(ratios(replies, "it")[-1], 0.5 * FACTORS, rtol=1e-4)
    np.testing.assert_allclose(replies.force[-1, :, 2], -1.6 * 0.5 * FACTORS, rtol=1e-4)


def test_derivatives_of_what_slides_agree():
    """Forward, reverse, and the law itself: each finger's friction is in proportion to its own factor."""
    surface = hapjax.Surface(800.0, mu=0.5, finger_mu=FACTORS)
    scene = hapjax.Scene({"it": hapjax.Object(hapjax.Plane(), surface)})
    hips = jnp.asarray(np.linspace([[0, 0, 1e-3]] * 2, [[0.01, 0, -2e-3]] * 2, 30))

    def dragged(factors):
        changed = eqx.tree_at(lambda s: s.object["it"].surface.finger_mu, scene, factors)
        return hapjax.rollout(changed, hapjax.init(changed, hips[0]), hips)[1].force[-1, :, 0]

    expected = -np.diag(np.full(2, 0.5 * 800 * 2e-3))
    for jacobian in (jax.jacfwd, jax.jacrev):
        np.testing.assert_allclose(jax.jit(jacobian(dragged))(surface.finger_mu), expected, atol=1e-12)


@pytest.mark.slow
def test_the_benchmark_of_stability_presses_as_the_finger_with_the_smallest_mu():
    def places(**law):
        box = hapjax.Object(hapjax.Box((0.06,) * 3), hapjax.Surface(8000.0, **law), hapjax.Body(2.0))
        scene = stability_scene.felt_alike(hapjax.Scene({"it": box}, world=hapjax.World((0, 0, -9.81))))
        return stability_press.fingers(scene)[1]

    expected = places(mu=0.4)
    np.testing.assert_allclose(places(mu=0.8, finger_mu=FACTORS), expected)
    np.testing.assert_allclose(places(mu_static=0.6, mu_kinetic=0.4), expected)
    assert np.all(np.abs(places(mu=0.8) - expected).max(axis=1) > 5e-4)


def test_refusals():
    def surface(factors: Any):
        return hapjax.Surface(800.0, mu=0.5, finger_mu=factors)

    def scene(factors: Any):
        return hapjax.Scene({"it": hapjax.Object(hapjax.Plane(), surface(factors))})

    def pair():
        objects = {"it": hapjax.Object(hapjax.Sphere(0.1), None, hapjax.Body(1.0))}
        objects["floor"] = hapjax.Object(hapjax.Plane())
        contact = hapjax.Contact(800.0, mu=0.5, finger_mu=(1.0, 1.0), between=("it", "floor"))
        return hapjax.Scene(objects, {"pair": contact})

    cases = (
        (lambda: surface(0.5), r"finger_mu has the shape \(\); allowed: a list, 0 or above for each finger"),
        (lambda: surface((-1.0, 1.0)), r"finger_mu is \[-1.0, 1.0\]; allowed: a list, 0 or above"),
        (
            lambda: hapjax.init(scene((1.0, 1.0)), np.zeros((1, 3))),
            "object.it.surface.finger_mu has 2 factors for 1 finger; allowed: one for each",
        ),
        (pair, "contact.pair.finger_mu is given, but no finger touches a contact; allowed: on the surface"),
        (
            lambda: hapjax.drag(surface((1.0,)), jnp.zeros((2, 1, 3)), jnp.ones(1)),
            "finger_mu is given, but no finger drags; allowed: a surface without it",
        ),
    )
    for make, says in cases:
        with pytest.raises(hapjax.InputError, match=says):
            make()
