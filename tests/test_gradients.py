"""Derivatives of 500 steps with respect to every number of the scene: forward, reverse, and by differences.

Each number p of the scene is moved as p + scale x, with scale |p| (or the largest of its leaf where it is 0), so that
all derivatives with respect to x can be compared with each other.
"""

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.flatten_util import ravel_pytree

import hapjax
from helpers import G, matrix, moving, quaternion

STEPS = 500
# These programs run once: compiling them well would take many times as long as running them.
compiled = functools.partial(
    jax.jit, compiler_options={"xla_cpu_use_fusion_emitters": False, "xla_backend_optimization_level": 0}
)
GRAVITY = hapjax.World(gravity=(0.1, -0.2, -G), gyroscopic=True)
TURNED_Z, LYING = quaternion((0, 0, 1), 0.3), quaternion((1, 0.2, 0), np.pi / 2)
TURNED, PLACE = quaternion((1, 2, -1), 0.3), np.array([0.01, 0.02, 0.005])
TURN = matrix(TURNED)


def glide(start, *pieces):
    """A finger's path (STEPS, 3) that goes from `start` by each piece in turn, with a little sway in every axis."""
    corners = np.vstack([start, start + np.cumsum(pieces, axis=0)])
    at = np.linspace(0, len(pieces), STEPS)
    path = np.stack([np.interp(at, np.arange(len(corners)), c) for c in corners.T], axis=-1)
    return path + 2e-5 * np.sin(np.linspace(0, 20, STEPS)[:, None] + np.arange(3))


def stick():
    plane = hapjax.Object(hapjax.Plane(), hapjax.Surface(800.0, mu=0.6, damping=1.0), None, PLACE, TURNED)
    scene = hapjax.Scene(object={"it": plane})
    path = glide([0.01, 0.02, -1e-3], [0, 0, -1e-3], [3e-4, 2e-4, 0], [0, 0, 2e-4], [-3e-4, 0, 0])
    hips = (path @ TURN.T + PLACE)[:, None]
    return scene, hapjax.init(scene, hips[0]), hips


def slip():
    """A finger on each kind of shape and of friction, far from each other; each slides, lifts a little, turns back."""
    damped = hapjax.Surface(800.0, mu_static=0.8, mu_kinetic=0.5, damping=1.0)
    shapes = {
        "plane": (hapjax.Plane(), hapjax.Surface(800.0, mu=0.6, damping=1.0), np.zeros(3)),
        "ball": (hapjax.Sphere(0.05), damped, np.array([0, 0, 1.0])),
        "box": (
            hapjax.Box((0.06, 0.08, 0.1)),
            hapjax.Surface(800.0, mu=np.arange(3, 9) / 10),
            np.array([0, 0, 2.0]),
        ),
        "cylinder": (
            hapjax.Cylinder(0.03, 0.1),
            hapjax.Surface(800.0, mu=0.5, damping=1.0),
            np.array([0, 0, 0.4]),
        ),
        "capsule": (
            hapjax.Capsule(0.03, 0.05),
            hapjax.Surface(800.0, mu=0.5, tangential_stiffness=600.0, anisotropy=0.7, grain=(0.2, 1.0, 0.3)),
            np.array([0, 0, 0.7]),
        ),
    }
    paths = [
        glide([0.01, 0.02, -1e-3], [0, 0, -1e-3], [2e-2, 1e-2, 0], [0, 0, 2e-4], [-6e-3, -3e-3, 0]),
        glide([0.01, 0.02, 0.042], [0.01, 0, -1e-3], [0.01, -0.01, -5e-3], [-0.01, -0.01, 1e-3]),
        glide([0.01, 0.01, 0.048], [0.01, 0, -1e-3], [-0.01, -0.02, 0], [-0.01, 5e-3, 1e-3]),
        glide([0.024, 0.016, 0.01], [-2e-3, -1e-3, 0.01], [-0.01, 0.012, -5e-3], [1e-3, 1e-3, 0.01]),
        glide([0.024, 0.016, 0.01], [-2e-3, -1e-3, 0.01], [-0.01, 0.01, 5e-3], [1e-3, 1e-3, 5e-3]),
    ]
    objects, hips = {}, []
    for (name, (shape, surface, height)), path in zip(shapes.items(), paths, strict=True):
        objects[name] = hapjax.Object(shape, surface, None, PLACE + TURN @ height, TURNED)
        hips.append((path + height) @ TURN.T + PLACE)
    scene, hips = hapjax.Scene(object=objects), np.stack(hips, axis=1)
    return scene, hapjax.init(scene, hips[0]), hips


def grasp(**law):
    """Three fingers lift a box with its centre of mass off its middle, and carry it."""
    surface = hapjax.Surface(800.0, damping=1.0, **law)
    inertia = np.array([[1.2, 0.1, 0.0], [0.1, 1.4, 0.05], [0.0, 0.05, 1.1]]) * 1e-4
    body = hapjax.Body(0.12, inertia=inertia, centre=(1e-3, -2e-3, 3e-3))
    box = hapjax.Object(
        hapjax.Box((0.06, 0.05, 0.07)), surface, body, (0.0, 0.0, 0.05), quaternion((0, 0, 1), 0.05)
    )
    world = hapjax.World(GRAVITY.gravity, gyroscopic=True, dead_band=1e-7)
    scene = hapjax.Scene(object={"it": box}, world=world)
    lift = ([2e-3, 1e-3, 0.01], [0.01, 0, 0.01], [0.0, -4e-3, 0.0])
    starts = [[0.0277, 0.012, 0.05], [0.0277, -0.012, 0.052], [-0.0265, 0.001, 0.051]]
    hips = np.stack([glide(np.array(s), *lift) for s in starts], axis=1)
    return scene, hapjax.init(scene, hips[0]), hips


def floor(**law):
    """A box of uniform density slides over a tilted floor, turns about its normal, and comes to rest."""
    tilt = quaternion((1, 0.5, 0), 0.1)
    up = matrix(tilt)[:, 2]
    box = hapjax.Object(hapjax.Box((0.06, 0.05, 0.04)), None, hapjax.Body(0.2), (0.02 - 2.0e-4) * up, tilt)
    scene = hapjax.Scene(
        object={"it": box, "floor": hapjax.Object(hapjax.Plane(), orientation=tilt)},
        contact={"pair": hapjax.Contact(4000.0, damping=2.0, between=("it", "floor"), **law)},
        world=GRAVITY,
    )
    hips = np.full((STEPS, 1, 3), 5.0)
    state = moving(hapjax.init(scene, hips[0]), "it", velocity=(0.2, 0.1, 0.0), spin=(0.02, 0.03, 1.5))
    return scene, state, hips


def ball_on_floor():
    """A ball slides, and ends up rolling; MHS's matrix form integrates."""
    ball = hapjax.Object(hapjax.Sphere(0.03), None, hapjax.Body(0.2), (0.0, 0.0, 0.0296))
    scene = hapjax.Scene(
        object={"it": ball, "floor": hapjax.Object(hapjax.Plane())},
        contact={"pair": hapjax.Contact(5000.0, mu=0.3, damping=1.0, between=("it", "floor"))},
        world=hapjax.World(gravity=(0.1, -0.2, -G)),
        integrator=hapjax.SemiImplicitMatrix(),
    )
    hips = np.full((STEPS, 1, 3), 5.0)
    return scene, moving(hapjax.init(scene, hips[0]), "it", velocity=(0.3, 0.1, 0.0)), hips


def stack():
    """A box lies turned across a fixed thin beam, whose edges cross its own; a free capsule lies across the box."""
    kind: dict[str, Any] = dict(mu=0.4, damping=2.0)
    scene = hapjax.Scene(
        object={
            "it": hapjax.Object(
                hapjax.Box((0.06, 0.05, 0.04)), None, hapjax.Body(0.2), (0, 0, 0.0248), TURNED_Z
            ),
            "beam": hapjax.Object(hapjax.Box((0.2, 0.006, 0.01))),
            "rod": hapjax.Object(hapjax.Capsule(0.01, 0.09), None, hapjax.Body(0.05), (0, 0, 0.0547), LYING),
        },
        contact={
            "pair": hapjax.Contact(4000.0, between=("it", "beam"), **kind),
            "above": hapjax.Contact(3000.0, between=("rod", "it"), **kind),
        },
        world=hapjax.World((0.1, -0.2, -G)),
        integrator=hapjax.SemiImplicit(2e-4),
    )
    hips = np.full((100, 1, 3), 5.0)  # its many pairs of edges take long
    return scene, moving(hapjax.init(scene, hips[0]), "it", velocity=(0.02, 0.01, 0.0)), hips


def gravity_drop(**law):
    """Two fingers hold a box above its centre; it swings about their line with what torsion leaves of the torque."""
    box = hapjax.Object(
        hapjax.Box((0.06, 0.06, 0.1)),
        hapjax.Surface(800.0, damping=1.0, **law),
        hapjax.Body(0.1, inertia=(1.1e-4, 1.0e-4, 0.9e-4)),
        (0.0, 0.0, 0.0),
        quaternion((1, 0, 0), 0.5),
    )
    scene = hapjax.Scene(
        object={"it": box},
        torsion=hapjax.GravityDrop(6e-5, twist_damping=1e-4),
        world=GRAVITY,
        integrator=hapjax.SemiImplicit(),
    )
    lift = ([1e-3, 0.0, 2e-3], [0.0, 1e-3, 2e-3])
    starts = [[0.0267, -0.008, 0.018], [-0.0263, -0.008, 0.0185]]
    hips = np.stack([glide(np.array(s), *lift) for s in starts], axis=1)
    return scene, hapjax.init(scene, hips[0]), hips


# Each case with the numbers of its scene that have no say in it.
CASES = {
    "stick": (stick, {".object['it'].surface.mu"}),
    "slip": (
        slip,
        {
            ".object['ball'].orientation",
            ".object['ball'].surface.mu_static",
            ".object['cylinder'].shape.length",
        },
    ),
    "grasp": (functools.partial(grasp, mu=0.9), {".object['it'].surface.mu", ".world.dead_band"}),
    "floor": (functools.partial(floor, mu=0.4), set()),
    "floor, kinetic": (
        functools.partial(floor, mu_static=0.55, mu_kinetic=0.35),
        {".contact['pair'].mu_static"},
    ),
    "ball on the floor": (ball_on_floor, set()),
    "stack": (stack, {".contact['pair'].mu"}),
    "gravity drop, kinetic": (
        functools.partial(gravity_drop, mu_static=0.9, mu_kinetic=0.7, finger_mu=(1.0, 0.9)),
        {".object['it'].surface.mu_kinetic"},
    ),
}


def restart(scene, state, hip):
    """The start of a scene with the state's velocities, so that what depends on places is differentiated too."""
    fresh = hapjax.init(scene, hip)
    for name, motion in state.motion.items():
        fresh = moving(fresh, name, velocity=motion.velocity)
        if motion.spin is not None:
            fresh = moving(fresh, name, spin=motion.spin)
    return fresh


def _scale(leaf):
    return jnp.where(leaf == 0, jnp.maximum(jnp.max(jnp.abs(leaf)), 1e-2), jnp.abs(leaf))


def function_of(case):
    """Two smooth weighted sums of all forces and poses over x, and the number and path of each x."""
    scene, state, hips = case()
    hips = jnp.asarray(hips)
    steps = len(hips)
    flat, unravel = ravel_pytree(scene)
    scales = ravel_pytree(jax.tree.map(_scale, scene))[0]
    rows = [jnp.asarray(w) for w in np.random.default_rng(4).standard_normal((3, 2, STEPS))[..., :steps]]

    def f(x):
        now = unravel(flat + scales * x)
        _, replies = hapjax.rollout(now, restart(now, state, hips[0]), hips)
        force = replies.force.reshape(steps, -1)
        sums = [rows[0] @ force @ jnp.cos(jnp.arange(force.shape[1], dtype=float))]
        if replies.pose.size:
            pose = replies.pose.reshape(steps, -1)
            sums.append(100 * rows[1] @ pose @ jnp.cos(1 + jnp.arange(pose.shape[1], dtype=float)))
        for touch in replies.contact.values():
            push = touch.force.reshape(steps, -1)
            sums.append(rows[2] @ push @ jnp.cos(2 + jnp.arange(push.shape[1], dtype=float)))
        return sum(sums) / steps

    paths = []
    for path, leaf in jax.tree_util.tree_leaves_with_path(scene):
        paths += [jax.tree_util.keystr(path)] * leaf.size
    return f, len(flat), paths


def differences(f, size):
    """Central differences of fourth order, with several steps.

    A long step runs over a touch or a break-away, where f has a kink; a short one drowns in rounding.
    """
    batch = compiled(jax.vmap(f))
    for step in (2.5e-6, 1e-5, 4e-5, 1.6e-4, 6.4e-4):
        offsets = step * np.array([-2, -1, 1, 2])[:, None, None] * np.eye(size)
        values = np.asarray(batch(jnp.asarray(offsets.reshape(-1, size)))).reshape(4, size, -1)
        yield np.tensordot(np.array([1, -8, 8, -1]) / (12 * step), values, axes=1)


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_forward_reverse_and_differences_agree(case):
    build, idle = CASES[case]
    f, size, paths = function_of(build)
    x = jnp.zeros(size)
    forward = np.asarray(compiled(jax.jacfwd(f))(x)).T
    reverse = np.asarray(compiled(jax.jacrev(f))(x)).T
    largest = np.abs(forward).max(axis=0)
    assert np.abs(forward - reverse).max() <= 1e-10 * largest.min()
    at_work = {
        path for path, row in zip(paths, forward, strict=True) if np.abs(row).max() > 1e-12 * largest.max()
    }
    assert set(paths) - at_work == idle
    off = np.full_like(forward, np.inf)
    for numeric in differences(f, size):  # what one step shows needs no other
        off = np.minimum(off, np.abs(forward - numeric) / (np.abs(forward) + 1e-4 * largest))
        if off.max() < 1e-6:
            break
    assert off.max() < 1e-6, paths[int(np.argmax(off.max(axis=1)))]


# Singular points ------------------------------------------------------------------------------------------


def total(scene, state, hip):
    """One number out of two steps, so that what the first remembers is differentiated as well."""
    numbers = eqx.filter(hapjax.rollout(scene, state, jnp.stack([hip, hip])), eqx.is_inexact_array)
    everything = ravel_pytree(numbers)[0]
    return jnp.sum(jnp.sin(1 + everything))


_value = compiled(total)
_forward, _reverse = (compiled(jacobian(total, (0, 2))) for jacobian in (jax.jacfwd, jax.jacrev))


def is_finite(scene, state, hip):
    """Value and derivatives by scene and fingers are finite, and both modes agree."""
    assert np.isfinite(_value(scene, state, hip))
    both = (jax.tree.leaves(gradient(scene, state, hip)) for gradient in (_forward, _reverse))
    for a, b in zip(*both, strict=True):
        assert np.all(np.isfinite(a)) and np.all(np.isfinite(b))
        assert a == pytest.approx(np.asarray(b), rel=1e-9, abs=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("mu", [0.0, 0.6])
def test_no_nan_at_singular_places_of_fixed_surfaces(mu):
    surface = hapjax.Surface(800.0, mu_static=mu, mu_kinetic=mu, damping=1.0)
    scene = hapjax.Scene(
        object={
            "plane": hapjax.Object(hapjax.Plane(), surface, position=(0, 0, -1.0)),
            "ball": hapjax.Object(hapjax.Sphere(0.05), surface),
            "box": hapjax.Object(hapjax.Box((0.06, 0.06, 0.06)), surface, position=(1.0, 0, 0)),
        }
    )
    hip = np.array(
        [
            [0.3, 0.2, -1.0],  # on the plane: depth exactly 0
            [0.3, 0.2, -1.001],  # in it, without offset
            [0.0, 0.0, 0.0],  # at the ball's centre
            [0.05, 0.0, 0.0],  # on the ball
            [1.0, 0.0, 0.0],  # at the box's centre: six faces tie
            [1.02, 0.02, 0.02],  # three faces tie
            [1.03, 0.0, 0.0],  # on a face
            [1.03, 0.03, 0.03],  # on a corner
        ]
    )
    is_finite(scene, hapjax.init(scene, hip), jnp.asarray(hip))


@pytest.mark.slow
@pytest.mark.parametrize("mu", [0.0, 0.6])
@pytest.mark.parametrize("apart", [True, False])
def test_no_nan_at_singular_places_of_a_grasp(mu, apart):
    # At rest, not turned, without torque; corners exactly on the floor.
    box = hapjax.Object(
        hapjax.Box((0.06, 0.06, 0.06)),
        hapjax.Surface(800.0, mu=mu, damping=1.0),
        hapjax.Body(0.2),
        (0, 0, 0.03),
    )
    scene = hapjax.Scene(
        object={"it": box, "floor": hapjax.Object(hapjax.Plane())},
        contact={"pair": hapjax.Contact(5000.0, mu=mu, damping=1.0, between=("it", "floor"))},
        torsion=hapjax.GravityDrop(2e-5, twist_damping=1e-4),
        world=hapjax.World(gravity=(0, 0, -G), gyroscopic=True, dead_band=0.0),
    )
    # Together, the two fingers' god-objects are one point, and their line has no direction.
    hip = jnp.array([[0.029, 0, 0.03], [-0.029 if apart else 0.029, 0, 0.03]])
    is_finite(scene, hapjax.init(scene, hip), hip)


@pytest.mark.slow
def test_no_nan_on_the_edge_of_the_cone():
    scene = hapjax.Scene(object={"it": hapjax.Object(hapjax.Plane(), hapjax.Surface(512.0, mu=0.5))})
    deep = 2.0**-9
    state = hapjax.init(scene, np.array([[0, 0, -deep]]))
    state, _ = hapjax.step(scene, state, jnp.array([[0, 0, -deep]]))
    hip = jnp.array([[0.5 * deep, 0, -deep]])  # in powers of 2: |g - s| is mu d to the last bit
    _, reply = hapjax.step(scene, state, hip)
    assert jnp.abs(reply.force[0, 0]) == 0.5 * reply.force[0, 2]
    is_finite(scene, state, hip)
