"""Convex polytopes, and surfaces that are refused."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hapjax
from meshes import notched, voxels


@functools.partial(jax.jit)
def closest(shape, queries):
    return jax.vmap(shape.closest)(queries)


@pytest.mark.slow
def test_a_convex_hull_of_a_boxs_corners_is_the_box():
    box = hapjax.Box((0.06, 0.04, 0.02))
    corners = [(x, y, z) for x in (0.03, -0.03) for y in (0.02, -0.02) for z in (0.01, -0.01)]
    hull = hapjax.Convex([*corners, (0.01, 0.0, 0.0)])
    assert hull.vertices.shape == (8, 3) and len(hull.faces) == 6
    queries = jnp.asarray(np.random.default_rng(5).uniform(-0.04, 0.04, (500, 3)))
    ours, truth = closest(hull, queries), closest(box, queries)
    np.testing.assert_allclose(ours.depth, truth.depth, atol=1e-15)
    np.testing.assert_allclose(ours.point, truth.point, atol=1e-12)
    # The flat faces under other numbers.
    named = np.asarray(hull.face_normals())[np.asarray(ours.face)]
    flat = np.asarray(truth.depth) > 0
    np.testing.assert_allclose(named[flat], np.asarray(ours.normal)[flat], atol=1e-12)
    assert float(hull.volume()) == pytest.approx(0.06 * 0.04 * 0.02)
    np.testing.assert_allclose(hull.inertia_per_mass(), np.diag(box.inertia_per_mass()), atol=1e-15)


@pytest.mark.parametrize(
    "points", [[[0, 0, 0]] * 5, [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], "box", [[1.0, 2]]]
)
def test_points_without_a_hull_are_refused(points):
    with pytest.raises(hapjax.InputError, match="allowed: at least four points"):
        hapjax.Convex(points)


@pytest.mark.slow
@pytest.mark.parametrize("face", range(6))
def test_a_finger_that_starts_inside_stays_with_the_nearest_face(face):
    """Dragged along it, as on the box; not with the face whose number is that of a triangle."""
    size = np.array([0.06, 0.04, 0.02])
    corners = [(x, y, z) for x in (0.03, -0.03) for y in (0.02, -0.02) for z in (0.01, -0.01)]
    normal = np.zeros(3)
    normal[face // 2] = 1 - 2 * (face % 2)
    along = np.roll(np.abs(normal), 1)
    path = (size / 2 - 1e-3) * normal + np.linspace(0, 2e-3, 20)[:, None] * along
    forces = []
    for shape in (hapjax.Box(size), hapjax.Convex(corners)):
        scene = hapjax.Scene({"it": hapjax.Object(shape, hapjax.Surface(1000.0, mu=0.0))})
        forces.append(_rollout(scene, hapjax.init(scene, path[:1]), path[:, None])[1].force[:, 0])
    assert forces[0] == pytest.approx(np.tile(normal, (20, 1)), abs=1e-9)
    assert forces[1] == pytest.approx(np.asarray(forces[0]), abs=1e-9)


_rollout = jax.jit(hapjax.rollout)


def test_corners_in_single_precision_have_the_same_flat_faces():
    turn = np.linalg.qr(np.random.default_rng(1).standard_normal((3, 3)))[0]
    corners = np.array([(x, y, z) for x in (0.03, -0.03) for y in (0.02, -0.02) for z in (0.01, -0.01)])
    assert len(hapjax.Convex((corners @ turn).astype(np.float32)).faces) == 6


@pytest.mark.slow
def test_gradients_are_those_of_differences():
    """Of what holds a finger, by its place, the hull's scale and its vertices."""
    points = np.random.default_rng(3).standard_normal((20, 3))
    hull = hapjax.Convex(0.04 * points / np.linalg.norm(points, axis=1)[:, None])
    middle = np.asarray(hull.vertices[hull.triangles[4]]).mean(axis=0)
    start, query = jnp.asarray(1.1 * middle), jnp.asarray(0.97 * middle)

    @jax.jit
    def answer(query, scale, vertices):
        moved = eqx.tree_at(lambda m: (m.scale, m.vertices), hull, (scale, vertices))
        track = hapjax.shape.Track(start, jnp.zeros(3), jnp.zeros(()))
        _, held = moved.follow(track, query)
        return jnp.concatenate([held.point, held.normal, held.depth[None]])

    at = (query, hull.scale, hull.vertices)
    assert answer(*at)[-1] > 1e-4
    forward, reverse = jax.jacfwd(answer, (0, 1, 2))(*at), jax.jacrev(answer, (0, 1, 2))(*at)
    for i, point in enumerate(at):
        np.testing.assert_allclose(forward[i], reverse[i], atol=1e-9)
        way = jnp.asarray(np.random.default_rng(i).standard_normal(point.shape))
        sides = [answer(*at[:i], point + h * way, *at[i + 1 :]) for h in (1e-7, -1e-7)]
        slope = np.tensordot(np.asarray(forward[i]), np.asarray(way), point.ndim)
        np.testing.assert_allclose(slope, (sides[0] - sides[1]) / 2e-7, atol=1e-5, rtol=1e-6)
        assert np.any(np.asarray(forward[i]) != 0)


# Refusals ------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (lambda v, t: (v, t[1:]), "3 of the triangles are beside a hole"),
        (lambda v, t: (v, t[:, ::-1]), "48 of the triangles face inward"),
        (lambda v, t: (v, np.concatenate([t[:1, ::-1], t[1:]])), "the winding is not consistent"),
        (lambda v, t: (v * 1e-5, t), "48 of the triangles have an area below 1e-12 m"),
        (
            lambda v, t: (v, np.concatenate([t, t[4:5]])),
            "1 of the triangles are there twice, the first is 48",
        ),
        (
            lambda v, t: (np.where(v == v[3], np.nan, v), t),
            "of the vertices have a number that is not finite",
        ),
        (lambda v, t: (v, t + 1), "of the triangles have a corner that is no whole number from 0 to 25"),
        (lambda v, t: (v[:, :2], t), r"vertices have the shape \(26, 2\)"),
    ],
)
def test_a_faulty_surface_is_refused(change, fault):
    with pytest.raises(hapjax.InputError, match=fault):
        hapjax.Mesh(*change(*notched()))


def test_the_smallest_area_is_that_of_the_scaled_surface():
    vertices, triangles = notched()
    with pytest.raises(hapjax.InputError, match="48 of the triangles have an area below 1e-12 m"):
        hapjax.Mesh(vertices, triangles, 5e-5)
    hapjax.Mesh(1e3 * vertices, triangles, 1e-3)
    hapjax.Mesh(vertices * 1e-5, triangles, 1e5)


def test_everything_that_is_wrong_is_said_at_once():
    vertices, triangles = notched()
    with pytest.raises(hapjax.InputError, match="there twice.*; .*winding.*; .*beside a hole"):
        hapjax.Mesh(vertices, np.concatenate([triangles[1:], triangles[4:5]]))


def test_a_turned_triangle_is_no_hole():
    vertices, triangles = notched()
    turned = np.concatenate([triangles[:1, ::-1], triangles[1:]])
    with pytest.raises(
        hapjax.InputError, match="^4 of the triangles have an edge that another [^;]*; allowed"
    ):
        hapjax.Mesh(vertices, turned)


def _two(second, away, inward):
    """A cube of 40 mm and another one, of which the second may be turned inside out."""
    first, triangles = voxels([(0, 0, 0)], 0.04)
    other = voxels([(0, 0, 0)], second)[0] + away
    more = triangles[:, ::-1] if inward else triangles
    return np.concatenate([first, other]), np.concatenate([triangles, more + len(first)])


def test_each_piece_of_a_surface_faces_outward_and_a_cavity_inward():
    hapjax.Mesh(*_two(0.02, 0.1, inward=False))
    hollow = hapjax.Mesh(*_two(0.02, 0.01, inward=True))
    assert hollow.volume() == pytest.approx(0.04**3 - 0.02**3)
    with pytest.raises(hapjax.InputError, match="12 of the triangles face inward, the first is 12"):
        hapjax.Mesh(*_two(0.02, 0.1, inward=True))
    for size, away in ((0.02, 0.01), (0.04, 0.01)):  # whole within, and overlapping
        with pytest.raises(hapjax.InputError, match="12 of the triangles are within another piece"):
            hapjax.Mesh(*_two(size, away, inward=False))
