"""The fully implicit step: it settles whatever the stiffness and the step, and is right where they are small."""

import dataclasses
import functools
from itertools import product
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import hapjax
from hapjax.integrate import METHODS
from helpers import G, away, moving, order, quaternion, well_compiled

EDGE = 0.04
WORLD = hapjax.World(gravity=(0, 0, -G))


def cube_on_floor(stiffness=1e4, mu=0.5, damping: float | None = 2.0, mass=0.05, tilt=None, height=0.06):
    """A cube above a plane that can be tilted about y (rad)."""
    turn = (1, 0, 0, 0) if tilt is None else quaternion((0, 1, 0), tilt)
    cube = hapjax.Object(hapjax.Box((EDGE,) * 3), None, hapjax.Body(mass), (0, 0, height), turn)
    floor = hapjax.Object(hapjax.Plane(), orientation=turn)
    pair = hapjax.Contact(stiffness, mu=mu, damping=damping, between=("cube", "floor"))
    return hapjax.Scene(
        {"cube": cube, "floor": floor}, {"pair": pair}, world=WORLD, integrator=hapjax.Implicit()
    )


@jax.jit
def after(scene, state, steps):
    """The state after a number of steps with the fingers out of reach."""
    far = away(1)[0].astype(scene.integrator.dt.dtype)
    return jax.lax.fori_loop(0, steps, lambda _, s: hapjax.step(scene, s, far)[0], state)


# Stability ------------------------------------------------------------------------------------------------

TURNED = quaternion((0.3, 0.2, 0.1), 0.71)


def fallen(stiffness, dt, mass, mu, steps):
    """Energy of motion (J per kg) and depth (m) of a tilted cube, dropped, after a number of steps."""
    scene = hapjax.cast(cube_on_floor(), dt.dtype)
    where = lambda s: (  # noqa: E731
        s.contact["pair"].stiffness,
        s.integrator.dt,
        s.object["cube"].body.mass,
        s.contact["pair"].mu,
        s.object["cube"].orientation,
    )
    scene = eqx.tree_at(where, scene, (stiffness, dt, mass, mu, jnp.array(TURNED, dt.dtype)))
    begin = hapjax.init(scene, away(1)[0].astype(dt.dtype))
    end = after(scene, begin, steps).motion["cube"]
    # The radius of gyration of a cube is a / sqrt(6).
    return (jnp.sum(end.velocity**2) + EDGE**2 / 6 * jnp.sum(end.spin**2)) / 2, EDGE / 2 - end.position[2]


each_fallen = well_compiled(jax.vmap(fallen, in_axes=(0, None, 0, 0, None)))
MAP = np.array(
    list(product(10.0 ** np.arange(2, 8.1, 0.5), (1e-3, 0.05, 10.0), (0.0, 0.5, 2.0, 10.0)))
)  # N/m, kg, mu


# So many cells of the map, each so many rows on; the first is 1 g and mu 10 on 1e8 N/m, where most goes wrong.
@pytest.mark.slow
@pytest.mark.parametrize(
    "ms, number, stride, seconds", [(20, 24, 5, 2.0), (5, 24, 11, 2.0), (1, 24, 7, 2.0), (0.1, 6, 29, 1.0)]
)
def test_it_settles_for_every_stiffness_step_mass_and_mu(ms, number, stride, seconds, dtype):
    dt, cells = 1e-3 * ms, MAP[(147 + stride * np.arange(number)) % len(MAP)]
    if dtype == jnp.float32:  # where dt^2 k is larger, rounding takes the mass beside it
        cells[:, 0] = np.minimum(cells[:, 0], cells[:, 1] / (np.finfo(np.float32).eps * dt**2))
    k, m, mu = jnp.asarray(cells, dtype).T
    energy, depth = each_fallen(k, jnp.asarray(dt, dtype), m, mu, round(seconds / dt))
    fell = G * (0.06 - EDGE / 2)
    assert np.all(np.asarray(energy) < 1e-4 * fell), cells[~(np.asarray(energy) < 1e-4 * fell)]
    # Where four corners' springs carry the weight within a tenth of the cube, it lies flat on them.
    sunk = cells[:, 1] * G / (4 * cells[:, 0])
    flat = sunk < EDGE / 10
    rounding = 20 * np.finfo(dtype).eps * EDGE
    np.testing.assert_allclose(np.asarray(depth)[flat], sunk[flat], rtol=1e-2, atol=max(rounding, 1e-9))


def test_it_settles_where_explicit_steps_blow_up():
    numbers = (jnp.asarray(x) for x in (1e8, 2e-2, 0.05, 0.5))
    energy, depth = jax.jit(fallen)(*numbers, 100)
    assert energy < 1e-20
    np.testing.assert_allclose(depth, 0.05 * G / 4e8, rtol=1e-4)


def dropped_stack(names=("a", "b")):
    """Two cubes, the upper one turned a little, dropped onto each other and a floor from 5 mm each."""
    low = hapjax.Object(hapjax.Box((EDGE,) * 3), None, hapjax.Body(0.05), (0, 0, EDGE / 2 + 0.005))
    turn = quaternion((0.1, 0.2, 1), 0.2)
    high = hapjax.Object(
        hapjax.Box((EDGE,) * 3), None, hapjax.Body(0.05), (0.002, 0, 1.5 * EDGE + 0.012), turn
    )
    pairs = [
        hapjax.Contact(1e4, mu=0.5, damping=2.0, between=("low", "floor")),
        hapjax.Contact(1e4, mu=0.5, damping=2.0, between=("high", "low")),
    ]
    return hapjax.Scene(
        {"low": low, "high": high, "floor": hapjax.Object(hapjax.Plane())},
        dict(zip(names, pairs, strict=True)),
        world=WORLD,
        integrator=hapjax.Implicit(dt=5e-3),
    )


@pytest.mark.slow
def test_a_stack_that_is_dropped_settles_at_long_steps():
    scene = dropped_stack()
    end, replies = hapjax.rollout(scene, hapjax.init(scene, away(1)[0]), away(400))
    for name in ("low", "high"):
        assert np.linalg.norm(end.motion[name].velocity) < 1e-6
    height = np.asarray(replies.pose[:, :, 2])
    assert height.max(axis=0) == pytest.approx([EDGE / 2 + 0.005, 1.5 * EDGE + 0.012], abs=1e-3)
    assert height[-1] == pytest.approx([EDGE / 2, 1.5 * EDGE], abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["implicit", "lie_midpoint"])
def test_the_names_of_contacts_do_not_matter(method):
    places = []
    for names in (("a", "b"), ("b", "a")):
        scene = dataclasses.replace(dropped_stack(names), integrator=METHODS[method]())
        # As many steps as above, so that what was compiled there serves here too.
        _, replies = hapjax.rollout(scene, hapjax.init(scene, away(1)[0]), away(400))
        places.append(replies.pose[:100, :, :3])
    np.testing.assert_allclose(*places, rtol=0, atol=1e-12)


# Accuracy -------------------------------------------------------------------------------------------------


def test_a_block_slides_to_a_stop_as_it_should_at_first_order():
    speed, mu = 0.5, 0.4
    ends, steps = [], [4e-3, 2e-3, 1e-3]
    for dt in steps:
        scene = cube_on_floor(1e5, mu, height=EDGE / 2 - 0.05 * G / 4e5)
        scene = dataclasses.replace(scene, integrator=hapjax.Implicit(dt=dt))
        start = moving(hapjax.init(scene, away(1)[0]), "cube", velocity=(speed, 0, 0))
        ends.append(after(scene, start, round(0.4 / dt)).motion["cube"])
    errors = [abs(float(e.position[0]) - speed**2 / (2 * mu * G)) for e in ends]
    assert errors[-1] < 1e-3
    assert order(steps, errors) == pytest.approx(1, abs=0.2)
    assert np.linalg.norm(ends[-1].velocity) < 1e-9


def test_a_block_on_an_incline_holds_just_below_the_cone_and_slides_just_above():
    mu = 0.5
    for share, slides in ((0.99, False), (1.01, True)):
        tilt = np.arctan(share * mu)
        scene = cube_on_floor(1e5, mu, tilt=tilt)
        normal = np.array([np.sin(tilt), 0, np.cos(tilt)])
        state = hapjax.init(scene, away(1)[0])
        state = moving(state, "cube", position=(EDGE / 2 - 0.05 * G * np.cos(tilt) / 4e5) * normal)
        begun = after(scene, state, 500).motion["cube"]
        end = after(scene, state, 1500).motion["cube"]
        way = np.linalg.norm(end.position - begun.position)
        if slides:  # the block gathers speed with a = g (sin - mu cos)
            gain = np.linalg.norm(end.velocity) - np.linalg.norm(begun.velocity)
            assert gain == pytest.approx(G * (np.sin(tilt) - mu * np.cos(tilt)), rel=1e-3)
        else:
            assert way < 1e-12


def test_friction_is_within_the_cone_of_the_step_before():
    scene = cube_on_floor(2e3, 0.3, tilt=0.2, height=0.03)
    state = moving(hapjax.init(scene, away(1)[0]), "cube", velocity=(0.3, 0.1, 0), spin=(1, 2, 3))
    _, reply = hapjax.rollout(scene, state, away(400))
    touch = reply.contact["pair"]
    size = np.linalg.norm(touch.friction_force, axis=-1)
    assert size.max() > 0.01
    depth = np.asarray(touch.normal_force)
    assert np.all(size[1:] <= 0.3 * depth[:-1] * 1.5 + 1e-12)  # the loss is read at the velocity of now


def test_two_boxes_that_collide_keep_their_momentum():
    box = hapjax.Object(hapjax.Box((EDGE,) * 3), None, hapjax.Body(0.05), (0, 0, 0))
    other = hapjax.Object(hapjax.Box((0.05, 0.06, 0.04)), None, hapjax.Body(0.2), (0.06, 0.012, 0.008))
    pair = hapjax.Contact(1e7, mu=0.5, damping=0.5, between=("a", "b"))
    scene = hapjax.Scene({"a": box, "b": other}, {"pair": pair}, integrator=hapjax.Implicit())
    start = moving(hapjax.init(scene, away(1)[0]), "a", velocity=(1.0, 0.1, 0.0))
    end = after(scene, start, 100)
    assert end.motion["b"].velocity[0] > 0.05
    momentum = 0.05 * end.motion["a"].velocity + 0.2 * end.motion["b"].velocity
    np.testing.assert_allclose(momentum, [0.05, 0.005, 0.0], atol=1e-12)


# Derivatives ----------------------------------------------------------------------------------------------


def stacked():
    """Two cubes, one on the other, and a gentle pull to the side that friction holds."""
    low = hapjax.Object(hapjax.Box((0.05,) * 3), None, hapjax.Body(0.1), (0, 0, 0.0249))
    high = hapjax.Object(hapjax.Box((EDGE,) * 3), None, hapjax.Body(0.05), (0.001, 0, 0.0698))
    return hapjax.Scene(
        {"low": low, "cube": high, "floor": hapjax.Object(hapjax.Plane())},
        {
            "first": hapjax.Contact(1e4, mu=0.5, damping=2.0, between=("low", "floor")),
            "second": hapjax.Contact(8e3, mu=0.4, damping=2.0, between=("cube", "low")),
        },
        world=hapjax.World(gravity=(0.5, 0, -G)),
        integrator=hapjax.Implicit(),
    )


GRADIENTS = {
    "stick": (lambda: cube_on_floor(5e3, 0.6, tilt=0.3, height=0.0195), (0.0, 0.0, 0.0)),
    "slip": (lambda: cube_on_floor(5e3, 0.3, height=0.0199), (0.4, 0.2, 0.0)),
    "stacking": (stacked, (0.0, 0.0, 0.0)),
}


def chosen(scene):
    """The numbers by which the derivatives are taken."""
    contacts = [x for pair in scene.contact.values() for x in (pair.stiffness, pair.mu, pair.damping)]
    return [*contacts, scene.object["cube"].body.mass, scene.world.gravity, scene.integrator.dt]


def swayed(x, scene, velocity):
    """How the cube moves and what presses it after 40 steps, each chosen number p being p (1 + x)."""
    flat, unravel = ravel_pytree(chosen(scene))
    now = eqx.tree_at(chosen, scene, unravel(flat * (1 + x)))
    start = moving(hapjax.init(now, away(1)[0]), "cube", velocity=velocity)
    # Not rollout, whose reverse mode computes each step once more, and takes longer to compile.
    end, replies = jax.lax.scan(lambda s, hip: hapjax.step(now, s, hip), start, away(40))
    last = jnp.concatenate([touch.force[-1] for touch in replies.contact.values()])
    forces = jnp.sum(last * jnp.arange(1.0, 4.0)[None])
    motion: Any = end.motion["cube"]
    return jnp.concatenate([10 * motion.position, motion.velocity, motion.spin / 10, forces[None]])


@jax.jit
@functools.partial(jax.vmap, in_axes=(0, 0, None, None))
def pushed(x, way, scene, velocity):
    """What `swayed` gives, and its derivative along a way: one program for forward mode and differences."""
    return jax.jvp(lambda x: swayed(x, scene, velocity), (x,), (way,))


pulled = jax.jit(jax.jacrev(swayed))


@pytest.mark.slow
@pytest.mark.parametrize("case", GRADIENTS)
def test_gradients_are_those_of_differences(case):
    build, velocity = GRADIENTS[case]
    scene, velocity = build(), jnp.array(velocity)
    size = len(ravel_pytree(chosen(scene))[0])
    # Each number by itself at 0; then along ways on which all of them move, at points to either side of 0.
    ways = np.random.default_rng(1).choice([-1.0, 1.0], (3, size))
    points = np.array([-2, -1, 1, 2])
    axes = np.eye(len(points) * len(ways), size)
    slopes = np.asarray(pushed(jnp.zeros(axes.shape), jnp.asarray(axes), scene, velocity)[1])
    forward, reverse = slopes[:size].T, np.asarray(pulled(jnp.zeros(size), scene, velocity))
    scale = np.abs(forward).max()
    np.testing.assert_allclose(forward, reverse, atol=1e-9 * scale)
    off = np.full((len(ways), len(forward)), np.inf)
    for step in (1e-5, 1e-6, 1e-4):  # what one step shows needs no other
        places = jnp.asarray((step * points[:, None, None] * ways).reshape(axes.shape))
        values = np.asarray(pushed(places, jnp.zeros(axes.shape), scene, velocity)[0])
        values = values.reshape(len(points), len(ways), -1)
        numeric = np.tensordot([1, -8, 8, -1], values, axes=1) / (12 * step)
        off = np.minimum(off, np.abs(ways @ forward.T - numeric))
        if off.max() < 1e-5 * scale:
            break
    assert off.max() < 1e-5 * scale


@pytest.mark.parametrize("damping", [None, 2.0])
def test_from_exactly_on_the_floor_derivatives_are_those_of_one_side(damping):
    def end(height):
        scene = cube_on_floor(damping=damping, height=height)
        start = moving(hapjax.init(scene, away(1)[0]), "cube", velocity=(0.1, 0, 0))
        state = hapjax.rollout(scene, start, away(10))[0].motion["cube"]
        return jnp.concatenate([state.position, state.velocity, state.spin])

    step, ones = 1e-9, jnp.ones(3)
    places = EDGE / 2 + step * jnp.array([0.0, 1.0, -1.0])
    pushed = jax.jit(jax.vmap(lambda z, one: jax.jvp(end, (z,), (one,))))
    (here, high, low), (forward, *_) = map(np.asarray, pushed(places, ones))
    reverse = jax.jit(jax.jacrev(end))(places[0])
    above, below = (high - here) / step, (here - low) / step
    np.testing.assert_allclose(forward, reverse, atol=1e-9)
    off = [np.abs(forward - side).max() for side in (above, below)]
    assert min(off) < 1e-5 * np.abs(forward).max()


def test_neither_a_step_nor_its_gradient_calls_a_library():
    """A single call, of LAPACK say, forbids the compiler to make one function of a loop of steps, many times as fast."""
    scene = cube_on_floor(height=0.0199)
    state, hips = hapjax.init(scene, away(1)[0]), away(3)

    def end(scene):
        return jnp.sum(hapjax.rollout(scene, state, hips)[0].motion["cube"].position)

    said = jax.jit(jax.grad(end, allow_int=True)).lower(scene).as_text()
    assert "lapack" not in said and "dot_general" not in said


# A grasp at rest ------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("tilt", [0.0, 0.3])
@pytest.mark.parametrize("method", METHODS)
def test_a_held_object_does_not_creep(method, tilt):
    """Under 1 um in 60 s, on whichever side gravity pulls."""
    surface = hapjax.Surface(800.0, mu=0.8, damping=1.0)
    cube = hapjax.Object(hapjax.Box((0.06,) * 3), surface, hapjax.Body(0.1))
    world = hapjax.World(gravity=(G * np.sin(tilt), 0, -G * np.cos(tilt)))
    scene = hapjax.Scene({"cube": cube}, world=world, integrator=METHODS[method]())
    hip = jnp.array([[0.0275, 0.0, 0.0], [-0.0285, 0.01, 0.0], [-0.0285, -0.01, 0.0]])

    @jax.jit
    def hold(state, steps):
        return jax.lax.fori_loop(0, steps, lambda _, s: hapjax.step(scene, s, hip)[0], state)

    settled = hold(hapjax.init(scene, hip), 5000)
    end = hold(settled, 60_000)
    assert np.abs(settled.motion["cube"].position).max() < 5e-3  # it is held, and has not fallen
    assert np.linalg.norm(end.motion["cube"].position - settled.motion["cube"].position) < 1e-6
