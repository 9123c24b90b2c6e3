"""Meshes and convex polytopes against brute force, analytic shapes and SciPy."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh
from scipy.optimize import lsq_linear

import hapjax
from hapjax.shape import _grid, _planes
from helpers import well_compiled
from meshes import TILT, distance, entries, icosphere, inside, notched, torus, voxels
from test_structure import equations

K = 800.0
FORMS = {"notched": notched(), "torus": torus(), "sphere": icosphere(2, 0.04)}
FORMS["notched"] = (FORMS["notched"][0] @ TILT.T, FORMS["notched"][1])


@functools.cache
def mesh_of(name):
    return hapjax.Mesh(*FORMS[name])


def as_type(mesh, dtype):
    return jax.tree.map(lambda leaf: leaf.astype(dtype), mesh)


@jax.jit
def closest(shape, queries):
    return jax.vmap(shape.closest)(queries)  # in batches, what is left over would be compiled a second time


def followed(shape, ways):
    """The surface points (n, 2) that hold a point on ways (n, 3, 3) m which begin outside, all in NumPy."""
    # In batches of one size, so that one program follows however many.
    batches = np.resize(ways, (-(-len(ways) // 1000), 1000, 3, 3))
    held = [_each_followed(shape, jnp.asarray(batch)) for batch in batches]
    return jax.tree.map(lambda *parts: np.concatenate(parts)[: len(ways)], *held)


@well_compiled
@functools.partial(jax.vmap, in_axes=(None, 0))
def _each_followed(shape, way):
    return jax.lax.scan(lambda carry, point: shape.follow(carry, point), _outside(way[0]), way[1:])[1]


def _outside(point):
    return hapjax.shape.Track(
        point, jnp.zeros_like(point), jnp.zeros_like(point[0]), jnp.zeros((4, 3), point.dtype)
    )


@jax.jit
def dragged(shape, way):
    """What holds a point on a way (T, 3) m that begins outside."""
    return jax.lax.scan(lambda carry, point: shape.follow(carry, point), _outside(way[0]), way[1:])[1]


# Closest points -------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMS)
def test_closest_point_and_side_are_those_of_brute_force(name, dtype):
    vertices, triangles = FORMS[name]
    mesh = as_type(mesh_of(name), dtype)
    rng = np.random.default_rng(0)
    queries = np.concatenate(
        [
            rng.uniform(vertices.min(axis=0) - 0.01, vertices.max(axis=0) + 0.01, (400, 3)),
            # about the vertices, where the normal of a neighbouring triangle alone gives the wrong side
            vertices[rng.integers(len(vertices), size=400)] + rng.normal(0, 1e-4, (400, 3)),
        ]
    ).astype(dtype)
    near = jax.tree.map(np.asarray, closest(mesh, jnp.asarray(queries)))
    queries = queries.astype(float)
    eps = float(jnp.finfo(dtype).eps)
    truth = distance(vertices, triangles, queries)
    clear = truth > 10 * eps
    assert near.depth.dtype == dtype and clear.sum() > 790
    np.testing.assert_allclose(np.abs(near.depth), truth, atol=eps)
    assert np.array_equal(near.depth[clear] > 0, inside(vertices, triangles, queries[clear]))
    np.testing.assert_allclose(np.linalg.norm(near.normal, axis=1), 1, atol=8 * eps)
    np.testing.assert_allclose(np.sum(near.normal * (near.point - queries), axis=1), near.depth, atol=2 * eps)


def singular_points():
    vertices, triangles = FORMS["notched"]
    a, b, c = vertices[triangles[5]]
    return jnp.asarray(
        [a, (a + b) / 2, (a + b + c) / 3, TILT @ [0.02, 0.02, 0.02], TILT @ [0.02, 0.02, 0.03]]
    )


def moved_answer(start, query, scale, vertices):
    """The nearest point, its normal and depth; what holds a point come from `start`, its normal, depth and shares."""
    moved = eqx.tree_at(lambda m: (m.scale, m.vertices), mesh_of("notched"), (scale, vertices))
    near, (_, held) = moved.closest(query), moved.follow(_outside(start), query)
    share = jnp.sum(held.corner.weights)  # in the order of the planes there is no meaning
    last = jnp.stack([held.depth, share])
    return jnp.concatenate([near.point, near.normal, near.depth[None], held.point, held.normal, last])


CONCAVE = [(0.015, 0.03, 0.033), (0.018, 0.017, 0.03), (0.018, 0.017, 0.016)]


@functools.cache
def slopes():
    """By query, scale and vertices, forward and reverse: at the singular points, and on CONCAVE."""
    mesh, singular = mesh_of("notched"), singular_points()
    queries = jnp.concatenate([singular, jnp.asarray(CONCAVE @ TILT.T)])
    aside = jnp.broadcast_to(jnp.asarray(TILT @ [0.03, 0.031, 0.032]), (len(CONCAVE), 3))
    starts, by = jnp.concatenate([singular, aside]), (1, 2, 3)

    @jax.jit
    def both(starts, queries, scale, vertices):
        modes = [jacobian(moved_answer, by) for jacobian in (jax.jacfwd, jax.jacrev)]
        return [jax.vmap(mode, (0, 0, None, None))(starts, queries, scale, vertices) for mode in modes]

    return jax.tree.map(np.asarray, both(starts, queries, mesh.scale, mesh.vertices))


@pytest.mark.slow
def test_singular_points_have_a_unit_normal_and_finite_gradients():
    near = closest(mesh_of("notched"), singular_points())
    np.testing.assert_allclose(np.linalg.norm(near.normal, axis=1), 1, atol=1e-12)
    np.testing.assert_allclose(near.depth, 0, atol=1e-16)
    for mode in slopes():
        for leaf in mode:
            assert np.all(np.isfinite(leaf[: len(singular_points())]))


# First touch ----------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", ["notched", "torus"])
def test_first_touch_is_that_of_brute_force(name):
    vertices, triangles = FORMS[name]
    mesh = mesh_of(name)
    rng = np.random.default_rng(1)
    middle, size = vertices.mean(axis=0), np.ptp(vertices, axis=0).max()
    start = middle + rng.uniform(-size, size, (3000, 3))
    end = np.where(
        rng.random((3000, 1)) < 0.5,
        start + rng.normal(0, size / 20, (3000, 3)),
        middle + rng.uniform(-size, size, (3000, 3)),
    )

    @jax.jit
    def first(mesh, start, end):
        zero, yes = jnp.zeros((), start.dtype), jnp.ones((), bool)

        def one(a, b):
            return _grid.first_entered(mesh.grid, mesh.topology.patches, a, b, zero, yes)

        return jax.vmap(one)(start, end)

    found, when = first(mesh, jnp.asarray(start), jnp.asarray(end))
    truth, at = entries(vertices, triangles, start, end)
    assert (truth >= 0).sum() > 200 and (truth < 0).sum() > 200
    np.testing.assert_array_equal(np.asarray(found), truth)
    np.testing.assert_allclose(np.asarray(when), at, atol=1e-12)


def approaches(vertices, triangles, count, seed):
    """Ways of three points: outside; on a face, an edge, a vertex, or where it was; on from there, mostly inside."""
    rng = np.random.default_rng(seed)
    corners = vertices[triangles[rng.integers(len(triangles), size=count)]]
    blend = rng.dirichlet([1, 1, 1], count)
    kind = rng.integers(4, size=count)
    share = rng.choice([0.5, 0.3], count)
    blend[kind == 1] = np.stack([share, 1 - share, 0 * share], axis=1)[kind == 1]
    blend[kind == 2] = [1, 0, 0]
    target = np.einsum("ni,nij->nj", blend, corners)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    reach = rng.choice([1e-15, 1e-12, 1e-9, 1e-6, 1e-4, 2e-3], count)[:, None]
    end = target - reach * (normal + rng.choice([0, 0.3, 3.0], count)[:, None] * rng.normal(size=(count, 3)))
    start = target + rng.choice([1e-3, 0.1], count)[:, None] * (
        normal + rng.choice([0.0, 0.5], count)[:, None] * rng.uniform(-1, 1, (count, 3))
    )
    between = np.where((kind == 3)[:, None], start, target)
    free = ~inside(vertices, triangles, start)
    return np.stack([start, between, end], axis=1)[free]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "number", "count"),
    [("notched", np.float64, 65_000), ("torus", np.float64, 20_000), ("notched", np.float32, 20_000)],
)
def test_no_approach_falls_through(name, number, count):
    vertices, triangles = FORMS[name]
    ways = approaches(vertices, triangles, count, 2).astype(number)
    depth = followed(as_type(mesh_of(name), number), ways).depth[:, -1]
    end = ways[:, -1].astype(float)
    # Nearer than rounding there is no inside and outside.
    deep = distance(vertices, triangles, end) > 8 * np.finfo(number).eps * 0.05
    within = inside(vertices, triangles, end)
    assert len(ways) >= 0.95 * count and (deep & within).sum() > 0.3 * count
    assert np.sum(deep & within & (depth <= 0)) == 0
    # And what meets nothing is not held.
    few = slice(5000)
    start, between, end = (ways[few, i].astype(float) for i in range(3))
    met = np.isfinite([entries(vertices, triangles, *way)[1] for way in ((start, between), (between, end))])
    free = ~met.any(axis=0) & (deep & ~within)[few] & (distance(vertices, triangles, between) > 1e-6)
    assert free.sum() > 50 and np.all(depth[few][free] == 0)


@pytest.mark.slow
def test_a_way_through_a_thin_plate_is_held_by_the_first_face():
    plate = trimesh.creation.box((0.1, 0.1, 1e-5))
    mesh = hapjax.Mesh(plate.vertices, plate.faces)
    held = dragged(mesh, jnp.asarray([[0.01, 0.02, 0.003], [0.012, 0.02, -0.004], [0.03, 0.02, -0.004]]))
    np.testing.assert_allclose(held.depth, 0.004 + 5e-6, rtol=1e-9)
    np.testing.assert_allclose(held.normal, [[0, 0, 1]] * 2, atol=1e-12)


@pytest.mark.slow
def test_a_tiny_triangle_is_felt():
    # One face of a cube with a triangle of 1.1e-12 m^2 in its middle.
    cube = trimesh.creation.box((0.04, 0.04, 0.04))
    vertices, triangles = np.asarray(cube.vertices), np.asarray(cube.faces)
    top = np.flatnonzero(cube.face_normals[:, 2] > 0.9)[0]
    a, b, c = triangles[top]
    middle = vertices[[a, b, c]].mean(axis=0)
    size = np.sqrt(1.1e-12 / (np.sqrt(3) / 4)) / np.sqrt(3)
    angle = np.arctan2(*(vertices[a] - middle)[1::-1]) + np.arange(3) * 2 * np.pi / 3
    tiny = middle + size * np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    p, q, r = range(len(vertices), len(vertices) + 3)
    ring = [[p, q, r], [a, b, q], [a, q, p], [b, c, r], [b, r, q], [c, a, p], [c, p, r]]
    mesh = hapjax.Mesh(np.concatenate([vertices, tiny]), np.concatenate([np.delete(triangles, top, 0), ring]))
    held = dragged(mesh, jnp.asarray([middle + [0, 0, 1e-3], middle - [0, 0, 2e-3]]))
    assert held.face[-1] == 11
    np.testing.assert_allclose(held.depth[-1], 2e-3, rtol=1e-9)


@pytest.mark.slow
def test_a_finger_that_leaves_one_prong_meets_the_other_in_the_same_step():
    mesh = hapjax.Mesh(*voxels([(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 0, 1), (2, 0, 1)]))
    way = [(0.03, 0.012, 0.033), (0.019, 0.012, 0.033), (0.041, 0.012, 0.033), (0.03, 0.012, 0.033)]
    held = dragged(mesh, jnp.asarray(way))
    np.testing.assert_allclose(held.depth, [1e-3, 1e-3, 0], rtol=1e-9)
    np.testing.assert_allclose(held.normal[:2], [[1, 0, 0], [-1, 0, 0]], atol=1e-12)


@pytest.mark.slow
def test_a_vertex_of_many_triangles_is_left_to_any_of_them():
    """From one side of a flat cone of 40 triangles to the other in one step."""
    angle = np.arange(40) * 2 * np.pi / 40
    ring = np.stack([0.03 * np.cos(angle), 0.03 * np.sin(angle), 0 * angle], axis=1)
    i, after = np.arange(40), np.roll(np.arange(40), -1)
    apex, foot = np.full(40, 40), np.full(40, 41)
    top, below = np.stack([apex, i, after], axis=1), np.stack([foot, after, i], axis=1)
    vertices = np.concatenate([ring, [[0, 0, 0.005], [0, 0, -0.02]]])
    mesh = hapjax.Mesh(vertices, np.concatenate([top, below]))
    corners = vertices[top[[0, 20]]]
    middle = corners.mean(axis=1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    deep = middle - 1e-3 * normal
    held = dragged(mesh, jnp.asarray([middle[0] + 1e-3 * normal[0], *deep]))
    assert held.face.tolist() == [0, 20]
    np.testing.assert_allclose(held.depth, 1e-3, rtol=1e-9)
    np.testing.assert_allclose(held.normal, normal, atol=1e-12)


# Contact --------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_concave_corner_holds_by_up_to_three_planes():
    """Against SciPy's bounded least squares: the nearest point beyond three planes."""
    mesh = mesh_of("notched")
    rng = np.random.default_rng(3)
    local = 0.02 + rng.uniform(-5e-3, 5e-3, (300, 3))
    local = local[(local < 0.02).any(axis=1)]
    start = np.broadcast_to(TILT @ [0.03, 0.03, 0.03], local.shape)
    held = followed(mesh, np.stack([start, start, local @ TILT.T], axis=1))
    held = jax.tree.map(lambda leaf: leaf[:, -1], held)
    counts = np.sum(local < 0.02, axis=1)
    assert set(counts) == {1, 2, 3}
    for i, point in enumerate(local):
        truth = lsq_linear(TILT, TILT @ point, bounds=(0.02, np.inf), tol=1e-15, method="bvls").x
        np.testing.assert_allclose(TILT.T @ held.point[i], truth, atol=1e-12)
        depth = np.maximum(0.02 - point, 0)
        assert held.depth[i] == pytest.approx(np.linalg.norm(depth), rel=1e-9)
        # Each plane carries the force that its own spring would.
        share = held.corner.weights[i][:, None] * held.corner.normals[i] * held.depth[i]
        np.testing.assert_allclose(TILT.T @ share.sum(axis=0), depth, atol=1e-12)
        assert np.sum(held.corner.weights[i] > 0) == counts[i]
        np.testing.assert_allclose(
            np.sort(np.abs(held.corner.weights[i] * held.depth[i]))[::-1], np.sort(depth)[::-1], atol=1e-12
        )


def test_a_vertex_normal_does_not_depend_on_how_faces_are_cut():
    """Of a box the diagonals, however many of a face's two triangles end at a vertex."""
    box = trimesh.creation.box((0.02, 0.02, 0.02))
    normals = hapjax.Mesh(box.vertices, box.faces).topology.vertex_normals
    np.testing.assert_allclose(normals, np.sign(box.vertices) / np.sqrt(3), atol=1e-12)


def test_planes_that_meet_at_any_angle_share_the_force():
    """Unit normals 60 degrees apart, with known shares: their pushes together are the force."""
    planes = jnp.array([[1, 0, 0], [0.5, np.sqrt(0.75), 0], [0.5, np.sqrt(0.75), 0]])
    force = 0.7 * planes[0] + 0.4 * planes[1]
    size = float(jnp.linalg.norm(force))
    count, faces = jnp.asarray(2, jnp.int32), jnp.array([3, 5, 3], jnp.int32)
    corner = _planes.corner_of(planes, faces, count, force / size, faces[0])
    np.testing.assert_allclose(size * corner.weights, [0.7, 0.4, 0], atol=1e-15)
    np.testing.assert_array_equal(corner.faces[:2], [3, 5])


@pytest.mark.slow
def test_friction_holds_on_both_walls_of_a_corner():
    """A finger pressed equally into two walls at a right angle, pulled along their line."""
    press, mu = 1e-3, 0.8
    surface = hapjax.Surface(K, mu_static=mu, mu_kinetic=0.5)
    scene = hapjax.Scene({"notched": hapjax.Object(mesh_of("notched"), surface)})
    pull = np.concatenate([[0], np.linspace(0, 2 * mu * press * 1.05, 106)])
    local = np.stack([0 * pull + 0.02 - press, 0 * pull + 0.02 - press, 0.025 + pull], axis=1)
    local[0] = [0.025, 0.025, 0.025]
    hips = jnp.asarray(local @ TILT.T)[:, None]
    _, reply = hapjax.rollout(scene, hapjax.init(scene, hips[0]), hips[1:])
    force = np.asarray(reply.force[:, 0]) @ TILT
    np.testing.assert_allclose(force[:, :2], K * press, rtol=1e-9)
    stuck = pull[1:] < 2 * mu * press * (1 - 1e-9)
    np.testing.assert_allclose(force[stuck, 2], -K * pull[1:][stuck], atol=1e-9)
    assert -force[stuck, 2].min() > 0.98 * mu * 2 * K * press
    assert -force[-1, 2] == pytest.approx(0.5 * 2 * K * press, rel=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("radius", [0.005, 0.05])
def test_a_finger_on_a_tessellated_sphere_feels_a_sphere(radius):
    """Steps of the force, and its distance to that of the ball.

    The mesh lies between the radii R - e and R. The held point c of a query at depth D is no farther than D, so with
    |c| >= R - e its angle from the ball's point is at most sqrt(2 e D / ((R - e) (R - D))).
    """
    vertices, triangles = icosphere(4, radius)
    mesh = hapjax.Mesh(vertices, triangles)
    assert len(triangles) == 5120
    s = np.linspace(0, 1, 6000)
    depth = radius * np.where(s < 0.2, s / 2 - 0.02, 0.08)
    angle = 5 * s
    way = np.stack([np.cos(angle) * np.cos(2 * s), np.sin(angle) * np.cos(2 * s), np.sin(2 * s)], axis=1)
    way *= (radius - depth)[:, None]
    held = dragged(mesh, jnp.asarray(way))
    force = K * np.asarray(held.normal * held.depth[:, None])
    steps = np.linalg.norm(np.diff(force, axis=0), axis=1)
    assert np.all(steps <= K * np.linalg.norm(np.diff(way[1:], axis=0), axis=1) * (1 + 1e-6) + 1e-12)
    e = radius - np.linalg.norm(vertices[triangles].mean(axis=1), axis=1).min()
    d = np.maximum(depth[1:], 0)
    bound = e + radius * np.sqrt(2 * e * d / ((radius - e) * (radius - d)))
    ball = K * d[:, None] * way[1:] / np.linalg.norm(way[1:], axis=1, keepdims=True)
    assert np.all(np.linalg.norm(force - ball, axis=1) <= K * bound * (1 + 1e-9))
    assert np.linalg.norm(force[-1]) > 0.9 * K * d[-1]


@pytest.mark.slow
def test_shading_turns_the_force_towards_the_balls():
    vertices, triangles = icosphere(2, 0.04)
    way = jnp.asarray(np.linspace([0.045, 0.004, 0.002], [0.034, 0.013, 0.009], 400))
    plain, shaded = (dragged(hapjax.Mesh(vertices, triangles, shaded=s), way) for s in (False, True))
    touching = np.asarray(plain.depth) > 0
    assert touching.sum() > 100

    def error(held):
        point = np.asarray(held.point)[touching]
        return np.linalg.norm(
            np.asarray(held.normal)[touching] - point / np.linalg.norm(point, axis=1)[:, None], axis=1
        )

    assert error(shaded).max() < 0.3 * error(plain).max()
    np.testing.assert_allclose(
        np.asarray(shaded.depth)[touching], np.asarray(plain.depth)[touching], atol=2e-5
    )


@pytest.mark.slow
def test_a_triangle_can_have_a_mu_of_its_own():
    mesh = mesh_of("sphere")
    mu = jnp.zeros(len(mesh.faces)).at[7].set(0.5)
    scene = hapjax.Scene({"ball": hapjax.Object(mesh, hapjax.Surface(K, mu))})
    corners = FORMS["sphere"][0][FORMS["sphere"][1][7]]
    aim = corners.mean(axis=0)
    slip = (corners[1] - corners[0]) / 10
    hips = jnp.asarray([1.1 * aim, 0.99 * aim, 0.99 * aim + slip])[:, None]
    _, reply = hapjax.rollout(scene, hapjax.init(scene, hips[0]), hips)
    touch = reply.touch["ball"]
    assert float(jnp.linalg.norm(touch.friction_force[-1, 0])) == pytest.approx(
        0.5 * float(touch.normal_force[-1, 0])
    )


# Derivatives ----------------------------------------------------------------------------------------------


@functools.cache
def each_answer():
    return jax.jit(jax.vmap(moved_answer))


@pytest.mark.slow
@pytest.mark.parametrize("place", range(len(CONCAVE)))
def test_gradients_are_those_of_differences(place):
    """On a plane, in a concave edge and in a concave corner."""
    mesh, rng = mesh_of("notched"), np.random.default_rng(4)
    start, query = (jnp.asarray(TILT @ x) for x in ([0.03, 0.031, 0.032], CONCAVE[place]))
    at = [np.asarray(x) for x in (query, mesh.scale, mesh.vertices)]
    forward, reverse = ([leaf[len(singular_points()) + place] for leaf in mode] for mode in slopes())
    # What is flat stays flat: where a plane breaks up into two, which of them hold is no smooth matter.
    turns = rng.normal(size=(3, 3)), rng.normal(), rng.normal(size=(3, 3))
    ways = [at[0] @ turns[0], np.asarray(turns[1]), at[2] @ turns[2]]
    moves = [[h * way * (i == j) for j, way in enumerate(ways)] for i in range(3) for h in (1e-7, -1e-7)]
    ends = [jnp.asarray(np.stack([x + move[j] for move in moves])) for j, x in enumerate(at)]
    sides = np.asarray(each_answer()(jnp.broadcast_to(start, (6, 3)), *ends))
    for i, way in enumerate(ways):
        np.testing.assert_allclose(forward[i], reverse[i], atol=1e-9)
        slope = np.tensordot(forward[i], way, way.ndim)
        np.testing.assert_allclose(slope, (sides[2 * i] - sides[2 * i + 1]) / 2e-7, atol=1e-4, rtol=1e-5)
    assert all(np.any(leaf != 0) for leaf in forward)


# The price ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_step_has_as_many_equations_whatever_the_size():
    def program(mesh):
        return jax.make_jaxpr(lambda m, t, q: m.follow(t, q))(
            mesh, _outside(jnp.zeros(3)), jnp.zeros(3)
        ).jaxpr

    few, many = (hapjax.Mesh(*icosphere(n, 0.04)) for n in (1, 3))
    assert equations(program(few)) == equations(program(many))
    assert equations(program(mesh_of("notched"))) == equations(
        program(mesh_of("torus"))
    )  # these have hollows
