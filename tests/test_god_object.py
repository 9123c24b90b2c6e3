"""A finger on a fixed surface, against an oracle written from the rule's definition in NumPy.

The oracle is MHS section 2 with static and kinetic friction and Hunt-Crossley damping, one finger and one
step at a time: with damping the friction circle has the radius mu f_n / k, and both shares of the tangential
pull count.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

import hapjax
from helpers import matrix, quaternion

FAR = 1e-12  # m
WEAK = 1e-9  # N


# The oracle -----------------------------------------------------------------------------------------------


def plane_below(h):
    return np.array([h[0], h[1], 0.0]), np.array([0.0, 0.0, 1.0]), -h[2], 0


def ball_around(radius):
    def closest(h):
        n = h / np.linalg.norm(h)
        return radius * n, n, radius - np.linalg.norm(h), 0

    return closest


def box_around(size):
    def closest(h):
        # The six half-spaces of which the box is the intersection.
        depths = [size[i] / 2 - sign * h[i] for i in range(3) for sign in (1, -1)]
        face = int(np.argmin(depths))
        n = np.zeros(3)
        n[face // 2] = 1 - 2 * (face % 2)
        return h + depths[face] * n, n, depths[face], face

    return closest


def oracle(closest, path, dt, stiffness, static, kinetic=None, damping=0.0):
    """God-objects and forces on the finger along `path` (T, 3), and the mu and normal force of each step."""
    static = np.broadcast_to(static, 6)
    kinetic = static if kinetic is None else np.broadcast_to(kinetic, 6)
    god, touching, sliding, before = path[0], False, False, path[0]
    out = []
    for h in path:
        velocity, before = (h - before) / dt, h
        s, n, depth, face = closest(h)
        if depth <= 0:
            god, touching, sliding = h, False, False
            out.append((god, np.zeros(3), static[face], 0.0))
            continue
        approach = -(velocity @ n)
        normal = max(0.0, stiffness * depth * (1 + damping * approach))
        drawn = god - s if touching else np.zeros(3)
        drawn = drawn - (drawn @ n) * n
        slip = velocity + approach * n
        reach = drawn - damping * depth * slip  # the offset that would explain the whole pull
        length = np.linalg.norm(reach)
        radius = (kinetic if sliding else static)[face] * normal / stiffness
        slack = 1e-14 if sliding else 0.0  # m: stopped means within the circle up to rounding
        sliding = bool(length > radius + slack)
        if sliding:
            radius = kinetic[face] * normal / stiffness
            reach = reach / length * radius
            drawn = drawn * min(1.0, radius / max(np.linalg.norm(drawn), 1e-300))
        god, touching = s + drawn, True
        out.append((god, normal * n + stiffness * reach, static[face], normal))
    return [np.array(x) for x in zip(*out, strict=True)]


# The comparison -------------------------------------------------------------------------------------------


def walk(scene, path):
    """Forces (world frame), touches and god-objects at every step of one finger's path (T, 3)."""
    path = jnp.asarray(path, hapjax.scene.dtype_of(scene))
    return jax.tree.map(np.asarray, _walk(scene, path))


@jax.jit
def _walk(scene, path):
    def one(state, hip):
        state, reply = hapjax.step(scene, state, hip[None])
        return state, (reply.force[0], reply.touch["it"], state.finger["it"].point[0])

    return jax.lax.scan(one, hapjax.init(scene, path[:1]), path)[1]


def agree(scene, closest, path, world=None, **numbers):
    """Walk `path` (in the shape's frame) and compare with the oracle; returns the oracle's answer."""
    turn, shift = (np.eye(3), np.zeros(3)) if world is None else world
    force, touch, point = walk(scene, path @ turn.T + shift)
    god, expected, mu, normal = oracle(closest, path, float(scene.integrator.dt), **numbers)
    assert np.abs(point - god).max() < FAR
    assert np.abs(force - expected @ turn.T).max() < WEAK
    tangential = np.linalg.norm(touch.friction_force[:, 0], axis=-1)
    assert np.all(tangential <= mu * touch.normal_force[:, 0] * (1 + 4e-16) + 1e-15)
    assert np.abs(touch.normal_force[:, 0] - normal).max() < WEAK
    return god, expected, normal


def surface(stiffness, static, kinetic=None, damping=0.0):
    damping = None if damping == 0 else damping
    if kinetic is None:
        return hapjax.Surface(stiffness, mu=static, damping=damping)
    return hapjax.Surface(stiffness, mu_static=static, mu_kinetic=kinetic, damping=damping)


def scene_of(shape, numbers, position=(0.0, 0.0, 0.0), orientation=(1.0, 0.0, 0.0, 0.0)):
    return hapjax.Scene(object={"it": hapjax.Object(shape, surface(**numbers), None, position, orientation)})


def wander(seed, steps=400, depth=2e-3, speed=2e-4):
    """A path over a plane that slides, turns, rests, lifts off and touches again."""
    rng = np.random.default_rng(seed)
    lateral = np.cumsum(speed * rng.standard_normal((steps, 2)) + speed * rng.standard_normal(2), axis=0)
    height = -depth + depth * np.sin(np.arange(steps) / 40 + rng.uniform(0, 7)) * 1.2
    height = height + 0.02 * depth * rng.standard_normal(steps)
    path = np.column_stack([lateral, height]) + [*rng.uniform(-0.2, 0.2, 2), 0]
    for _ in range(4):  # rests
        begin = rng.integers(0, steps - 30)
        path[begin : begin + 30] = path[begin]
    return path


LAWS = {
    "one mu": dict(stiffness=800.0, static=0.61),
    "damped": dict(stiffness=800.0, static=0.61, damping=1.3),
    "static and kinetic": dict(stiffness=2000.0, static=0.83, kinetic=0.47),
    "all": dict(stiffness=2000.0, static=0.83, kinetic=0.47, damping=0.8),
    "no friction": dict(stiffness=800.0, static=0.0),
    "no friction, damped": dict(stiffness=800.0, static=0.0, damping=1.3),
}


@pytest.mark.parametrize("law", LAWS)
def test_wandering_finger_obeys_the_rule_on_a_plane(law):
    numbers = LAWS[law]
    scene = scene_of(hapjax.Plane(), numbers)
    touched = lifted = slid = 0
    for seed in range(30):
        god, force, normal = agree(scene, plane_below, wander(seed), **numbers)
        touched += np.sum(normal > 0)
        lifted += np.sum(normal == 0)
        slid += np.sum((np.linalg.norm(np.diff(god[:, :2], axis=0), axis=1) > 1e-9) & (normal[1:] > 0))
    assert touched > 4000 and lifted > 1000 and slid > 500  # the paths exercise what they should


@pytest.mark.parametrize("law", ["damped", "static and kinetic"])
@settings(max_examples=60)
@given(
    moves=hnp.arrays(np.int64, (40, 3), elements=st.integers(-300, 300)),
    numbers=st.tuples(st.floats(10, 5000), st.floats(0, 2), st.floats(0, 1), st.floats(0.01, 3)),
)
def test_any_path_obeys_the_rule(law, moves, numbers):
    stiffness, mu, ratio, damping = numbers
    numbers = dict(stiffness=stiffness, static=mu)
    if law == "damped":
        numbers["damping"] = damping
    else:
        # Rounding would decide an exact tie of |g - s| with mu_static d: points on a grid never reach it.
        numbers["static"], numbers["kinetic"] = mu + 0.01 / np.pi, mu * ratio
    path = np.cumsum(moves, axis=0) * 1e-6 + [0.01, 0.02, 0]
    agree(scene_of(hapjax.Plane(), numbers), plane_below, path, **numbers)


POSE = dict(position=(0.31, -0.22, 0.13), orientation=quaternion((1, -2, 0.5), 1.9))
POSED = (matrix(POSE["orientation"]), np.array(POSE["position"]))


def test_plane_at_a_pose():
    scene = scene_of(hapjax.Plane(), LAWS["all"], **POSE)
    for seed in range(5):
        agree(scene, plane_below, wander(seed), POSED, **LAWS["all"])


def test_box_at_a_pose_has_a_mu_on_each_face():
    static = np.array([0.31, 0.42, 0.53, 0.64, 0.75, 0.86])
    numbers = dict(stiffness=900.0, static=static, kinetic=static * 0.7, damping=0.6)
    size = (0.06, 0.08, 0.1)
    scene = scene_of(hapjax.Box(size), numbers, **POSE)
    for face in range(6):
        axis, sign = face // 2, 1 - 2 * (face % 2)
        seen = wander(face)
        path = np.empty_like(seen)
        path[:, axis] = sign * (size[axis] / 2 + seen[:, 2])
        path[:, (axis + 1) % 3] = seen[:, 0] - seen[:, 0].mean()
        path[:, (axis + 2) % 3] = seen[:, 1] - seen[:, 1].mean()
        path = path[np.all(np.abs(path[:, [(axis + 1) % 3, (axis + 2) % 3]]) < 0.025, axis=1)]
        assert len(path) > 200
        path = np.concatenate([path, np.tile(path[-1:], (len(seen) - len(path), 1))])
        agree(scene, box_around(size), path, POSED, **numbers)


def test_ball_at_a_pose():
    numbers = LAWS["all"]
    scene = scene_of(hapjax.Sphere(0.05), numbers, **POSE)
    for seed in range(5):
        flat = wander(seed)
        lon, lat = ((flat[:, :2] - flat[0, :2]) / 0.05).T
        out = np.column_stack([np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)])
        agree(scene, ball_around(0.05), out * (0.05 + flat[:, 2:]), POSED, **numbers)


# The rule's consequences ----------------------------------------------------------------------------------


@pytest.mark.parametrize("damping", [0.0, 1.0])
@pytest.mark.parametrize("place", [0.0, 0.4, -3.0])
def test_rest_after_a_slide_restores_static_grip(damping, place, dtype):
    static, kinetic, depth = 0.8, 0.5, 2e-3
    ulp = float(jnp.finfo(dtype).eps) * max(abs(place), 8e-3)
    objects = {"it": hapjax.Object(hapjax.Plane(), surface(1000.0, static, kinetic, damping))}
    # The pull back is slow, so that with damping the viscous share stays small against the margin.
    scene = hapjax.cast(hapjax.Scene(objects, integrator=hapjax.SemiImplicit(dt=1.0)), dtype)
    slide = np.linspace(0, 8e-3, 60)
    reach = (static - kinetic) * depth  # what the grip still gives beyond the kinetic circle's edge
    margin = 1e-3 if dtype == np.float64 else 1e-2
    holds, breaks = slide[-1] + (1 - margin) * reach, slide[-1] + (1 + margin) * reach
    creep = np.linspace(slide[-1], holds, 20)
    x = np.concatenate([slide, np.full(5, slide[-1]), creep, np.full(5, holds), np.full(5, breaks)])
    _, _, point = walk(
        scene, np.column_stack([place + x, np.full_like(x, 0.3 * place), np.full_like(x, -depth)])
    )
    god = point[:, 0].astype(float) - place
    assert god[len(slide) + 1] == pytest.approx(slide[-1] - kinetic * depth, abs=10 * ulp)
    assert np.ptp(god[len(slide) : -5]) < 20 * ulp  # held
    assert god[-1] == pytest.approx(breaks - kinetic * depth, abs=10 * ulp)


def test_without_rest_the_grip_stays_kinetic():
    scene = scene_of(hapjax.Plane(), dict(stiffness=1000.0, static=0.8, kinetic=0.5))
    x = np.linspace(0, 2e-2, 200)
    force, _, _ = walk(scene, np.column_stack([x, 0 * x, 0 * x - 2e-3]))
    drag = -force[:, 0]
    first = int(np.argmax(np.diff(drag) < 0))
    assert 0.5 * 2 < drag[first] <= 0.8 * 2
    assert drag[first + 1 :] == pytest.approx(0.5 * 2, abs=1e-12)


def test_first_touch_has_no_offset_and_no_touch_no_force():
    scene = scene_of(hapjax.Plane(), dict(stiffness=1000.0, static=0.8))
    path = np.array([[0.0, 0, 1e-3], [1e-2, 0, 0.0], [2e-2, 0, -1e-3], [2e-2, 0, 1e-3], [5e-2, 0, -2e-3]])
    force, _, point = walk(scene, path)
    assert np.array_equal(force[:2], np.zeros((2, 3)))
    assert force[2:] == pytest.approx(np.array([[0, 0, 1.0], [0, 0, 0], [0, 0, 2.0]]), abs=1e-12)
    assert np.array_equal(point[[0, 1, 3]], path[[0, 1, 3]])


def test_a_step_keeps_the_cone_and_the_precision(dtype):
    numbers = LAWS["damped"]
    scene = hapjax.cast(scene_of(hapjax.Plane(), numbers), dtype)
    path = wander(3, 200).astype(dtype)
    force, touch, point = walk(scene, path)
    assert force.dtype == point.dtype == dtype
    tangential = np.linalg.norm(touch.friction_force[:, 0], axis=-1)
    limit = numbers["static"] * touch.normal_force[:, 0]
    eps = float(jnp.finfo(dtype).eps)
    assert np.all(tangential <= limit * (1 + 4 * eps)) and np.any(tangential > 0.5 * limit)
    _, expected, _, _ = oracle(plane_below, path.astype(float), 1e-3, **numbers)
    assert np.abs(force - expected).max() < 1e4 * eps
