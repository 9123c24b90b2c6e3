"""Derivatives of every friction law: forward, reverse and by differences, and finite where formulas have none."""

import functools
import itertools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import hapjax
from friction_cases import LAWS, as_type, pressed, surface

# These programs run once: compiling them well would take many times as long as running them.
compiled = functools.partial(
    jax.jit, compiler_options={"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0}
)


def agree(function, x, rel):
    """Forward = reverse = differences of a scalar function with respect to numbers near 1; returns them."""
    forward, reverse = compiled(jax.jacfwd(function))(x), compiled(jax.jacrev(function))(x)
    assert np.all(np.isfinite(forward))
    assert forward == pytest.approx(np.asarray(reverse), rel=1e-9, abs=1e-12 * float(jnp.abs(forward).max()))
    steps = 3e-7 * np.eye(len(x))
    run = compiled(jax.vmap(function))
    numerical = np.asarray(run(x[None] + steps) - run(x[None] - steps)) / 6e-7
    assert forward == pytest.approx(numerical, rel=rel, abs=rel * float(jnp.abs(forward).max()))
    return forward


def scaled(tree):
    """The numbers of a tree as multiples of what they are, and the tree from these."""
    numbers, rebuild = ravel_pytree(tree)
    size = jnp.where(numbers == 0, 1.0, jnp.abs(numbers))
    return numbers / size, lambda x: rebuild(x * size)


@pytest.mark.slow
@pytest.mark.parametrize("name", LAWS)
def test_every_number_of_a_law_has_its_gradient(name):
    """A point that sticks, slides, turns and stops, with grain, damping and a tangential stiffness of its own."""
    t = np.linspace(0, 3, 300)
    way = np.stack([2e-3 * np.sin(3 * t), 1e-3 * np.sin(2 * t + 1), 0 * t], -1)[:, None]
    kind = dict(tangential_stiffness=1500.0, damping=0.4, anisotropy=0.7, grain=(1.0, 0.5, 0.2))
    x, rebuild = scaled(surface(name, **kind))
    weights = np.random.default_rng(0).standard_normal((300, 1, 3))

    def total(x):
        force = hapjax.drag(rebuild(x), jnp.asarray(way), jnp.array([1.5]), 0.01)
        return jnp.sum(force * weights)

    gradient = rebuild(agree(total, x, 1e-5))
    # The tangential stiffness is in the other's place; LuGre's bristles have a damping of their own.
    idle = {".stiffness"} | ({".damping"} if name == "lugre" else set())
    assert unread(gradient) == idle | JUMPS.get(name, set())


# What decides only in which step something happens: the force jumps with it and has no slope.
JUMPS = {
    "cone": {".mu_static"},
    "viscous": {".mu_static"},
    "karnopp": {".mu_static", ".friction.velocity_band"},
}


def unread(gradient):
    """The numbers of a surface that nothing depends on."""
    leaves = jax.tree_util.tree_leaves_with_path(gradient)
    return {jax.tree_util.keystr(path) for path, leaf in leaves if not np.any(leaf)}


@pytest.mark.slow
def test_rollouts_have_the_gradients_of_all_laws():
    """A finger on a ball of each law, which slides over it and rises out of it."""
    objects, hips, t = {}, [], np.linspace(0, 1, 200)
    for i, name in enumerate(LAWS):
        where = np.array([0.3 * i, 0, 0])
        objects[name] = hapjax.Object(hapjax.Sphere(0.05), surface(name), None, where)
        angle, height = 0.4 * np.sin(5 * t + i), 0.049 + 2e-3 * t**3
        path = height[:, None] * np.stack([np.sin(angle), 0.3 * t, np.cos(angle)], -1)
        hips.append(where + path / np.linalg.norm(path, axis=1, keepdims=True) * height[:, None])
    scene, hips = hapjax.Scene(object=objects), jnp.asarray(np.stack(hips, axis=1))
    x, rebuild = scaled({name: o.surface for name, o in scene.object.items()})
    weights = np.random.default_rng(0).standard_normal(hips.shape)

    def total(x):
        felt = rebuild(x)
        given = eqx.tree_at(lambda s: [s.object[n].surface for n in felt], scene, list(felt.values()))
        _, reply = hapjax.rollout(given, hapjax.init(given, hips[0]), hips)
        return jnp.sum(reply.force * weights)

    for name, gradient in rebuild(agree(total, x, 1e-5)).items():
        assert unread(gradient) == JUMPS.get(name, set())


SINGULAR = list(itertools.product([0.0, 3e-4], [0.0, 0.05], [0.0, 1.0], [0.0, 0.4], [0.02, 1e-30]))


@functools.cache
def slopes(name, dtype):
    """The force, its derivatives with respect to all that a law is given, forward and reverse."""

    def force(numbers, law):
        offset, velocity, load, mu, stribeck_velocity = numbers
        for where, value in (
            (lambda s: s.mu, mu),
            (lambda s: s.mu_static, mu),
            (lambda s: s.mu_kinetic, 0.5 * mu),
            (lambda s: getattr(s.friction, "stribeck_velocity", None), stribeck_velocity),
        ):
            if where(law) is not None:
                law = eqx.tree_at(where, law, value)
        sliding = jnp.ones_like(mu) if law.remembers() else None
        return pressed(law, offset, velocity, sliding, 0 * mu, jnp.asarray(1e-3, dtype), load)[1]

    run = jax.value_and_grad(force, (0, 1))
    return jax.jit(run), jax.jit(jax.jacfwd(force, (0, 1)))


@pytest.mark.parametrize("name", LAWS)
def test_no_nan_at_singular_points(name, dtype):
    """Offset, slip, normal force and mu at 0, and a tiny Stribeck velocity, in all combinations."""
    law = as_type(surface(name), dtype)
    reverse, forward = slopes(name, dtype)
    for point in SINGULAR:
        numbers = jnp.asarray(point, dtype)
        value, back = reverse(numbers, law)
        ahead = forward(numbers, law)
        for leaf in jax.tree.leaves((value, back, ahead)):
            assert np.all(np.isfinite(leaf)), point
        back, ahead = (ravel_pytree(x)[0] for x in (back, ahead))
        eps = float(np.finfo(dtype).eps)  # slopes are differences of numbers of the size of the stiffness
        assert back == pytest.approx(np.asarray(ahead), rel=100 * eps, abs=4 * 2000 * eps), point
        if point[2] == 0:
            assert abs(float(value)) < 1e-20


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (1.0, 1e-6, 0.0), (0.0, 0.0, 0.0)])
def test_no_nan_where_the_grain_is_all_but_frictionless_across(direction, dtype):
    """An anisotropy whose square is 0 in this precision: mu along the grain, next to nothing across it."""
    tiny = float(np.finfo(dtype).tiny) ** 0.75
    given = [jnp.asarray(x, dtype) for x in (0.4, tiny, (1.0, 0.0, 0.0), direction)]
    value, slopes = along_grain(*given)
    assert given[1] ** 2 == 0 and np.all(np.isfinite(value))
    assert all(np.all(np.isfinite(slope)) for slope in slopes)
    expected = 0.4 if direction[1] == 0 else 0.0
    assert float(value) == pytest.approx(expected, abs=1e-7)


@jax.jit
def along_grain(mu, anisotropy, grain, direction):
    """The mu of a direction on a plane, and its derivatives."""

    def one(mu, anisotropy, grain, direction):
        near = hapjax.Plane().closest(jnp.zeros_like(direction))
        kind = dict(anisotropy=anisotropy, grain=grain)
        return hapjax.Surface(jnp.ones_like(mu), mu, **kind).static_at(near, direction)

    return jax.value_and_grad(one, (0, 1, 2, 3))(mu, anisotropy, grain, direction)
