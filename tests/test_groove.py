"""Round shapes in the hollows of a mesh: they touch several walls at once, and rest."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import trimesh

import hapjax
from hapjax import walls
from helpers import G, away, moving, quaternion
from meshes import grooved, icosphere, inside, notched, torus

MASS, K, R = 0.05, 2e3, 0.015
ALONG = quaternion((1, 0, 0), np.pi / 2)  # the axis of a capsule or a cylinder along y


def in_groove(shape, angle, mu=0.5, damping: float | None = 3.0, integrator=None, sunk=1e-4):
    """A round thing in the middle of a groove, a little deeper than it would touch."""
    high = R / np.sin(np.radians(angle) / 2) - sunk
    it = hapjax.Object(shape, None, hapjax.Body(MASS), (0, 0, high), ALONG)
    pair = hapjax.Contact(K, mu=mu, damping=damping, between=("it", "groove"))
    objects = {"it": it, "groove": hapjax.Object(hapjax.Mesh(*grooved(angle)))}
    return hapjax.Scene(
        objects,
        {"pair": pair},
        None,
        hapjax.World((0, 0, -G), True),
        integrator or hapjax.SemiImplicit(1e-3, 2),
    )


def play(scene, steps, **start):
    """The last state and all replies, in NumPy."""
    hips = away(steps).astype(hapjax.scene.dtype_of(scene))
    state = moving(hapjax.init(scene, hips[0]), "it", **start)
    return jax.tree.map(np.asarray, hapjax.rollout(scene, state, hips))


BALL = in_groove(hapjax.Sphere(R), 90)


@pytest.mark.slow
def test_a_ball_in_a_groove_rests_on_both_walls(dtype):
    """Without friction each bears m g / (2 sin 45), and the centre is r - N / k from each."""
    scene = hapjax.cast(eqx.tree_at(lambda s: s.contact["pair"].mu, BALL, jnp.zeros(())), dtype)
    state, reply = play(scene, 600)
    push, each = reply.contact["pair"].normal_force[-1], MASS * G / np.sqrt(2)
    np.testing.assert_allclose(np.sort(push), [0, each, each], rtol=2e-3, atol=1e-9)
    assert np.abs(state.motion["it"].velocity).max() < 5e-4
    assert state.motion["it"].position[2] == pytest.approx((R - each / K) * np.sqrt(2), abs=2e-6)
    # With friction both hold it still.
    if dtype == jnp.float64:
        state, reply = play(BALL, 600)
        assert np.abs(state.motion["it"].velocity).max() < 1e-5
        assert np.count_nonzero(reply.contact["pair"].normal_force[-1]) == 2


@pytest.mark.slow
def test_a_ball_rolls_down_a_groove_as_it_should():
    """a = g sin b / (1 + 2/5 / sin^2 45): it turns about the line of its contacts, r sin 45 below its centre."""
    slope, steps = np.radians(10), 600
    gravity = jnp.array([0, -G * np.sin(slope), -G * np.cos(slope)])
    scene = eqx.tree_at(lambda s: s.world.gravity, BALL, gravity)
    _, reply = play(scene, steps)
    y = reply.pose[:, 0, 1]
    found = (y[-1] - 2 * y[steps - 201] + y[steps - 401]) / 0.2**2
    assert found == pytest.approx(-G * np.sin(slope) / (1 + 0.8), rel=5e-3)
    assert np.all(np.count_nonzero(reply.contact["pair"].normal_force[100:], axis=1) == 2)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shape", "angle", "points"),
    [(hapjax.Capsule(R, 0.04), 60, 4), (hapjax.Cylinder(R, 0.04), 60, 4)],
)
def test_round_things_in_grooves_of_other_angles_rest(shape, angle, points):
    state, reply = play(in_groove(shape, angle), 500, position=(2e-4, 0, R / np.sin(np.radians(angle) / 2)))
    motion = state.motion["it"]
    assert np.abs(motion.velocity).max() < 5e-4 and np.abs(motion.spin).max() < 5e-2
    assert np.count_nonzero(reply.contact["pair"].normal_force[-1]) == points
    np.testing.assert_allclose(
        reply.contact["pair"].force[-1].sum(axis=0), [0, 0, MASS * G], atol=0.02 * MASS * G
    )


@pytest.mark.slow
def test_a_ball_in_a_corner_rests_on_three_walls_without_having_touched_all():
    """Three planes at right angles, the corner straight down: each bears m g / sqrt 3. The step is long and looks ahead."""
    corner = hapjax.Mesh(*notched())
    down = quaternion((1, -1, 0), np.arccos(1 / np.sqrt(3)))
    it = hapjax.Object(hapjax.Sphere(0.01), None, hapjax.Body(MASS), (0, 0, 0.055))
    scene = dataclasses.replace(
        BALL,
        object={"it": it, "groove": hapjax.Object(corner, orientation=down)},
        integrator=hapjax.Implicit(5e-3),
    )
    scene = eqx.tree_at(lambda s: s.contact["pair"].mu, scene, jnp.zeros(()))
    state, reply = play(scene, 200)
    np.testing.assert_allclose(reply.contact["pair"].normal_force[-1], MASS * G / np.sqrt(3), rtol=1e-3)
    assert np.abs(state.motion["it"].velocity).max() < 1e-6


@pytest.mark.slow
def test_walls_are_those_of_brute_force():
    """Places that no triangle at them undercuts, above the planes of those nearer; a plane or a bulge has one."""
    rng, reach = np.random.default_rng(3), 0.02
    for vertices, triangles in (notched(), torus(), grooved(70)):
        mesh, corners = hapjax.Mesh(vertices, triangles), vertices[triangles]
        solid = trimesh.Trimesh(vertices, triangles)
        low, high = vertices.min(axis=0) - 0.005, vertices.max(axis=0) + 0.005
        queries = rng.uniform(low, high, (25, 3))
        queries = queries[~inside(vertices, triangles, queries)]
        near, found = jax.jit(lambda q, m=mesh: jax.lax.map(lambda c: m.walls(c, jnp.asarray(reach)), q))(
            queries
        )
        counts = []
        for i, query in enumerate(queries):
            truth = _walls(corners, solid.face_normals, query, reach)
            got = np.asarray(near.point[i])[np.asarray(found[i])] - query
            got = got[np.linalg.norm(got, axis=1) < reach]
            np.testing.assert_allclose(got, np.reshape(truth[:3], (-1, 3)), atol=1e-12)
            counts.append(len(got))
        assert max(counts) >= 2 and min(counts) <= 1
    assert hapjax.Mesh(*grooved(70)).is_hollow and not hapjax.Mesh(*icosphere(2, 0.03)).is_hollow


def _walls(corners, normals, query, reach):
    """Ways from a query to its walls, by trimesh's closest points of all triangles."""
    point = trimesh.triangles.closest_point(corners, np.tile(query, (len(corners), 1)))
    far, found = np.linalg.norm(point - query, axis=1), []
    for i in np.argsort(far):
        way = point[i] - query
        if far[i] > reach:
            break
        at = np.linalg.norm(
            trimesh.triangles.closest_point(corners, np.tile(point[i], (len(corners), 1))) - point[i], axis=1
        )
        at = at < 1e-9
        if far[at].min() < far[i] - 1e-12 or np.sum(normals[at], axis=0) @ way > 0:
            continue
        if all(way @ other < other @ other * (1 - 3e-5) for other in found):
            found.append(way)
    return found


def test_the_force_of_walls_that_bend_by_little_does_not_jump_and_has_a_potential():
    """What pushes a ball's centre about among three planes: continuous on a way, its derivative symmetric."""
    rng = np.random.default_rng(4)

    @jax.jit
    @jax.vmap
    def force(place, normals):
        far = normals @ place
        order = jnp.argsort(far)
        normals, far = normals[order], far[order]
        share, counts = walls._shared(normals, R - far, jnp.ones(3, bool), jnp.asarray(R))
        return jnp.where(counts, jnp.maximum(share, 0), 0) @ normals

    # Three facets of a bowl about a corner of it, bent by 3 to 20 degrees.
    around = np.array([0, 2, 4]) * np.pi / 3 + rng.uniform(-0.3, 0.3, (300, 3))
    tilt = np.radians(rng.uniform(3, 20, (300, 3)))
    normals = np.stack([np.sin(tilt) * np.cos(around), np.sin(tilt) * np.sin(around), np.cos(tilt)], axis=2)
    ends = rng.normal(size=(2, 300, 3)) * [R / 5, R / 5, R / 50] + [0, 0, R * 0.98]
    length = np.linalg.norm(ends[1] - ends[0], axis=1)
    path = ends[0] + np.linspace(0, 1, 400)[:, None, None] * (ends[1] - ends[0])
    forces = np.asarray(jax.lax.map(lambda p: force(p, normals), path))
    # But where one facet of three no longer is a wall for itself, yet what it has at its borders still counts: that is rare.
    steps = np.linalg.norm(np.diff(forces, axis=0), axis=2).max(axis=0)
    assert np.mean(steps < 2 * length / 399) > 0.98
    slope = jax.vmap(jax.jacfwd(lambda p, n: force(p[None], n[None])[0]))(path[200], normals)
    assert np.mean(np.abs(slope - np.swapaxes(slope, 1, 2)).max(axis=(1, 2)) < 1e-9) > 0.95
    assert np.sum(np.linalg.norm(forces[200], axis=1) > 0) > 100


@pytest.mark.slow
def test_derivatives_of_a_ball_in_a_groove_are_the_true_ones():
    """After a step from rest v_z = dt / m (2 k (r - z sin a) sin a - m g), with a = 45 degrees."""
    dt, high = 1e-3, R * np.sqrt(2) - 3e-4
    scene = dataclasses.replace(
        in_groove(hapjax.Sphere(R), 90, 0.0, None), integrator=hapjax.SemiImplicit(dt)
    )

    hips = away(1)
    rest = hapjax.init(scene, hips[0])

    def speed(numbers):
        radius, stiffness, z = numbers
        now = eqx.tree_at(
            lambda s: (s.object["it"].shape.radius, s.contact["pair"].stiffness), scene, (radius, stiffness)
        )
        state = eqx.tree_at(lambda s: s.motion["it"].position, rest, jnp.stack([0 * z, 0 * z, z]))
        return hapjax.step(now, state, hips[0])[0].motion["it"].velocity[2]

    at, sine = jnp.array([R, K, high]), np.sqrt(0.5)
    depth = R - high * sine
    truth = dt / MASS * np.array([2 * K * sine, 2 * depth * sine, -2 * K * sine**2])
    modes = jax.value_and_grad(speed), jax.jacfwd(speed)
    (value, reverse), forward = jax.jit(lambda at: [mode(at) for mode in modes])(at)
    assert value == pytest.approx(dt * (2 * K * depth * sine / MASS - G), rel=1e-9)
    for found in (forward, reverse):
        np.testing.assert_allclose(found, truth, rtol=1e-6)


@pytest.mark.parametrize(
    "other", [hapjax.Sphere(0.03), pytest.param(hapjax.Mesh(*icosphere(3, 0.03)), marks=pytest.mark.slow)]
)
def test_a_ball_that_rolls_over_something_round_without_slip_has_no_friction(other):
    """Where it touches goes a part of the way of its centre, on both; what friction holds is the material."""
    it = hapjax.Object(hapjax.Sphere(R), None, hapjax.Body(MASS), (0, 0, 0.03 + R - 2e-4))
    pair = hapjax.Contact(K, mu=0.5, between=("it", "below"))
    scene = hapjax.Scene({"it": it, "below": hapjax.Object(other)}, {"pair": pair})
    scene = dataclasses.replace(scene, integrator=hapjax.SemiImplicit(1e-4))
    v = 0.1
    _, reply = play(scene, 40, velocity=(v, 0, 0), spin=(0, v / R, 0))
    pressed = reply.contact["pair"].normal_force
    assert np.all(pressed.max(axis=1)[:20] > 0.1)
    friction = np.linalg.norm(reply.contact["pair"].friction_force, axis=-1)
    assert friction.max() < 0.02 * 0.5 * pressed.max()
