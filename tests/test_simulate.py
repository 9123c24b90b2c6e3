"""init, step and rollout as a whole: what they agree on with each other, with turned worlds and with batches."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hapjax
from helpers import G, matrix, quaternion

STEPS = 60


def lively(substeps=1, dt=1e-3):
    """Every part at once: a cube between fingers over a floor, and a ball that is fixed."""
    surface = hapjax.Surface(800.0, mu_static=0.8, mu_kinetic=0.6, damping=1.0)
    cube = hapjax.Object(
        hapjax.Box((0.06, 0.05, 0.06)),
        surface,
        hapjax.Body(0.2, inertia=(1.2e-4, 1.0e-4, 1.1e-4), centre=(1e-3, 0, 2e-3)),
        position=(0, 0, 0.0295),
        orientation=quaternion((0, 0, 1), 0.1),
    )
    return hapjax.Scene(
        object={
            "cube": cube,
            "ball": hapjax.Object(
                hapjax.Sphere(0.02), hapjax.Surface(500.0, mu=0.3), position=(0.03, 0.05, 0.03)
            ),
            "floor": hapjax.Object(hapjax.Plane(), hapjax.Surface(900.0, mu=0.2)),
        },
        contact={"cube_on_floor": hapjax.Contact(3000.0, mu=0.5, damping=0.5, between=("cube", "floor"))},
        torsion=hapjax.GravityDrop(6e-5, twist_damping=1e-4),
        world=hapjax.World((0, 0, -G), gyroscopic=True, dead_band=1e-6),
        integrator=hapjax.SemiImplicit(dt, substeps),
    )


def fingers(steps=STEPS):
    """Two fingers that pinch the cube and lift it, and one that strays over the ball and the floor."""
    starts = np.array([[0.0285, 0.003, 0.035], [-0.028, -0.002, 0.034], [0.03, 0.04, 0.035]])
    t = np.linspace(0, 1, steps)[:, None, None]
    toll = np.array([[-1e-3, 0, 0.02], [1e-3, 0, 0.02], [1e-2, 5e-3, -0.04]])
    return starts + t * toll


def play(scene, hips):
    state = hapjax.init(scene, hips[0])
    return jax.tree.map(
        np.asarray, hapjax.rollout(scene, state, jnp.asarray(hips, hapjax.scene.dtype_of(scene)))
    )


def close(a, b, tolerance):
    pairs = zip(jax.tree.leaves(a), jax.tree.leaves(b), strict=True)
    return all(np.allclose(x, y, rtol=0, atol=tolerance) for x, y in pairs)


def test_rollout_is_step_after_step(dtype):
    scene, hips = hapjax.cast(lively(), dtype), fingers().astype(dtype)
    final, replies = play(scene, hips)
    state = hapjax.init(scene, hips[0])
    for k, hip in enumerate(hips[:5]):
        state, reply = hapjax.step(scene, state, jnp.asarray(hip))
        assert close(reply, jax.tree.map(lambda x, k=k: x[k], replies), 2e3 * float(jnp.finfo(dtype).eps))
    assert {leaf.dtype for leaf in jax.tree.leaves((state, reply, final, replies))} == {
        dtype,
        jnp.dtype(bool),
    }
    assert all(np.all(np.isfinite(leaf)) for leaf in jax.tree.leaves((final, replies)))


def test_the_packed_step_is_the_step(dtype):
    scene, hips = hapjax.cast(lively(), dtype), fingers().astype(dtype)
    _, replies = play(scene, hips)
    packed = hapjax.pack(scene, hips[0])
    memory = packed.start
    for hip, force in zip(hips[:10], replies.force, strict=False):
        memory = packed.call(memory, hip)
        assert packed.force(memory) == pytest.approx(force, abs=2e3 * float(jnp.finfo(dtype).eps))
    assert packed.force(memory).dtype == packed.dtype == dtype
    assert packed.state(memory).motion["cube"].position == pytest.approx(replies.pose[9, 0, :3], abs=1e-6)


def test_a_packed_step_begins_where_the_fingers_are(dtype):
    """Also where that is not where it was compiled for."""
    scene, hips = hapjax.cast(lively(), dtype), fingers().astype(dtype)
    packed = hapjax.pack(scene, hips[0])
    np.testing.assert_array_equal(packed.begin(hips[0]), packed.start)
    begun = packed.state(jnp.asarray(packed.begin(hips[-1])))
    jax.tree.map(np.testing.assert_array_equal, begun, hapjax.init(scene, hips[-1]))
    assert np.any(packed.begin(hips[-1]) != packed.start)


def test_forces_of_all_objects_add_up():
    _, replies = play(lively(), fingers())
    total = np.zeros_like(replies.force)
    poses = {"cube": replies.pose[:-1, 0, 3:]}
    for name, touch in replies.touch.items():
        turns = [matrix(q) for q in poses[name]] if name in poses else [np.eye(3)] * (STEPS - 1)
        first = matrix(quaternion((0, 0, 1), 0.1)) if name in poses else np.eye(3)
        total += np.einsum("tij,tfj->tfi", np.array([first, *turns[: STEPS - 1]]), touch.force)
    assert all(np.abs(touch.force).max() > 0.1 for touch in replies.touch.values())
    assert total == pytest.approx(replies.force, abs=1e-12)


def test_step_after_substeps_is_a_finer_dt():
    coarse, fine = lively(substeps=4), lively(dt=2.5e-4)
    hips = fingers(STEPS // 4)
    # The same straight paths between the same places: the first of them is where the fingers start.
    between = hips[:-1, None] + np.arange(1, 5)[:, None, None] / 4 * (hips[1:] - hips[:-1])[:, None]
    path = np.concatenate([np.repeat(hips[:1], 4, axis=0), between.reshape(-1, 3, 3)])
    final, replies = play(coarse, hips)
    end, finer = play(fine, path)
    assert close(replies, jax.tree.map(lambda x: x[3::4], finer), 1e-9)
    assert close(final.motion, end.motion, 1e-9)


def test_a_world_that_is_turned_and_shifted_feels_the_same():
    scene, hips = lively(), fingers()
    turn, shift = Rotation.from_rotvec([0.4, -0.9, 0.3]), np.array([0.2, -0.1, 0.4])
    objects = {
        name: hapjax.Object(
            thing.shape,
            thing.surface,
            thing.body,
            turn.apply(np.array(thing.position)) + shift,
            (turn * Rotation.from_quat(np.array(thing.orientation), scalar_first=True)).as_quat(
                scalar_first=True
            ),
        )
        for name, thing in scene.object.items()
    }
    world = hapjax.World(turn.apply(np.array([0, 0, -G])), True, scene.world.dead_band)
    other = hapjax.Scene(objects, scene.contact, scene.torsion, world, scene.integrator)
    _, here = play(scene, hips)
    _, there = play(other, hips @ turn.as_matrix().T + shift)
    assert there.force == pytest.approx(here.force @ turn.as_matrix().T, abs=1e-9)
    assert there.pose[:, 0, :3] == pytest.approx(here.pose[:, 0, :3] @ turn.as_matrix().T + shift, abs=1e-11)
    assert close(there.touch, here.touch, 1e-9)


@pytest.mark.slow
def test_scenes_in_a_batch_are_scenes_one_by_one():
    scene, hips = lively(), fingers()

    def stiffer(factor):
        return eqx.tree_at(
            lambda s: s.object["cube"].surface.stiffness, scene, replace_fn=lambda x: x * factor
        )

    def run(factor):
        now = stiffer(factor)
        return hapjax.rollout(now, hapjax.init(now, hips[0]), jnp.asarray(hips))[1]

    factors = jnp.array([0.7, 1.0, 1.5])
    together = jax.jit(jax.vmap(run))(factors)
    for k, factor in enumerate(factors):
        _, one = play(stiffer(factor), hips)
        assert close(one, jax.tree.map(lambda x, k=k: x[k], together), 1e-9)
    assert not np.allclose(together.force[0], together.force[2])


def test_fingers_do_not_feel_each_other_on_a_fixed_object(dtype):
    scene = hapjax.Scene(
        object={"it": hapjax.Object(hapjax.Plane(), hapjax.Surface(800.0, mu=0.6, damping=1.0))}
    )
    scene, hips = hapjax.cast(scene, dtype), fingers(20).astype(dtype) - np.array([0, 0, 0.04], dtype)
    _, together = play(scene, hips)
    for finger in range(3):
        _, alone = play(scene, hips[:, finger : finger + 1])
        assert alone.force[:, 0] == pytest.approx(together.force[:, finger], abs=1e-6)
    assert np.abs(together.force).max() > 1


def test_poses_and_names_keep_the_order_of_the_scene():
    def thing(x):
        return hapjax.Object(hapjax.Sphere(0.01), hapjax.Surface(100.0, mu=0.5), hapjax.Body(0.1), (x, 0, 0))

    scene = hapjax.Scene(object={"zulu": thing(1.0), "alpha": thing(2.0), "mike": thing(3.0)})
    state, reply = hapjax.step(scene, hapjax.init(scene, np.zeros((1, 3))), np.zeros((1, 3)))
    assert list(state.motion) == list(reply.touch) == ["zulu", "alpha", "mike"]
    assert np.array_equal(reply.pose[:, 0], [1, 2, 3])
    assert np.array_equal(reply.pose[:, 3:], np.tile([1.0, 0, 0, 0], (3, 1)))


def test_a_start_at_rest_with_an_orientation_that_is_not_of_unit_length():
    scene = lively()
    scene = eqx.tree_at(lambda s: s.object["cube"].orientation, scene, 3 * scene.object["cube"].orientation)
    state = hapjax.init(scene, fingers()[0])
    assert np.linalg.norm(state.motion["cube"].orientation) == pytest.approx(1)
    assert np.array_equal(state.motion["cube"].velocity, np.zeros(3))


@pytest.mark.parametrize(
    ("hip", "words"),
    [
        (np.zeros((0, 3)), "shape"),
        (jnp.zeros((1, 3), jnp.float32), "float32"),
    ],
)
def test_hips_of_a_wrong_shape_or_type_are_refused(hip, words):
    with pytest.raises(hapjax.InputError, match=words):
        hapjax.init(lively(), hip)


def test_a_state_of_another_scene_is_refused():
    scene = hapjax.Scene(object={"it": hapjax.Object(hapjax.Plane(), hapjax.Surface(800.0, mu=0.6))})
    cut = hapjax.Scene(scene.object, integrator=hapjax.SemiImplicit(substeps=2))
    with pytest.raises(hapjax.InputError, match="substeps"):
        hapjax.step(cut, hapjax.init(scene, np.zeros((1, 3))), np.zeros((1, 3)))


def test_a_scene_without_anything_to_touch_has_no_force(dtype):
    scene = hapjax.cast(hapjax.Scene({"floor": hapjax.Object(hapjax.Plane())}), dtype)
    end, reply = hapjax.rollout(scene, hapjax.init(scene, np.zeros((2, 3))), jnp.ones((3, 2, 3), dtype))
    assert not jax.tree.leaves(end) and not np.any(reply.force) and not np.any(reply.lost)
