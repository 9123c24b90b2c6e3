"""Any two shapes against each other: they rest, they stack, they conserve momentum."""

import itertools

import equinox as eqx
import jax
import numpy as np
import pytest

import hapjax
import meshes
from helpers import G, away, matrix, moving, quaternion

MASS = 0.05
SLAB, BEAM = hapjax.Box((0.3, 0.3, 0.02)), hapjax.Box((0.2, 0.006, 0.01))
ACROSS = hapjax.Box((0.02, 0.2, 0.01))
BOX, BALL = hapjax.Box((0.06, 0.05, 0.04)), hapjax.Sphere(0.02)
CYLINDER, CAPSULE = hapjax.Cylinder(0.02, 0.05), hapjax.Capsule(0.015, 0.05)
LYING, LYING_X = quaternion((1, 0, 0), np.pi / 2), quaternion((0, 1, 0), np.pi / 2)
UPRIGHT = (1.0, 0.0, 0.0, 0.0)
TURNED = quaternion((0, 0, 1), 0.3)


def over(upper, turn, lower, lower_turn, gap, stiffness=2e3, damping: float | None = 2.0, mu=0.5, substeps=2):
    """A thing whose lowest point is `gap` above the origin's level, over a fixed one whose top is there."""
    reach = _reach(upper, turn)
    thing = hapjax.Object(upper, None, hapjax.Body(MASS), (0, 0, reach + gap), turn)
    below = hapjax.Object(lower, None, None, (0, 0, -_reach(lower, lower_turn)), lower_turn)
    pair = hapjax.Contact(stiffness, mu=mu, damping=damping, between=("it", "below"))
    world = hapjax.World((0, 0, -G), gyroscopic=True)
    integrator = hapjax.SemiImplicit(1e-3, substeps)
    return hapjax.Scene({"it": thing, "below": below}, {"pair": pair}, None, world, integrator)


def _reach(shape, turn):
    """How far a shape reaches in z from its origin: by sampling directions of its own frame."""
    up = matrix(turn)[2]
    if isinstance(shape, hapjax.Plane):
        return 0.0
    if isinstance(shape, hapjax.Box):
        return float(np.abs(up) @ np.asarray(shape.size) / 2)
    if isinstance(shape, hapjax.Sphere):
        return float(shape.radius)
    if isinstance(shape, hapjax.Mesh):
        return -float((np.asarray(shape.points()) @ up).min())
    along = abs(up[2]) * float(shape.length) / 2
    return along + float(shape.radius) * (1 if isinstance(shape, hapjax.Capsule) else np.hypot(*up[:2]))


def _centred(solid):
    """The mesh with its origin in its middle."""
    vertices, triangles = solid
    return vertices - (vertices.max(axis=0) + vertices.min(axis=0)) / 2, triangles


# The same box as a hull; a plate on two feet; a cube of twelve triangles.
HULL = hapjax.Convex(
    np.array([(x, y, z) for x in (-0.03, 0.03) for y in (-0.025, 0.025) for z in (-0.02, 0.02)])
)
TABLE = hapjax.Mesh(*_centred(meshes.voxels([(0, 0, 0), (2, 0, 0), (0, 0, 1), (1, 0, 1), (2, 0, 1)])))
BLOCK = hapjax.Mesh(*_centred(meshes.voxels([(0, 0, 0)], 0.1)))

RESTS = {
    "box on a thin beam": (BOX, TURNED, BEAM, UPRIGHT, 4),
    "box on a slab": (BOX, TURNED, SLAB, UPRIGHT, 4),
    "box on a cylinder": (BOX, TURNED, hapjax.Cylinder(0.02, 0.2), LYING, 2),
    "box on a capsule": (BOX, TURNED, hapjax.Capsule(0.02, 0.2), LYING, 2),
    "ball on a slab": (BALL, UPRIGHT, SLAB, UPRIGHT, 1),
    "cylinder upright on a slab": (CYLINDER, UPRIGHT, SLAB, UPRIGHT, 4),
    "cylinder upright on a thin beam": (CYLINDER, TURNED, BEAM, UPRIGHT, None),
    "cylinder lying on a slab": (CYLINDER, LYING, SLAB, UPRIGHT, 2),
    "cylinder lying on a plane": (CYLINDER, LYING, hapjax.Plane(), UPRIGHT, 2),
    "cylinder across a beam": (CYLINDER, LYING_X, ACROSS, UPRIGHT, 2),
    "cylinder across a cylinder": (CYLINDER, LYING_X, hapjax.Cylinder(0.02, 0.2), LYING, 1),
    "capsule on a plane": (CAPSULE, LYING, hapjax.Plane(), UPRIGHT, 2),
    "capsule on a slab": (CAPSULE, LYING, SLAB, UPRIGHT, 2),
    "capsule across a beam": (CAPSULE, LYING_X, ACROSS, UPRIGHT, 2),
    "capsule across a capsule": (CAPSULE, LYING_X, hapjax.Capsule(0.02, 0.2), LYING, 1),
    "hull on a thin beam": (HULL, TURNED, BEAM, UPRIGHT, 4),
    "hull on a plane": (HULL, TURNED, hapjax.Plane(), UPRIGHT, 4),
    "table on a slab": (TABLE, UPRIGHT, SLAB, UPRIGHT, 8),
    "ball on a hull": (BALL, UPRIGHT, BLOCK, UPRIGHT, 1),
    "capsule across a hull": (CAPSULE, LYING_X, HULL, UPRIGHT, 2),
    "capsule along a cylinder": (CAPSULE, LYING, hapjax.Cylinder(0.02, 0.2), LYING, 2),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", RESTS)
def test_what_is_let_fall_on_something_rests_there(case):
    upper, turn, lower, lower_turn, points = RESTS[case]
    scene = over(upper, turn, lower, lower_turn, 2e-3)
    hips = away(2500)
    state, replies = hapjax.rollout(scene, hapjax.init(scene, hips[0]), hips)
    motion, push = state.motion["it"], np.asarray(replies.contact["pair"].normal_force[-1])
    assert np.abs(motion.velocity).max() < 1e-7 and np.abs(motion.spin).max() < 1e-6
    assert push.sum() == pytest.approx(MASS * G, rel=1e-5)
    count = np.count_nonzero(push)
    assert points is None or count == points
    sunk = _reach(upper, turn) - float(motion.position[2])
    assert sunk == pytest.approx(MASS * G / (2e3 * count), rel=1e-4)


@pytest.mark.slow
def test_a_cube_falls_off_a_beam_that_is_not_under_its_centre():
    scene = over(BOX, UPRIGHT, BEAM, UPRIGHT, 1e-3)
    scene = eqx.tree_at(lambda s: s.object["below"].position, scene, replace_fn=lambda x: x.at[1].set(0.012))
    hips = away(1000)
    state, _ = hapjax.rollout(scene, hapjax.init(scene, hips[0]), hips)
    assert state.motion["it"].position[2] < -0.1


# Free against free ----------------------------------------------------------------------------------------

# A tetrahedron, off its origin: a mesh of few vertices, since each of them is looked for on the other surface.
WEDGE = hapjax.Mesh(
    [(-0.02, -0.02, -0.015), (0.035, -0.01, -0.015), (-0.01, 0.03, -0.015), (0.0, 0.0, 0.03)],
    [(0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3)],
)
FREE = {"box": BOX, "ball": BALL, "cylinder": CYLINDER, "capsule": CAPSULE, "mesh": WEDGE}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("first", "second"),
    [
        p
        for p in itertools.combinations_with_replacement(FREE, 2)
        if p not in (("mesh",) * 2, ("cylinder", "mesh"))
    ],
)
def test_a_collision_keeps_momentum_and_angular_momentum(first, second):
    bodies = hapjax.Body(0.1, inertia=(4e-5, 5e-5, 6e-5)), hapjax.Body(0.3, inertia=(2e-4, 1.5e-4, 1e-4))
    turns = quaternion((1, 2, 3), 0.8), quaternion((2, -1, 1), 1.7)
    objects = {
        "a": hapjax.Object(FREE[first], None, bodies[0], (0, 0.004, 0.08), turns[0]),
        "b": hapjax.Object(FREE[second], None, bodies[1], (0.003, 0, 0), turns[1]),
    }
    pair = hapjax.Contact(5e3, mu=0.5, damping=0.5, between=("a", "b"))
    scene = hapjax.Scene(
        objects, {"pair": pair}, None, hapjax.World(gyroscopic=True), hapjax.SemiImplicit(1e-4)
    )
    state = moving(hapjax.init(scene, away(1)[0]), "a", velocity=(0, 0, -0.6), spin=(3.0, -2.0, 4.0))
    after, replies = hapjax.rollout(scene, state, away(1500))
    assert np.max(replies.contact["pair"].normal_force) > 1
    assert float(after.motion["b"].velocity[2]) < -0.05  # it was hit, and driven on

    def momenta(state):
        linear, angular = np.zeros(3), np.zeros(3)
        for (name, body), shape in zip(zip("ab", bodies, strict=True), (first, second), strict=True):
            m = jax.tree.map(np.asarray, state.motion[name])
            turn, middle = matrix(m.orientation), FREE[shape].centre()
            place = m.position if middle is None else m.position + turn @ np.asarray(middle)
            linear += float(body.mass) * m.velocity
            angular += float(body.mass) * np.cross(place, m.velocity)
            angular += turn @ (np.asarray(body.inertia) * (turn.T @ m.spin))
        return linear, angular

    (linear, angular), (linear_after, angular_after) = momenta(state), momenta(after)
    assert linear_after == pytest.approx(linear, abs=1e-12)
    # Semi-implicit Euler turns a spinning body's angular momentum a little, with or without a collision.
    assert angular_after == pytest.approx(angular, abs=2e-3 * float(np.linalg.norm(angular)))


@pytest.mark.slow
def test_names_in_the_other_order_are_the_same_contact():
    paths = []
    for between in (("it", "below"), ("below", "it")):
        scene = over(BOX, TURNED, BEAM, UPRIGHT, 1e-3)
        pair = hapjax.Contact(2e3, mu=0.5, damping=2.0, between=between)
        scene = hapjax.Scene(scene.object, {"pair": pair}, None, scene.world, scene.integrator)
        paths.append(hapjax.rollout(scene, hapjax.init(scene, away(1)[0]), away(300))[1].pose)
    assert paths[0] == pytest.approx(np.asarray(paths[1]), abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("other", ["capsule", "ball", "plane"])
def test_a_smooth_mesh_that_has_no_edges_touches_by_its_vertices(other):
    shape = {**FREE, "plane": hapjax.Plane()}[other]
    smooth = hapjax.Mesh(*meshes.icosphere(3, 0.02))
    objects = {
        "it": hapjax.Object(smooth, None, hapjax.Body(MASS), (0, 0, _reach(shape, UPRIGHT) + 0.0198)),
        "below": hapjax.Object(shape),
    }
    pair = hapjax.Contact(2e3, mu=0.5, between=("it", "below"))
    scene = hapjax.Scene(objects, {"pair": pair})
    assert smooth.edges() is None
    state = moving(hapjax.init(scene, away(1)[0]), "it", velocity=(0, 0, -0.1))
    _, replies = hapjax.rollout(scene, state, away(4))
    assert replies.contact["pair"].normal_force[-1].sum() > 0


@pytest.mark.slow
def test_damping_slows_a_box_that_slides_over_crossing_edges():
    """Held by springs alone it swings on and on; the damper at its crossings takes that away."""
    left = {}
    for damping in (None, 3.0):
        scene = over(BOX, TURNED, BEAM, UPRIGHT, 1e-5, damping=damping, mu=5.0)
        state = moving(hapjax.init(scene, away(1)[0]), "it", velocity=(2e-3, 2e-3, 0))
        _, replies = hapjax.rollout(scene, state, away(1500))
        left[damping] = np.ptp(np.asarray(replies.pose)[-300:, 0, :2])
    assert left[3.0] < 0.5 * left[None]


@pytest.mark.slow
def test_a_box_that_slides_along_a_beams_edges_is_slowed_by_the_kinetic_mu():
    """v = v0 - mu_k g t, in steps so short that the springs come nowhere near the static mu again."""
    static, kinetic, v0, dt = 0.5, 0.3, 0.1, 1e-4
    scene = over(BOX, UPRIGHT, BEAM, UPRIGHT, -MASS * G / (4 * 2e3), damping=None)
    body = hapjax.Body(MASS, rotation=False)
    thing = hapjax.Object(BOX, None, body, scene.object["it"].position)
    pair = hapjax.Contact(2e3, mu_static=static, mu_kinetic=kinetic, between=("it", "below"))
    assert v0 * dt * 2e3 < (static - kinetic) * MASS * G / 4
    objects = {"it": thing, "below": scene.object["below"]}
    scene = hapjax.Scene(objects, {"pair": pair}, None, hapjax.World((0, 0, -G)), hapjax.SemiImplicit(dt))
    state = moving(hapjax.init(scene, away(1)[0]), "it", velocity=(v0, 0, 0))
    _, replies = hapjax.rollout(scene, state, away(200))
    x = np.asarray(replies.pose[:, 0, 0])
    slowed = np.diff(x[[50, 51, 198, 199]])[[0, 2]] / dt  # once the springs are stretched
    assert (slowed[0] - slowed[1]) / (148 * dt) == pytest.approx(kinetic * G, rel=1e-3)


# Restitution ----------------------------------------------------------------------------------------------


def rebound(c, v):
    """Speed after a bounce: e from c v - ln(1 + c v) = -c e v - ln(1 - c e v), which equates the springs' work."""
    from scipy.optimize import brentq

    def balance(e):
        return (c * v - np.log1p(c * v)) - (-c * e * v - np.log1p(-c * e * v))

    return v * brentq(balance, 0.0, min(1.0, (1 - 1e-12) / (c * v)))


@pytest.mark.parametrize(("damping", "speed"), [(0.2, 0.5), (1.0, 0.5), (1.0, 2.0), (3.0, 1.0)])
def test_restitution_is_what_the_loss_says(damping, speed):
    """m v dv = -k d (1 + c v) dd, integrated on the way in and on the way out."""
    ball = hapjax.Object(BALL, None, hapjax.Body(MASS, rotation=False), (0, 0, 0.02))
    pair = hapjax.Contact(5e3, mu=0.0, damping=damping, between=("it", "floor"))
    scene = hapjax.Scene(
        {"it": ball, "floor": hapjax.Object(hapjax.Plane())},
        {"pair": pair},
        integrator=hapjax.SemiImplicit(1e-5),
    )
    state = moving(hapjax.init(scene, away(1)[0]), "it", velocity=(0, 0, -speed))
    state, _ = hapjax.rollout(scene, state, away(4000))
    assert state.motion["it"].velocity[2] == pytest.approx(rebound(damping, speed), rel=2e-3)
