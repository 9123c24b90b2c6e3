"""Meshes as objects that touch others: how well few points, few edges and the search for the closest triangle do."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

import hapjax
from meshes import distance, icosphere, notched


@jax.jit
def closest(shape, queries):
    return jax.lax.map(shape.closest, queries)


@pytest.mark.slow
def test_closest_points_of_a_large_mesh_and_their_gradients_are_those_of_brute_force():
    """Outside exactly; deep inside, where thousands of triangles are about as far, one of those."""
    vertices, triangles = icosphere(4, 0.03)
    mesh = hapjax.Mesh(vertices, triangles)
    rng = np.random.default_rng(6)
    ways = rng.normal(size=(400, 3))
    queries = ways / np.linalg.norm(ways, axis=1)[:, None] * rng.uniform(0, 0.08, 400)[:, None]
    near = closest(mesh, jnp.asarray(queries))
    truth = distance(vertices, triangles, queries)
    error = np.abs(np.abs(np.asarray(near.depth)) - truth)
    away = np.linalg.norm(queries, axis=1)
    assert error[away > 0.03].max() < 1e-15 and np.sum(away < 0.03) > 100
    # Near the middle all triangles are as far but for twice the way from there, and the facets' flatness.
    assert np.all(error <= 2 * away + 1e-4) and np.mean(error[away > 0.01] > 1e-15) < 0.1
    query = jnp.asarray(queries[np.argmin(np.abs(truth - 0.02))])

    @jax.jit
    def depth(query, scale):
        return eqx.tree_at(lambda m: m.scale, mesh, scale).closest(query).depth

    at = (query, mesh.scale)
    forward, reverse = (jac(depth, (0, 1))(*at) for jac in (jax.jacfwd, jax.jacrev))
    for i in range(2):
        np.testing.assert_allclose(forward[i], reverse[i], atol=1e-12)
        way = jnp.asarray(rng.normal(size=jnp.shape(at[i])))
        sides = [depth(*at[:i], at[i] + h * way, *at[i + 1 :]) for h in (1e-7, -1e-7)]
        slope = float(sides[0] - sides[1]) / 2e-7
        assert np.vdot(np.asarray(forward[i]), np.asarray(way)) == pytest.approx(slope, rel=1e-6)


@pytest.mark.slow
def test_a_ball_of_many_triangles_stands_within_its_bulge():
    """A ball of 5,120 triangles on 256 points; of a box of 768 triangles no vertex stands out."""
    radius, mass, stiffness, g = 0.03, 0.05, 2e3, 9.81
    ball = hapjax.Mesh(*icosphere(4, radius))
    assert ball.points().shape == (256, 3) and 0 < ball.bulge() < 0.02 * radius
    assert hapjax.Mesh(*notched()).bulge() == 0
    box = trimesh.creation.box((0.06,) * 3).subdivide().subdivide().subdivide()
    block = hapjax.Mesh(box.vertices, box.faces)
    assert len(block.vertices) > 256 and block.bulge() == pytest.approx(0, abs=1e-12)
    objects = {
        "ball": hapjax.Object(ball, None, hapjax.Body(mass), (0, 0, radius)),
        "floor": hapjax.Object(hapjax.Plane()),
    }
    pair = hapjax.Contact(stiffness, mu=0.5, damping=3.0, between=("ball", "floor"))
    scene = hapjax.Scene(objects, {"pair": pair}, None, hapjax.World((0, 0, -g)))
    hips = jnp.full((1500, 1, 3), 10.0)
    _, reply = hapjax.rollout(scene, hapjax.init(scene, hips[0]), hips)
    height = float(reply.pose[-1, 0, 2])
    assert radius - mass * g / stiffness - float(ball.bulge()) < height < radius
    assert float(reply.contact["pair"].normal_force[-1].sum()) == pytest.approx(mass * g, rel=0.05)


@pytest.mark.slow
def test_the_edges_of_a_mesh_are_few_whatever_its_size():
    box = trimesh.creation.box((0.06,) * 3).subdivide().subdivide().subdivide().subdivide()
    edges = hapjax.Mesh(box.vertices, box.faces).edges()
    assert edges is not None
    lengths = np.linalg.norm(np.asarray(edges.end - edges.start), axis=1)
    np.testing.assert_allclose(lengths, np.full(12, 0.06))
    round_plate = trimesh.creation.cylinder(0.02, 0.01, sections=500)
    edges = hapjax.Mesh(round_plate.vertices, round_plate.faces).edges()
    assert edges is not None
    lengths = np.linalg.norm(np.asarray(edges.end - edges.start), axis=1)
    assert len(lengths) <= 64
    assert lengths.sum() == pytest.approx(2 * 2 * np.pi * 0.02, rel=0.01)


@pytest.mark.parametrize("number", [3, 2.5, True])
def test_a_number_of_contact_points_that_makes_no_sense_is_refused(number):
    with pytest.raises(hapjax.InputError, match="contact_points is .*; allowed: a whole number, at least 4"):
        hapjax.Mesh(*notched(), contact_points=number)
