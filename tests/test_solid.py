"""The solid within a mesh: its volume, centre, inertia and edges."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from jax.test_util import check_grads

import hapjax
from hapjax import rotation
from meshes import inside
from test_mesh import FORMS, mesh_of


@pytest.mark.parametrize("name", FORMS)
def test_volume_centre_and_inertia_are_trimeshs(name):
    vertices, triangles = FORMS[name]
    truth = trimesh.Trimesh(vertices, triangles, process=False)
    mesh = eqx.tree_at(lambda m: m.scale, mesh_of(name), jnp.asarray(2.0))
    assert float(mesh.volume()) == pytest.approx(8 * truth.volume)
    np.testing.assert_allclose(mesh.centre(), 2 * truth.center_mass, atol=1e-12)
    np.testing.assert_allclose(mesh.inertia_per_mass() * truth.volume, 4 * truth.moment_inertia, atol=1e-14)


@pytest.mark.slow
def test_the_solid_is_differentiable_in_the_vertices():
    mesh = mesh_of("notched")
    check_grads(
        lambda v: (mesh.moved(v).centre(), 1e3 * mesh.moved(v).inertia_per_mass()),
        (mesh.vertices,),
        1,
        rtol=1e-4,
    )


def test_edges_are_where_the_surface_bends_outward():
    """Of the cube without an octant: its own, less half of three, and six about the notch; not the three within it."""
    mesh = eqx.tree_at(lambda m: m.scale, mesh_of("notched"), jnp.asarray(2.0))
    edges = jax.tree.map(np.asarray, mesh.edges())
    along = edges.end - edges.start
    assert np.linalg.norm(along, axis=1).sum() == pytest.approx(2 * (12 * 0.04 - 3 * 0.02 + 6 * 0.02))
    first, second = edges.normals[:, 0], edges.normals[:, 1]
    np.testing.assert_allclose(np.sum(first * second, axis=1), 0, atol=1e-12)
    np.testing.assert_allclose(np.sum(along[:, None] * edges.normals, axis=2), 0, atol=1e-12)
    middle = (edges.start + edges.end) / 2
    within = inside(2 * FORMS["notched"][0], FORMS["notched"][1], middle - 1e-4 * (first + second))
    outside = inside(2 * FORMS["notched"][0], FORMS["notched"][1], middle + 1e-4 * (first - second))
    assert within.all() and not outside.any()
    assert float(mesh.thickness()) == pytest.approx(2 * 7 * 0.02**3 / (6 * 0.04**2))


def test_a_body_of_a_mesh_turns_about_its_own_centre():
    mesh = mesh_of("notched")
    body = hapjax.Body.of_density(mesh, 1000.0)
    assert float(body.mass) == pytest.approx(7 * 0.02**3 * 1000)
    scene = hapjax.Scene({"stone": hapjax.Object(mesh, None, body)}, world=hapjax.World(gyroscopic=True))
    hips = jnp.full((300, 1, 3), 1.0)
    state = hapjax.init(scene, hips[0])
    state = eqx.tree_at(lambda s: s.motion["stone"].spin, state, jnp.asarray([3.0, 1.0, -2.0]))
    _, reply = hapjax.rollout(scene, state, hips)
    pose = np.asarray(reply.pose[:, 0])
    turned = rotation.to_matrix(jnp.asarray(pose[-1, [3, 4, 5, 6]]))
    assert np.linalg.norm(pose[-1, :3]) > 5e-3
    np.testing.assert_allclose(pose[-1, :3] + turned @ mesh.centre(), mesh.centre(), atol=1e-12)
