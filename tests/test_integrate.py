"""Convergence of the integrators at their order, against solutions that do not come from them."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation

import hapjax
from hapjax.body import Motion, Wrench
from helpers import G, angle_between, at_rest, away, matrix, moving, order, quaternion

METHODS = [hapjax.SemiImplicit, hapjax.SemiImplicitMatrix, hapjax.PivotForm]
STEPS = [2e-3, 1e-3, 5e-4, 2.5e-4]
FINGER = hapjax.Surface(800.0, mu=2.0)


def brick(body, method=hapjax.SemiImplicit, world=None, **place):
    thing = hapjax.Object(hapjax.Box((0.06, 0.04, 0.08)), FINGER, body, **place)
    return hapjax.Scene(object={"it": thing}, world=world or hapjax.World(), integrator=method())


@jax.jit
def final(scene, state, steps, dt, hip):
    """The motion after a number of steps with the fingers at rest."""
    return jax.lax.fori_loop(0, steps, lambda _, s: hapjax.step(scene, s, hip, dt)[0], state).motion["it"]


def run(scene, seconds, dt, hip=None, **start):
    hip = away(1)[0] if hip is None else jnp.asarray(hip)
    return final(
        scene, moving(hapjax.init(scene, hip), "it", **start), round(seconds / dt), jnp.asarray(dt), hip
    )


# Free fall ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_free_fall(method):
    scene = brick(hapjax.Body(0.2), method, hapjax.World(gravity=(0, 0, -G)))
    start, velocity = np.zeros(3), np.array([0.3, -0.1, 2.0])
    truth = start + velocity * 0.5 + 0.5 * np.array([0, 0, -G]) * 0.25
    ends = [run(scene, 0.5, dt, velocity=velocity) for dt in STEPS]
    assert ends[-1].velocity == pytest.approx(velocity - [0, 0, G * 0.5], abs=1e-12)
    assert order(STEPS, [np.linalg.norm(e.position - truth) for e in ends]) == pytest.approx(1, abs=1e-3)


# A torque-free top ----------------------------------------------------------------------------------------

SPIN = np.array([0.5, 6.0, 0.3])  # nearly about the middle axis: the hardest case
PLACE = dict(position=(0.1, 0.2, 0.3), orientation=quaternion((1, 1, 0), 0.7))
CENTRE = np.array([0.012, -0.02, 0.007])


@functools.cache
def top_truth(seconds):
    """Orientation and spin by Dormand-Prince of order 8, from L = R J R' w that does not change."""
    inertia, start = np.array([1.0, 2.0, 3.0]) * 1e-4, np.array(PLACE["orientation"])
    momentum = matrix(start) @ (inertia * (matrix(start).T @ SPIN))

    def spin_of(q):
        turn = Rotation.from_quat(q, scalar_first=True).as_matrix()
        return turn @ ((turn.T @ momentum) / inertia)

    def rate(_, q):
        w, x, y, z = q
        left = np.array([[-x, -y, -z], [w, z, -y], [-z, w, x], [y, -x, w]])
        return 0.5 * left @ spin_of(q)

    q = solve_ivp(rate, (0, seconds), start, method="DOP853", rtol=1e-12, atol=1e-13).y[:, -1]
    return q, spin_of(q), momentum


def top(method, gyroscopic=True):
    body = hapjax.Body(0.2, inertia=np.array([1.0, 2.0, 3.0]) * 1e-4, centre=CENTRE)
    return brick(body, method, hapjax.World(gyroscopic=gyroscopic), **PLACE)


@pytest.mark.parametrize("method", METHODS)
def test_torque_free_top(method):
    orientation, spin, _ = top_truth(1.0)
    ends = [run(top(method), 1.0, dt, spin=SPIN) for dt in STEPS]
    turned = [angle_between(e.orientation, orientation) for e in ends]
    assert order(STEPS, turned) == pytest.approx(1, abs=0.1) and turned[-1] < 0.02
    assert order(STEPS, [np.linalg.norm(e.spin - spin) for e in ends]) == pytest.approx(1, abs=0.1)


@pytest.mark.parametrize("axis", [(1, 0, 0), (0.3, -0.5, 0.8)])
def test_the_matrix_form_is_that_of_the_paper_with_its_factors_in_order(axis):
    dt, spin = 0.05, 8.0 * np.array(axis)
    end = run(top(hapjax.SemiImplicitMatrix, False), dt, dt, spin=spin)
    x, y, z = spin
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    # Gram-Schmidt on the columns is the QR factorisation with a positive diagonal.
    q, r = np.linalg.qr((np.eye(3) + dt * skew) @ matrix(PLACE["orientation"]))
    assert matrix(end.orientation) == pytest.approx(q * np.sign(np.diag(r)), abs=1e-12)


@pytest.mark.parametrize("method", METHODS)
def test_centre_of_mass_goes_straight_on_while_the_body_turns(method):
    velocity = np.array([0.2, 0.0, -0.1])
    end = run(top(method), 1.0, 1e-3, spin=SPIN, velocity=velocity)
    centre = PLACE["position"] + matrix(PLACE["orientation"]) @ CENTRE + velocity
    assert end.position + matrix(end.orientation) @ CENTRE == pytest.approx(centre, abs=1e-12)
    assert np.linalg.norm(end.orientation) == pytest.approx(1, abs=1e-14)


def test_without_the_gyroscopic_term_the_spin_stays():
    truth = Rotation.from_rotvec(SPIN) * Rotation.from_quat(PLACE["orientation"], scalar_first=True)
    ends = [run(top(hapjax.SemiImplicit, False), 1.0, dt, spin=SPIN) for dt in STEPS]
    for end in ends:  # the exponential map is exact for a constant spin
        assert np.array_equal(end.spin, SPIN)
        assert angle_between(end.orientation, truth.as_quat(scalar_first=True)) < 1e-11
    ends = [run(top(hapjax.SemiImplicitMatrix, False), 1.0, dt, spin=SPIN) for dt in STEPS]
    errors = [angle_between(e.orientation, truth.as_quat(scalar_first=True)) for e in ends]
    assert order(STEPS, errors) == pytest.approx(1, abs=0.1)


# A body held by springs -----------------------------------------------------------------------------------


@pytest.mark.parametrize("method", METHODS)
def test_body_held_by_two_fingers_swings_as_on_springs(method):
    # Two fingers 2 mm deep in opposite faces that do not slip: a spring of 2 k along and across their line.
    mass, hip = 0.2, [[0.028, 0, 0], [-0.028, 0, 0]]
    rate, seconds = np.sqrt(2 * 800 / mass), 0.25
    for gravity, start in (([0, 0, 0], [0.1, 0, 0]), ([0, 0, -0.5], [0, 0.05, 0])):
        scene = brick(hapjax.Body(mass), method, hapjax.World(gravity=gravity))
        angle, start, gravity = rate * seconds, np.array(start), np.array(gravity)
        place = start / rate * np.sin(angle) + gravity / rate**2 * (1 - np.cos(angle))
        speed = start * np.cos(angle) + gravity / rate * np.sin(angle)
        ends = [run(scene, seconds, dt, hip, velocity=start) for dt in STEPS]
        errors = [np.hypot(*(e.position - place, (e.velocity - speed) / rate)).max() for e in ends]
        assert order(STEPS, errors) == pytest.approx(1, abs=0.1) and errors[-1] < 2e-5
        assert ends[-1].orientation == pytest.approx(np.array([1, 0, 0, 0]), abs=1e-9)


@pytest.mark.parametrize("method", hapjax.integrate.METHODS.values())
def test_precision_is_kept(method, dtype):
    body = hapjax.Body(0.2, inertia=np.array([1.0, 2.0, 3.0]) * 1e-4, centre=CENTRE)
    scene = hapjax.cast(brick(body, method, hapjax.World(gyroscopic=True, gravity=(0, 0, -G))), dtype)
    state = moving(hapjax.init(scene, np.full((1, 3), 9.0)), "it", spin=SPIN)
    end, replies = hapjax.rollout(scene, state, at_rest(np.full((1, 3), 9.0, dtype), 50))
    assert {x.dtype for x in jax.tree.leaves((end, replies))} == {dtype, jnp.dtype(bool)}
    assert end.motion["it"].velocity == pytest.approx(np.array([0, 0, -G * 0.05]), rel=1e-5)


def test_the_matrix_form_goes_on_with_the_nearer_quaternion():
    """A matrix has two quaternions; poses that jump from one to the other could not be interpolated."""
    body, shape, still = hapjax.Body(1.0), hapjax.Box((0.1, 0.1, 0.1)), jnp.zeros(3)
    integrator, orientation = hapjax.SemiImplicitMatrix(), jnp.array([1.0, 0, 0, 0])
    motion = Motion(still, orientation, still, jnp.array([0.0, 0, 7.0]))
    advance = jax.jit(
        lambda m: integrator.advance(body, shape, m, Wrench(still, still), False, None, jnp.asarray(0.01))
    )
    for _ in range(200):  # two turns
        after = advance(motion)
        assert jnp.sum(after.orientation * motion.orientation) > 0.99
        motion = after


# A pivot near the contacts --------------------------------------------------------------------------------


@pytest.mark.parametrize("gyroscopic", [True, False])
def test_the_pivot_form_solves_the_spatial_inertia_at_the_pivot(gyroscopic):
    """One step against the 6 x 6 system of momentum balances about the pivot."""
    rng = np.random.default_rng(8)
    inertia, mass, dt = np.array([1.0, 2.0, 2.5]) * 1e-4, 0.3, 1e-3
    orientation = quaternion((1, 2, -1), 0.8)
    body = hapjax.Body(mass, inertia, CENTRE)
    sizes = np.array([[0.1, 1, 5, 1, 0.1, 0.1]]).T
    position, velocity, spin, force, torque, pivot = rng.standard_normal((6, 3)) * sizes
    motion = Motion(*map(jnp.asarray, (position, np.array(orientation), velocity, spin)))
    wrench = Wrench(jnp.asarray(force), jnp.asarray(torque))
    after = hapjax.PivotForm().advance(
        body, hapjax.Box((0.1,) * 3), motion, wrench, gyroscopic, None, jnp.asarray(dt), jnp.asarray(pivot)
    )
    turn = matrix(orientation)
    world = turn @ np.diag(inertia) @ turn.T
    arm = position + turn @ CENTRE - pivot

    def cross(v):
        return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])

    spatial = np.block(
        [[mass * np.eye(3), -mass * cross(arm)], [mass * cross(arm), world - mass * cross(arm) @ cross(arm)]]
    )
    bias = mass * np.cross(spin, np.cross(spin, arm))
    own = np.cross(spin, world @ spin) if gyroscopic else np.zeros(3)
    right = np.concatenate([force - bias, torque + np.cross(arm, force) - own - np.cross(arm, bias)])
    acceleration = np.linalg.solve(spatial, right)
    assert after.spin == pytest.approx(spin + dt * acceleration[3:], rel=1e-9)
    turned = Rotation.from_rotvec(dt * np.asarray(after.spin)).as_matrix()
    at_pivot = velocity - np.cross(spin, arm) + dt * acceleration[:3]
    assert after.velocity == pytest.approx(
        at_pivot + np.cross(np.asarray(after.spin), turned @ arm), rel=1e-9
    )
    assert matrix(after.orientation) == pytest.approx(turned @ turn, abs=1e-12)
    place = pivot + dt * at_pivot + turned @ (position - pivot)
    assert after.position == pytest.approx(place, abs=1e-12)


ROD, HELD, DEEP, SWING = (0.2, 0.02, 0.02), np.array([-0.08, 0.0]), 2e-3, 0.3
PINCH = np.array([[-0.08, 0.008, 0.0], [-0.08, -0.008, 0.0]])


def rod(method):
    thing = hapjax.Object(hapjax.Box(ROD), hapjax.Surface(800.0, mu=20.0), hapjax.Body(0.05))
    return hapjax.Scene(object={"it": thing}, world=hapjax.World(gravity=(0, 0, -G)), integrator=method())


@functools.cache
def swung_rod():
    """x, z and tilt of a rod that swings on two springs which hold a point of it, by Dormand-Prince of order 8."""
    mass, stiffness, inertia = 0.05, 1600.0, 0.05 * (ROD[0] ** 2 + ROD[2] ** 2) / 12

    def rate(_, y):
        cosine, sine = np.cos(y[2]), np.sin(y[2])
        arm = np.array([cosine * HELD[0], -sine * HELD[0]])  # a tilt about +y takes x down
        force = stiffness * (HELD - y[:2] - arm)
        torque = arm[1] * force[0] - arm[0] * force[1]
        return [*y[3:], force[0] / mass, force[1] / mass - G, torque / inertia]

    return solve_ivp(rate, (0, SWING), np.zeros(6), method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]


@pytest.mark.parametrize("method", [hapjax.SemiImplicit, hapjax.PivotForm])
def test_a_rod_held_at_one_end_swings_as_on_springs(method):
    truth, errors = swung_rod(), []
    assert abs(truth[2]) > 1
    steps = [1e-3, 5e-4, 2.5e-4, 1.25e-4]
    for dt in steps:
        end = run(rod(method), SWING, dt, PINCH)
        tilt = 2 * np.arctan2(end.orientation[2], end.orientation[0])
        off = [end.position[0] - truth[0], end.position[2] - truth[1], 0.1 * (tilt - truth[2])]
        errors.append(np.max(np.abs(off)))
    assert order(steps, errors) == pytest.approx(1, abs=0.15) and errors[-1] < 2e-3


@pytest.mark.slow
def test_the_pivot_form_is_differentiable_in_where_it_is_held():
    scene = rod(hapjax.PivotForm)

    @jax.jit
    def last(shift):
        hips = jnp.asarray(PINCH) + jnp.stack([shift, 0 * shift, 0 * shift])[None]
        state, _ = hapjax.rollout(scene, hapjax.init(scene, hips), at_rest(hips, 50), 1e-3)
        return state.motion["it"].position

    at, eps = jnp.asarray(0.001), 1e-6
    forward, reverse = np.asarray(jax.jacfwd(last)(at)), np.asarray(jax.jacrev(last)(at))
    numeric = (np.asarray(last(at + eps)) - np.asarray(last(at - eps))) / (2 * eps)
    assert forward == pytest.approx(numeric, rel=1e-5, abs=1e-8) and np.abs(forward).max() > 1e-3
    assert reverse == pytest.approx(forward, rel=1e-9, abs=1e-14)


def test_in_the_air_the_pivot_is_the_centre_of_mass():
    ends = [run(top(method), 0.2, 1e-3, spin=SPIN, velocity=(0.2, 0, 0.1)) for method in METHODS[::2]]
    for first, second in zip(*map(jax.tree.leaves, ends), strict=True):
        assert first == pytest.approx(np.asarray(second), abs=1e-13)
