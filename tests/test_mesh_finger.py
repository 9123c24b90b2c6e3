"""What a finger feels of a mesh from step to step: no jumps with friction, and right derivatives."""

import itertools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hapjax
from hapjax import rotation
from hapjax.shape import Track
from hapjax.shape._shape import Corner, SurfacePoint, ease
from meshes import icosphere, notched, torus

FORMS = {"notched": notched(), "torus": torus()}


@jax.jit
def forces(scene, path):
    """The force on one finger along a path (T, 3) m."""
    return hapjax.rollout(scene, hapjax.init(scene, path[:1]), path[:, None])[1].force[:, 0]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["notched", "torus"])
def test_with_friction_the_force_never_jumps(name):
    """Over edges and corners, out of corners over edges, off the surface and on to it again."""
    vertices, triangles = FORMS[name]
    stiffness, mu, rng = 1000.0, 0.6, np.random.default_rng(5)
    scene = hapjax.Scene(
        {"it": hapjax.Object(hapjax.Mesh(vertices, triangles), hapjax.Surface(stiffness, mu=mu))}
    )
    size = np.ptp(vertices, axis=0).max()
    touched = 0
    for _ in range(10):
        chosen = rng.integers(len(triangles), size=16)
        corners = vertices[triangles[chosen]]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        places = np.einsum("nij,ni->nj", corners, rng.dirichlet([1, 1, 1], 16))
        places -= rng.uniform(-0.05, 0.05, (16, 1)) * size * normals
        places[0] = vertices.max(axis=0) + 0.1 * size
        path = np.concatenate([np.linspace(a, b, 300) for a, b in itertools.pairwise(places)])
        force = np.asarray(forces(scene, jnp.asarray(path)))
        steps = np.linalg.norm(np.diff(force, axis=0), axis=1)
        own = stiffness * np.linalg.norm(np.diff(path, axis=0), axis=1)
        assert np.all(steps <= 2 * np.sqrt(1 + mu**2) * own + 1e-9)
        touched += np.count_nonzero(force.any(axis=1))
    assert touched > 5000


@pytest.mark.slow
def test_what_several_planes_held_is_let_go_with_the_way():
    """Two planes at right angles held at 10 mm; the finger goes on 1 mm a step where only a third one is left."""
    surface = hapjax.Surface(1000.0, mu=[0.2, 0.5, 0.8])
    zero, along, up = jnp.zeros(()), jnp.array([1.0, 0.0, 0.0]), jnp.array([0.0, 0.0, 1.0])
    own, faces = jnp.array([1.0, 0.0, 0.0]), jnp.zeros(3, jnp.int32)
    plane = Corner(jnp.tile(up, (3, 1)), own, faces, jnp.zeros(3), faces)

    def gone(track, query, depth=0.1) -> tuple[Any, Any]:
        near = SurfacePoint(query, up, jnp.asarray(depth), jnp.zeros((), jnp.int32), plane)
        track, near = ease(track, query, near)
        return track, surface.static_at(near, along) * near.depth

    def both(numbers):
        """By how much friction along the edge holds after each of forty steps."""
        planes = jnp.stack(
            [numbers[0] * jnp.array([1.0, 1.0, 0.0]), jnp.array([1.0, 2.0, 2.0]), zero * own, zero * own]
        )
        before = Track(jnp.zeros(3), jnp.array([0.0, 0.01, 0.0]), zero, planes)
        return jax.lax.scan(gone, before, numbers[1] * jnp.arange(1.0, 41.0)[:, None] * along[None])

    held = jax.jit(lambda numbers: both(numbers)[1])
    at = jnp.array([np.sqrt(0.5), 0.001])
    limits, share = held(at), np.sqrt(0.5) * (0.5 + 0.8)
    assert np.isclose(limits[0], share * 0.01, rtol=0.15)
    assert np.all(np.abs(np.diff(limits)) <= 2 * share * 0.001)
    track: Any = both(at)[0]
    last = limits[-1]
    assert not np.any(track.planes[2]) and np.isclose(last, 0.2 * np.linalg.norm(track.stretch))

    forward, reverse = jax.jit(jax.jacfwd(held))(at), jax.jit(jax.jacrev(held))(at)
    np.testing.assert_allclose(forward, reverse, atol=1e-12)
    for i in range(2):
        h = 1e-7 * jnp.eye(2)[i]
        np.testing.assert_allclose(forward[:, i], (held(at + h) - held(at - h)) / 2e-7, atol=1e-6)
    assert np.all(np.any(np.asarray(forward) != 0, axis=0))

    # Off the surface nothing is kept for the next touch.
    began: Any = both(jnp.array([np.sqrt(0.5), 1e-4]))[0]
    assert np.any(began.planes[2])
    assert not np.any(gone(began, jnp.array([1.0, 0.0, 0.0]), 0.0)[0].planes[::2])


@pytest.mark.slow
@pytest.mark.parametrize("shaded", [False, True])
def test_what_a_finger_feels_has_the_gradients_of_differences(shaded):
    """By the vertices, the size, the place and the turn of a mesh, and by mu, after a press and a slide."""
    vertices, triangles = icosphere(1, 0.04)
    mesh = hapjax.Mesh(vertices, triangles, shaded=shaded)
    inward = np.array([0.3, 0.4, 0.5]) / np.linalg.norm([0.3, 0.4, 0.5])
    along = np.cross(inward, [0, 0, 1])
    radius = np.r_[np.linspace(0.046, 0.036, 6), np.full(6, 0.036)][:, None]
    slid = np.r_[np.zeros(6), np.linspace(1e-3, 6e-3, 6)][:, None]
    path = jnp.asarray(radius * inward + slid * along)
    way = jnp.asarray(np.random.default_rng(0).normal(size=vertices.shape) * 1e-3)

    def feels(numbers):
        moved = mesh.moved(mesh.vertices + numbers[0] * way)
        moved = eqx.tree_at(lambda m: m.scale, moved, 1 + numbers[1])
        turn = rotation.from_rotation_vector(numbers[5:8])
        it = hapjax.Object(moved, hapjax.Surface(800.0, mu=0.3 + numbers[8]), None, numbers[2:5], turn)
        scene = hapjax.Scene({"it": it})
        # Not rollout, whose reverse mode computes each step once more, and takes longer to compile.
        last = jax.lax.scan(
            lambda s, hip: hapjax.step(scene, s, hip), hapjax.init(scene, path[:1]), path[:, None]
        )
        return last[1].force[-1, 0]

    # One program gives the forces and the derivative along each axis: at 0, and h to either side of it.
    h, axes = 1e-6, jnp.eye(9)
    places = jnp.concatenate([0 * axes, h * axes, -h * axes])
    pushed = jax.jit(jax.vmap(lambda at, axis: jax.jvp(feels, (at,), (axis,))))
    values, slopes = (np.asarray(x).reshape(3, 9, 3) for x in pushed(places, jnp.tile(axes, (3, 1))))
    if not shaded:  # it takes long to compile
        np.testing.assert_allclose(slopes[0].T, jax.jit(jax.jacrev(feels))(places[0]), atol=1e-9)
    np.testing.assert_allclose(slopes[0], (values[1] - values[2]) / (2 * h), rtol=1e-5, atol=1e-4)
    assert np.all(np.any(slopes[0] != 0, axis=1))
