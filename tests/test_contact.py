"""Objects on planes under gravity, against the mechanics of the textbook."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hapjax
from hapjax import rotation
from helpers import G, away, matrix, moving, quaternion

MU = 0.5
SLOPE = np.arctan(MU)
EDGE = 0.06


def on_plane(
    shape=None,
    stiffness=5000.0,
    mu=MU,
    damping: float | None = 2.0,
    slope=0.0,
    dt=1e-3,
    sunk=0.0,
    method=None,
    turn=None,
):
    """A 0.2 kg thing that stands on a plane, which falls off towards +x by `slope` rad.

    Damping c lets a wobble on the plane die down at the rate c g / 2.
    """
    shape = hapjax.Box((EDGE,) * 3) if shape is None else shape
    height = (EDGE / 2 if isinstance(shape, hapjax.Box) else float(shape.radius)) - sunk
    tilt = quaternion((0, 1, 0), slope) if slope else (1.0, 0.0, 0.0, 0.0)
    thing = hapjax.Object(
        shape, None, hapjax.Body(0.2), height * matrix(tilt)[:, 2], tilt if turn is None else turn
    )
    return hapjax.Scene(
        object={"it": thing, "floor": hapjax.Object(hapjax.Plane(), orientation=tilt)},
        contact={"pair": hapjax.Contact(stiffness, mu=mu, damping=damping, between=("it", "floor"))},
        world=hapjax.World(gravity=(0, 0, -G)),
        integrator=(method or hapjax.SemiImplicit)(dt=dt),
    )


def play(scene, steps, dtype=np.float64, **start):
    """The reply of every step and the last state, from a standing start or the given motion."""
    scene = hapjax.cast(scene, dtype)
    hips = away(steps).astype(dtype)
    state = moving(hapjax.init(scene, hips[0]), "it", **start)
    return jax.tree.map(np.asarray, hapjax.rollout(scene, state, hips))


def sunk(stiffness, points=4):
    """How far the thing at rest stands below the plane's surface, m."""
    return 0.2 * G / (points * stiffness)


# Sticking and sliding -------------------------------------------------------------------------------------


def test_block_at_rest_stands_still_on_four_corners():
    state, replies = play(on_plane(), 2000)
    assert replies.pose[-1, 0, 2] == pytest.approx(EDGE / 2 - sunk(5000), abs=1e-9)
    assert np.abs(replies.pose[-1] - replies.pose[-100]).max() < 1e-11
    corners = replies.contact["pair"].normal_force[-1]
    assert np.sort(corners) == pytest.approx(np.repeat([0, 0.2 * G / 4], 4), abs=1e-6)


@pytest.mark.parametrize("tilt", ["plane", "gravity"])
@pytest.mark.parametrize("part", [0.3, 0.98])
def test_block_below_the_friction_angle_does_not_creep(tilt, part):
    slope = np.arctan(part * MU)
    scene = on_plane(slope=slope)
    if tilt == "gravity":
        world = hapjax.World(gravity=(G * np.sin(slope), 0, -G * np.cos(slope)))
        flat = on_plane()
        scene = hapjax.Scene(flat.object, flat.contact, None, world, flat.integrator)
    _, replies = play(scene, 13_000)
    settled = replies.pose[3000:, 0, :3]
    assert np.abs(settled - settled[0]).max() < 1e-9  # the demand is 1 um in 10 s
    pull = replies.contact["pair"].friction_force[-1].sum(axis=0)
    assert pull == pytest.approx(np.array([-0.2 * G * np.sin(slope), 0, 0]), abs=1e-6)


@jax.jit
def tilting(scene, slopes):
    """Velocity and position at every step while gravity turns against the plane."""

    def one(state, slope):
        gravity = G * jnp.stack([jnp.sin(slope), jnp.zeros_like(slope), -jnp.cos(slope)])
        now = eqx.tree_at(lambda s: s.world.gravity, scene, gravity)
        state, _ = hapjax.step(now, state, away(1)[0])
        return state, (state.motion["it"].velocity, state.motion["it"].position)

    return jax.lax.scan(one, hapjax.init(scene, away(1)[0]), slopes)[1]


def test_block_holds_up_to_static_friction_then_slides_with_the_kinetic():
    flat = on_plane(sunk=sunk(5000))
    pair = hapjax.Contact(5000.0, mu_static=0.6, mu_kinetic=0.4, damping=2.0, between=("it", "floor"))
    # Without rotation all corners carry the same load; else the least loaded would break away before the rest.
    block = eqx.tree_at(lambda o: o.body, flat.object["it"], hapjax.Body(0.2, rotation=False))
    objects = {"it": block, "floor": flat.object["floor"]}
    scene = hapjax.Scene(objects, {"pair": pair}, None, flat.world, flat.integrator)
    up = np.arctan(np.concatenate([np.linspace(0, 0.58, 3000), np.full(12_000, 0.58)]))
    over = np.arctan(np.concatenate([np.linspace(0.58, 0.62, 500), np.full(1500, 0.62)]))
    velocity, position = map(np.asarray, tilting(scene, jnp.asarray(np.concatenate([up, over]))))
    held = position[5000:15_000]
    assert np.abs(held - held[0]).max() < 1e-9
    slope = over[-1]
    gained = velocity[-1, 0] - velocity[-501, 0]
    assert gained == pytest.approx(0.5 * G * (np.sin(slope) - 0.4 * np.cos(slope)), rel=1e-3)


@pytest.mark.parametrize("steeper", [1.05, 1.5])
@pytest.mark.parametrize("method", [hapjax.SemiImplicit, hapjax.SemiImplicitMatrix])
def test_block_above_the_friction_angle_slides_with_the_analytic_acceleration(steeper, method):
    slope = np.arctan(steeper * MU)
    scene = on_plane(slope=slope, sunk=sunk(5000) * np.cos(slope), method=method)
    _, replies = play(scene, 2000)
    x = replies.pose[:, 0, :3] @ matrix(scene.object["floor"].orientation)[:, 0]
    # Once the block's pitching has died down the second difference over 0.4 s is the acceleration.
    acceleration = (x[1999] - 2 * x[1599] + x[1199]) / 0.4**2
    assert acceleration == pytest.approx(G * (np.sin(slope) - MU * np.cos(slope)), rel=2e-3)


def test_sliding_block_stops_where_it_should_and_closer_with_stiffness():
    speed = 0.6
    truth = speed**2 / (2 * MU * G)
    errors = []
    for stiffness in (2e3, 6e3, 1.8e4):
        scene = on_plane(stiffness=stiffness, damping=5.0, dt=5e-5, sunk=sunk(stiffness))
        _, replies = play(scene, 16_000, velocity=(speed, 0, 0))
        x = replies.pose[:, 0, 0]
        assert np.ptp(x[-1000:]) < 2e-6  # it has come to rest
        errors.append(abs(x[-1] / truth - 1))
    assert errors[0] < 1e-2
    assert errors[2] < errors[1] < errors[0]


def test_without_friction_it_slides_for_ever():
    state, _ = play(on_plane(mu=0.0, sunk=sunk(5000)), 2000, velocity=(0.3, 0.1, 0))
    assert state.motion["it"].velocity[:2] == pytest.approx(np.array([0.3, 0.1]), abs=1e-12)


# The ball -------------------------------------------------------------------------------------------------


def ball(stiffness=5000.0, mu=0.3, **options):
    return on_plane(hapjax.Sphere(0.03), stiffness, mu=mu, sunk=sunk(stiffness, 1), **options)


def test_sliding_ball_comes_to_roll_at_five_sevenths():
    state, replies = play(ball(stiffness=2e4, dt=5e-4), 2000, velocity=(0.5, 0, 0))
    motion = state.motion["it"]
    assert motion.velocity[0] == pytest.approx(5 / 7 * 0.5, rel=5e-3)
    assert motion.spin == pytest.approx(np.array([0, motion.velocity[0] / 0.03, 0]), rel=1e-2, abs=1e-6)
    # While it slides, friction slows it by mu g.
    x = replies.pose[:, 0, 0]
    assert (x[80] - 2 * x[50] + x[20]) / 0.015**2 == pytest.approx(-0.3 * G, rel=1e-2)


def test_ball_rolls_down_a_slope_with_five_sevenths_of_the_pull():
    slope = np.radians(15)
    scene = ball(stiffness=2e4, mu=0.6, slope=slope, dt=5e-4)
    state, _ = play(scene, 2000)
    down = matrix(scene.object["floor"].orientation)[:, 0]
    assert state.motion["it"].velocity @ down == pytest.approx(5 / 7 * G * np.sin(slope), rel=1e-2)


# Falling and bouncing -------------------------------------------------------------------------------------


@jax.jit
def energies(scene, state, steps):
    """Kinetic, potential and elastic energy (J) at each step of a cube over a level plane."""
    mass, inertia, stiffness = 0.2, 0.2 * EDGE**2 / 6, scene.contact["pair"].stiffness

    def one(before, _):
        state, _ = hapjax.step(scene, before, away(1)[0])
        then, motion, (gods,) = before.motion["it"], state.motion["it"], state.contact["pair"]
        corners = then.position[None] + rotation.turn(
            rotation.to_matrix(then.orientation), scene.object["it"].shape.points()
        )
        kinetic = 0.5 * mass * jnp.sum(motion.velocity**2) + 0.5 * inertia * jnp.sum(motion.spin**2)
        offset = jnp.where(gods.depth[:, None] > 0, (gods.point - corners)[:, :2], 0)
        stretch = jnp.sum(gods.depth**2) + jnp.sum(offset**2)
        return state, kinetic + mass * G * motion.position[2] + 0.5 * stiffness * stretch

    return jax.lax.scan(one, state, steps)[1]


@pytest.mark.parametrize("damping", [None, 0.5])
def test_energy_never_grows(damping):
    scene = on_plane(sunk=-0.02, turn=quaternion((1, 2, 0.3), 0.6), damping=damping, dt=1e-5)
    state = moving(hapjax.init(scene, away(1)[0]), "it", velocity=(0.3, -0.2, 0), spin=(1.0, 3.0, -2.0))
    energy = np.asarray(energies(scene, state, np.arange(40_000)))
    growth = energy - np.minimum.accumulate(energy)
    assert growth.max() < 1e-3 * energy[0]
    assert energy[-1] < 0.8 * energy[0]


def test_each_bounce_is_lower():
    scene = on_plane(hapjax.Sphere(0.03), stiffness=2e4, damping=0.4, sunk=-0.1, dt=2e-4)
    _, replies = play(scene, 6000)
    height = replies.pose[:, 0, 2] - 0.03
    free = height > 0
    flights = np.split(np.arange(len(height)), np.flatnonzero(np.diff(free)) + 1)
    tops = [height[f].max() for f in flights if height[f[0]] > 0 and f[-1] < len(height) - 1]
    assert len(tops) >= 4
    assert np.all(np.diff(tops) < 0)


def test_without_loss_it_bounces_back_and_with_it_never_higher():
    for damping, low, high in ((None, 0.999, 1.001), (0.4, 0.3, 0.95)):
        scene = on_plane(hapjax.Sphere(0.03), stiffness=2e4, damping=damping, sunk=-0.05, dt=2e-5)
        _, replies = play(scene, 15_000)
        height = replies.pose[:, 0, 2] - 0.03
        touch_down = int(np.argmax(height < 0))
        again = height[touch_down:].max()
        assert low < again / 0.05 < high


def test_dropped_cube_comes_to_lie_on_a_face():
    scene = on_plane(sunk=-0.02, turn=quaternion((1, 2, 0.3), 0.6), dt=5e-4)
    state, replies = play(scene, 6000)
    motion = state.motion["it"]
    assert np.abs(motion.velocity).max() < 1e-6 and np.abs(motion.spin).max() < 1e-5
    up = np.abs(matrix(motion.orientation)[2])
    assert np.sort(up) == pytest.approx(np.array([0, 0, 1]), abs=1e-4)
    assert motion.position[2] == pytest.approx(EDGE / 2 - sunk(5000), abs=1e-6)


# Precision ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [hapjax.Box((EDGE,) * 3), hapjax.Sphere(0.03)], ids=["box", "sphere"])
def test_precision_is_kept(shape, dtype):
    points = 4 if isinstance(shape, hapjax.Box) else 1
    scene = on_plane(shape, sunk=sunk(5000, points))
    state, replies = play(scene, 2000, dtype)
    assert {x.dtype for x in jax.tree.leaves((state, replies))} == {dtype, jnp.dtype(bool)}
    assert replies.contact["pair"].normal_force[-1].sum() == pytest.approx(0.2 * G, rel=1e-3)


def test_names_of_a_pair_may_come_in_either_order():
    scene = on_plane(slope=0.2)
    pair = hapjax.Contact(5000.0, mu=MU, damping=2.0, between=("floor", "it"))
    other = hapjax.Scene(scene.object, {"pair": pair}, None, scene.world, scene.integrator)
    assert np.array_equal(play(scene, 2000)[1].pose, play(other, 2000)[1].pose)


def test_a_pair_not_named_passes_through():
    scene = on_plane()
    scene = hapjax.Scene(scene.object, {}, None, scene.world, scene.integrator)
    state, _ = play(scene, 500)
    assert state.motion["it"].velocity[2] == pytest.approx(-G * 0.5)
    assert jnp.shape(state.motion["it"].spin) == (3,)
