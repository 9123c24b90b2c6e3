"""Several fingers on one object, against hand formulas and conservation laws."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hapjax
from hapjax import grasp
from hapjax.torsion import Grip, lock
from helpers import G, at_rest, matrix, moving, quaternion

K, MU, MASS, EDGE = 800.0, 0.9, 0.1, 0.06


def held(torsion=None, world=None, mu=MU, damping: float | None = 1.0, orientation=(1, 0, 0, 0), **fields):
    """A box of 0.1 kg in the air."""
    box = hapjax.Object(
        hapjax.Box((EDGE,) * 3),
        hapjax.Surface(K, mu=mu, damping=damping),
        hapjax.Body(MASS, inertia=(1.1e-4, 1.0e-4, 0.9e-4)),
        orientation=orientation,
    )
    return hapjax.Scene(object={"it": box}, torsion=torsion, world=world or hapjax.World(), **fields)


def pinch(height=0.0, depth=2e-3, forth=0.0):
    """Two fingers in the faces +x and -x."""
    reach = EDGE / 2 - depth
    return np.array([[reach, forth, height], [-reach, forth, height]])


def play(scene, hips, dtype=np.float64, **start):
    scene, hips = hapjax.cast(scene, dtype), jnp.asarray(hips, dtype)
    state = moving(hapjax.init(scene, hips[0]), "it", **start)
    return jax.tree.map(np.asarray, hapjax.rollout(scene, state, hips))


# Residual wrench ------------------------------------------------------------------------------------------


def test_residual_is_the_sum_of_forces_and_moments(dtype):
    forces, arms = np.random.default_rng(2).standard_normal((2, 5, 3)).astype(dtype)
    wrench = jax.jit(grasp.residual)(forces, arms)
    assert wrench.force.dtype == wrench.torque.dtype == dtype
    assert wrench.force == pytest.approx(forces.sum(axis=0), rel=1e-4, abs=1e-5)
    moments = [
        [y * c - z * b, z * a - x * c, x * b - y * a]
        for (x, y, z), (a, b, c) in zip(arms, forces, strict=True)
    ]
    assert wrench.torque == pytest.approx(np.sum(moments, axis=0), rel=1e-4, abs=1e-5)


@pytest.mark.parametrize("fingers", [1, 3])
def test_momentum_given_to_the_fingers_is_taken_from_the_body(fingers):
    """Fingers knock a free box about: its linear and angular momentum are what the forces' impulses leave."""
    scene = held(world=hapjax.World(gyroscopic=True), orientation=quaternion((1, 2, 3), 0.4), mu=0.5)
    rng = np.random.default_rng(5)
    starts = np.array([[0.028, 0.01, 0.005], [-0.005, 0.029, 0.0], [0.0, 0.004, -0.029]])[:fingers]
    turn = matrix(quaternion((1, 2, 3), 0.4))
    sway = 4e-3 * np.sin(np.linspace(0, 12, 300)[:, None, None] * rng.uniform(0.5, 1, (fingers, 3)))
    hips = starts @ turn.T + sway
    dt = 1e-5
    short = hapjax.Scene(scene.object, world=scene.world, integrator=hapjax.SemiImplicit(dt=dt))
    state, replies = play(short, hips)
    linear = MASS * state.motion["it"].velocity
    assert np.linalg.norm(linear) > 1e-4
    assert linear == pytest.approx(-dt * replies.force.sum(axis=(0, 1)), abs=1e-14)
    # About the fixed origin; the torque of a step acts at the pose from before it.
    before = np.concatenate([np.zeros((1, 3)), replies.pose[:-1, 0, :3]])
    torque = np.cross(hips - before[:, None], -replies.force).sum(axis=(0, 1)) * dt
    turned = matrix(state.motion["it"].orientation)
    inertia = turned @ np.diag([1.1e-4, 1.0e-4, 0.9e-4]) @ turned.T
    assert inertia @ state.motion["it"].spin == pytest.approx(torque, rel=1e-3, abs=1e-9)


def test_two_fingers_without_torsion_hold_no_torque_about_their_line():
    # The centre hangs 1 cm beside the line: nothing stops it from falling about it.
    hip = pinch(forth=0.01, depth=4e-3)
    scene = held(world=hapjax.World(gravity=(0, 0, -G)), damping=None)
    _, replies = play(scene, at_rest(hip, 400))
    tilt = np.array([np.arctan2(*matrix(q)[2, 1:]) for q in replies.pose[:, 0, 3:]])
    assert np.ptp(tilt) > 1.0
    # The forces go through the god-objects, so only the bending of the line leaves them a moment about it.
    moment = np.cross(hip - hip[0], replies.force).sum(axis=1)[:, 0]
    assert np.abs(moment).max() < 1e-12


# The gravity drop -----------------------------------------------------------------------------------------


def area(depth, mu=MU):
    return np.pi * (mu * depth) ** 2


def grip_of(gods, radii, touching, normals=None, forces=None):
    """A grip of three fingers; the gravity drop reads neither normals nor forces."""
    normals = np.zeros_like(gods) if normals is None else normals
    forces = np.zeros_like(radii) if forces is None else forces
    touching = np.array(touching)
    return Grip(*map(jnp.asarray, (gods, normals, forces, radii, touching, touching)))


@pytest.mark.parametrize("share", [0.0, 0.25, 0.7, 1.0, 1.4])
def test_torque_about_the_line_is_scaled_by_what_the_area_leaves(share, dtype):
    radii = np.array([1.0e-3, 3.0e-3], dtype)
    mean = np.pi * (radii[0] ** 2 + radii[1] ** 2) / 2
    torsion = hapjax.GravityDrop(np.asarray(mean / share if share else 1e3, dtype), np.asarray(2e-4, dtype))
    gods = np.array([[0.03, 0.01, 0], [0.5, 0.5, 0.5], [-0.03, 0, 0.02]], dtype)
    radii = np.array([radii[0], 0, radii[1]], dtype)
    torque, spin = np.array([0.3, -0.2, 0.5], dtype), np.array([1, 2, 3], dtype)
    held = torsion.hold(
        grip_of(gods, radii, [True, False, True]),
        None,
        jnp.asarray(torque),
        jnp.asarray(spin),
        None,
        jnp.asarray(1e-3, dtype),
    )
    assert held.twist is not None and held.angle is None
    twist, left = held.twist, np.asarray(held.torque)
    line = (gods[2] - gods[0]) / np.linalg.norm(gods[2] - gods[0])
    assert np.abs(np.asarray(twist.axis) @ line) == pytest.approx(1, rel=1e-6)
    assert twist.free == pytest.approx(max(0, 1 - share), abs=1e-6)
    assert left.dtype == dtype
    across = torque - (torque @ line) * line
    assert left - (left @ line) * line == pytest.approx(across, abs=1e-6)
    assert left @ line == pytest.approx(max(0, 1 - share) * (torque @ line) - 2e-4 * (spin @ line), abs=1e-6)
    still = np.asarray(lock(twist, jnp.asarray(spin)))
    assert still @ line == pytest.approx(0 if share >= 1 else spin @ line, abs=1e-6)


@pytest.mark.parametrize("touching", [[True, False, False], [True, True, True], [False] * 3])
def test_only_two_fingers_have_a_line(touching):
    gods, radii = np.arange(9.0).reshape(3, 3) ** 2, np.full(3, 1.0)
    twist = hapjax.GravityDrop(1e-5).twist_of(grip_of(gods, radii, touching), None)
    assert np.array_equal(twist.axis, np.zeros(3)) and twist.free == 1


HANGING = quaternion((1, 0, 0), 0.6)


def swing(factor, twist_damping=None, steps=600, dtype=np.float64):
    """The tilt about the grasp's line, rad, of a box held above its centre, where A_crit = factor * A."""
    depth = 4e-3
    torsion = hapjax.GravityDrop(factor * area(depth), twist_damping=twist_damping)
    scene = held(torsion, hapjax.World(gravity=(0, 0, -G)), orientation=HANGING)
    hip = pinch(0.02, depth) @ matrix(HANGING).T
    state, replies = play(scene, at_rest(hip, steps), dtype)
    up = np.array([matrix(q)[:, 2] for q in replies.pose[:, 0, 3:]])
    return np.arctan2(-up[:, 1], up[:, 2]), replies, state


def test_a_firm_grip_locks_the_line():
    tilt, replies, state = swing(0.8)
    assert np.abs(tilt - 0.6).max() < 1e-12
    assert np.array_equal(state.motion["it"].spin[0], 0.0)
    assert replies.force[-1].sum(axis=0) == pytest.approx(np.array([0, 0, -MASS * G]), rel=1e-2, abs=1e-3)


def test_a_lighter_grip_leaves_its_share_of_the_torque():
    """One step from the same loaded grasp, with other A_crit: what the box gains about the line."""
    depth, dt = 4e-3, 1e-3
    hip = pinch(0.02, depth) @ matrix(HANGING).T
    scene = held(hapjax.GravityDrop(0.5 * area(depth)), hapjax.World(gravity=(0, 0, -G)), orientation=HANGING)
    loaded, _ = hapjax.rollout(scene, hapjax.init(scene, hip), at_rest(hip, 40))
    before = jax.tree.map(np.asarray, loaded.motion["it"])
    turn = matrix(before.orientation)
    for share in (0.1, 0.5, 0.9, 1.2):
        lighter = eqx.tree_at(lambda s: s.torsion.critical_area, scene, jnp.asarray(area(depth) / share))
        state, reply = jax.tree.map(np.asarray, hapjax.step(lighter, loaded, jnp.asarray(hip)))
        torque = np.cross(hip - before.position, -reply.force).sum(axis=0)
        gods = state.finger["it"].point @ turn.T
        line = (gods[1] - gods[0]) / np.linalg.norm(gods[1] - gods[0])
        assert abs(torque @ line) > 1e-3
        # The grip has yielded a little since: the circles' area is that of the depths now.
        left = max(0.0, 1 - np.mean(area(state.finger["it"].depth)) / (area(depth) / share))
        gained = turn @ (
            np.array([1.1e-4, 1.0e-4, 0.9e-4]) * (turn.T @ (state.motion["it"].spin - before.spin))
        )
        assert gained @ line == pytest.approx(dt * left * (torque @ line), rel=1e-9, abs=1e-12)


def test_twist_damping_brings_the_swing_to_rest_below_the_line():
    tilt, _, _ = swing(1e6, twist_damping=1e-3, steps=4000)
    assert np.abs(tilt[-200:]).max() < 1e-3 and np.ptp(tilt[-200:]) < 1e-4
    undamped, _, _ = swing(1e6, steps=4000)
    assert np.ptp(undamped[-1000:]) > 0.1


# Dead band and three fingers ------------------------------------------------------------------------------


def test_dead_band_swallows_small_torques_only(dtype):
    small, large = np.array([3e-4, 0, 4e-4], dtype), np.array([3.1e-4, 0, 4.1e-4], dtype)
    limit = np.asarray(5.001e-4, dtype)
    assert np.array_equal(grasp.dead_band(jnp.asarray(small), jnp.asarray(limit)), np.zeros(3))
    assert np.array_equal(grasp.dead_band(jnp.asarray(large), jnp.asarray(limit)), large)


@pytest.mark.parametrize(("band", "turns"), [(1.1, False), (0.9, True)])
def test_a_push_beside_the_centre_turns_the_box_beyond_the_dead_band(band, turns):
    # One finger 1 mm deep, 1 cm beside the centre: |T| = k d a.
    scene = held(world=hapjax.World(dead_band=band * K * 1e-3 * 0.01), damping=None)
    state, _ = play(scene, at_rest([[0.029, 0.01, 0.0]], 1))
    expected = K * 1e-3 * 0.01 * 1e-3 / 0.9e-4
    assert state.motion["it"].spin[2] == pytest.approx(expected if turns else 0.0, rel=1e-12)
    assert state.motion["it"].velocity[0] == pytest.approx(-K * 1e-3 * 1e-3 / MASS, rel=1e-12)


TRIPOD = np.array([[0.0285, 0.012, 0.0], [0.0285, -0.012, 0.0], [-0.027, 0.0, 0.001]])


def test_three_fingers_hold_a_box_at_rest():
    scene = held(world=hapjax.World(gravity=(0, 0, -G), gyroscopic=True))
    state, replies = play(scene, at_rest(TRIPOD, 8000))
    assert np.abs(state.motion["it"].velocity).max() < 1e-10
    assert np.abs(state.motion["it"].spin).max() < 1e-8
    assert np.abs(replies.pose[-1] - replies.pose[-2000]).max() < 1e-9
    force = replies.force[-1]
    assert force.sum(axis=0) == pytest.approx(np.array([0, 0, -MASS * G]), abs=1e-9)
    assert np.cross(TRIPOD - replies.pose[-1, 0, :3], force).sum(axis=0) == pytest.approx(
        np.zeros(3), abs=1e-9
    )


def test_precision_is_kept(dtype):
    torsion = hapjax.GravityDrop(6e-5, twist_damping=1e-4)
    scene = held(torsion, hapjax.World(gravity=(0, 0, -G), gyroscopic=True, dead_band=1e-6))
    state, replies = play(scene, at_rest(np.vstack([TRIPOD[:1], TRIPOD[2:]]), 50), dtype)
    assert {leaf.dtype for leaf in jax.tree.leaves((state, replies))} == {dtype, jnp.dtype(bool)}
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves((state, replies)))
