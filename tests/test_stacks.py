"""Objects on objects for long: stacks that stand and are lifted, and what is round and rolls."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import hapjax
from helpers import G, away, matrix, quaternion

MASS = 0.05
UPRIGHT = (1.0, 0.0, 0.0, 0.0)

# Stacks ---------------------------------------------------------------------------------------------------

EDGE = 0.04


def stack(yaw=0.0, offset=0.0, dt=1e-3):
    """Three 50 g cubes on each other on a floor; fingers feel the lowest."""
    surface = hapjax.Surface(1000.0, mu=1.0, damping=1.0)
    objects = {
        f"cube{i}": hapjax.Object(
            hapjax.Box((EDGE,) * 3),
            surface if i == 0 else None,
            hapjax.Body(MASS),
            (i * offset, 0, EDGE / 2 + i * EDGE),
            quaternion((0, 0, 1), i * yaw) if yaw else UPRIGHT,
        )
        for i in range(3)
    }
    objects["floor"] = hapjax.Object(hapjax.Plane())
    kind: dict[str, Any] = dict(mu=0.6, damping=2.0)
    contacts = {"on_floor": hapjax.Contact(2e3, between=("cube0", "floor"), **kind)}
    for i in (1, 2):
        contacts[f"cube{i}_on"] = hapjax.Contact(2e3, between=(f"cube{i}", f"cube{i - 1}"), **kind)
    world = hapjax.World((0, 0, -G), gyroscopic=True)
    return hapjax.Scene(objects, contacts, None, world, hapjax.SemiImplicit(dt))


@pytest.mark.slow
@pytest.mark.parametrize(("yaw", "offset"), [(0.0, 0.0), (0.3, 0.0), (0.0, 1e-6), (0.0, 4e-3), (1e-6, 4e-3)])
def test_a_stack_of_three_cubes_stands_for_ten_seconds(yaw, offset):
    """Also with faces that lie flush, and where each cube stands aside of the one below."""
    scene = stack(yaw, offset)
    hips = away(10_000)
    state, replies = hapjax.rollout(scene, hapjax.init(scene, hips[0]), hips)
    pose = np.asarray(replies.pose)
    moved = pose[-1] - pose[0]
    if offset < 1e-3:
        assert np.abs(pose[-1] - pose[3000]).max() < 1e-6
        assert np.abs(moved[:, :2]).max() < 1e-6
    assert np.abs(pose[-1] - pose[-1000]).max() < 1e-4  # a wobble dies down slowly, at the rate c g / 2
    assert np.abs(moved[:, :3]).max() < 6e-4
    for i, name in enumerate(scene.contact):
        weight = replies.contact[name].normal_force[-1000:].sum(axis=1).mean()
        assert weight == pytest.approx((3 - i) * MASS * G, rel=1e-3 if offset < 1e-3 else 1e-2)


@pytest.mark.slow
@pytest.mark.parametrize(("number", "aside"), [(jnp.float64, 0.0), (jnp.float64, 1e-3), (jnp.float32, 1e-3)])
def test_two_fingers_that_lift_the_lowest_cube_carry_all_three(number, aside):
    """With fingers that hold in twist: about the line of two points a stack is a pendulum upside down."""
    scene = eqx.tree_at(lambda s: s.torsion, stack(), hapjax.GravityDrop(1e-7), is_leaf=lambda x: x is None)
    scene = hapjax.cast(scene, number)
    t = np.arange(4000) / 1000
    squeeze = EDGE / 2 - 4e-3 * np.clip(t / 0.5, 0, 1)
    height = EDGE / 2 + 0.03 * np.clip((t - 1) / 1, 0, 1)
    hips = np.stack(
        [np.stack([x, 0 * t + aside, height], axis=-1) for x in (squeeze + 1e-3, -squeeze - 1e-3)], axis=1
    )
    state, replies = hapjax.rollout(scene, hapjax.init(scene, hips[0]), jnp.asarray(hips, number))
    assert np.asarray(replies.contact["on_floor"].normal_force[-1]).sum() == 0  # off the floor
    lifted = np.asarray(replies.pose)[-1, :, 2] - np.asarray(replies.pose)[900, :, 2]
    assert lifted == pytest.approx(np.full(3, 0.03), abs=2e-3)
    pull = np.asarray(replies.force)[-1, :, 2]
    assert pull.sum() == pytest.approx(-3 * MASS * G, rel=2e-3)
    assert replies.contact["cube1_on"].normal_force[-1].sum() == pytest.approx(2 * MASS * G, rel=5e-3)


# Rolling --------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize(
    ("shape", "share"), [(hapjax.Cylinder(0.03, 0.05), 2 / 3), (hapjax.Capsule(0.03, 0.05), None)]
)
@pytest.mark.parametrize("below", [hapjax.Plane(), hapjax.Box((0.6, 0.6, 0.02))])
def test_what_is_round_rolls_down_a_slope_without_a_bump(shape, share, below):
    """A rolling thing falls with 1 / (1 + I / m r^2) of the pull along the slope; of a cylinder that is 2/3."""
    slope = 0.2
    ratio = float(shape.inertia_per_mass()[2]) / 0.03**2
    share = 1 / (1 + ratio) if share is None else share
    tilt = quaternion((0, 1, 0), slope)
    turn = matrix(tilt)
    top = 0.01 if isinstance(below, hapjax.Box) else 0.0
    place = (top + 0.03 - MASS * G * np.cos(slope) / (2 * 2e4)) * turn[:, 2]
    lying = quaternion((1, 0, 0), np.pi / 2)
    w, x = tilt[0] * lying[0], tilt[0] * lying[1]
    both = (w, x, tilt[2] * lying[0], -tilt[2] * lying[1])
    thing = hapjax.Object(shape, None, hapjax.Body(MASS), place, both)
    pair = hapjax.Contact(2e4, mu=0.6, damping=1.0, between=("it", "below"))
    scene = hapjax.Scene(
        {"it": thing, "below": hapjax.Object(below, orientation=tilt)},
        {"pair": pair},
        None,
        hapjax.World((0, 0, -G)),
        hapjax.SemiImplicit(2e-4),
    )
    hips = away(2000)
    state, _ = hapjax.rollout(scene, hapjax.init(scene, hips[0]), hips)
    speed = float(state.motion["it"].velocity @ jnp.asarray(turn[:, 0]))
    assert speed == pytest.approx(share * G * np.sin(slope) * 0.4, rel=1e-2)
