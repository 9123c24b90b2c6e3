"""Closest points and inertia of the shapes, against geometry done another way."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hapjax

SHAPES = {
    "plane": hapjax.Plane(),
    "sphere": hapjax.Sphere(0.04),
    "box": hapjax.Box((0.06, 0.1, 0.08)),
    "cylinder": hapjax.Cylinder(0.03, 0.08),
    "capsule": hapjax.Capsule(0.03, 0.05),
}


def signed_distance(name, x):
    """Distance to the surface, negative inside."""
    if name == "plane":
        return x[..., 2]
    if name == "sphere":
        return np.linalg.norm(x, axis=-1) - 0.04
    if name == "capsule":
        return np.linalg.norm(x - np.clip(x, (0, 0, -0.025), (0, 0, 0.025)), axis=-1) - 0.03
    if name == "cylinder":
        q = np.stack([np.hypot(x[..., 0], x[..., 1]) - 0.03, np.abs(x[..., 2]) - 0.04], axis=-1)
    else:
        q = np.abs(x) - np.array([0.03, 0.05, 0.04])
    return np.linalg.norm(np.maximum(q, 0), axis=-1) + np.minimum(q.max(axis=-1), 0)


@pytest.mark.parametrize("name", SHAPES)
def test_closest_point_is_on_the_surface_and_nearest(name, dtype):
    shape = jax.tree.map(lambda leaf: leaf.astype(dtype), SHAPES[name])
    x = np.random.default_rng(1).uniform(-0.1, 0.1, (4000, 3)).astype(dtype)
    near = jax.tree.map(np.asarray, jax.jit(jax.vmap(shape.closest))(x))
    assert near.point.dtype == near.normal.dtype == near.depth.dtype == dtype
    eps = 4 * float(jnp.finfo(dtype).eps)
    distance = signed_distance(name, x)
    assert np.abs(signed_distance(name, np.asarray(near.point))).max() < eps
    assert np.abs(-near.depth - distance).max() < eps
    assert np.abs(np.linalg.norm(near.normal, axis=1) - 1).max() < eps
    assert np.abs(np.linalg.norm(x - near.point, axis=1) - np.abs(distance)).max() < eps
    outward = np.sum(np.asarray(near.normal) * (np.asarray(near.point) - x), axis=1)
    assert np.abs(outward - near.depth).max() < eps


def test_faces_of_a_box_are_named_in_order():
    box = SHAPES["box"]
    assert box.faces == ("+x", "-x", "+y", "-y", "+z", "-z")
    for face in range(6):
        x = np.zeros(3)
        x[face // 2] = (1 - 2 * (face % 2)) * 0.99 * [0.03, 0.05, 0.04][face // 2]
        for scale in (1, 1.1):  # inside and outside
            near = box.closest(jnp.asarray(x * scale))
            assert near.face == face
            assert near.normal[face // 2] == pytest.approx(1 - 2 * (face % 2))


def _answer(shape, point):
    near = shape.closest(point)
    return jnp.concatenate([near.point, near.normal, near.depth[None]])


_gradients = [jax.jit(jacobian(_answer, (0, 1))) for jacobian in (jax.jacfwd, jax.jacrev)]


@pytest.mark.parametrize(
    ("name", "point"),
    [
        ("sphere", (0, 0, 0)),
        ("sphere", (0.04, 0, 0)),
        ("box", (0, 0, 0)),
        ("box", (0.03, 0, 0)),
        ("box", (0.03, 0.05, 0.04)),
        ("box", (0.01, 0.03, 0.02)),
        ("plane", (0, 0, 0)),
        ("cylinder", (0, 0, 0)),
        ("cylinder", (0, 0, 0.04)),
        ("cylinder", (0.03, 0, 0)),
        ("cylinder", (0, 0.03, 0.04)),
        ("cylinder", (0, 0, 0.06)),
        ("capsule", (0, 0, 0)),
        ("capsule", (0, 0, 0.025)),
        ("capsule", (0, 0, 0.055)),
        ("capsule", (0, 0.03, 0.025)),
    ],
)
def test_singular_points_have_a_unit_normal_and_finite_gradients(name, point):
    shape, point = SHAPES[name], jnp.asarray(point, float)
    near = shape.closest(point)
    on_corner = name in ("box", "cylinder") and abs(float(near.depth)) == 0
    assert np.linalg.norm(near.normal) == pytest.approx(1) or on_corner

    for gradient in _gradients:
        assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves(gradient(shape, point)))


@pytest.mark.parametrize("name", ["sphere", "box", "cylinder", "capsule"])
def test_inertia_is_that_of_the_uniform_solid(name):
    # Midpoints of a fine grid; what is inside is the solid.
    axis = (np.arange(80) + 0.5) / 80 * 0.12 - 0.06
    x = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    solid = signed_distance(name, x) < 0
    assert SHAPES[name].volume() == pytest.approx(solid.mean() * 0.12**3, rel=2e-2)
    square = np.mean(x[solid] ** 2, axis=0)
    assert SHAPES[name].inertia_per_mass() == pytest.approx(square.sum() - square, rel=2e-2)


def test_vertices_are_the_corners():
    corners = {tuple(v) for v in np.round(np.asarray(SHAPES["box"].points()), 9)}
    assert corners == {(x, y, z) for x in (0.03, -0.03) for y in (0.05, -0.05) for z in (0.04, -0.04)}
