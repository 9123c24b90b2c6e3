"""Measured samples beside the model's: which time belongs to which step."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hapjax import Body, InputError, Object, Recording, Scene, Sphere, Surface, World, rollout
from hapjax_fitting.observation import Noise, observation_of, predicted, residuals
from hapjax_fitting.parameters import Parameter
from hapjax_fitting.problem import Problem, channels_of, stacked_residuals
from hapjax_fitting.transform import Identity

K, DEPTH, G = 1000.0, 1e-3, 9.81
CHANNELS = ("force", "pose")
AWAY = [5.0, 0.0, 0.0]


def ball(fixed=True) -> Scene:
    """A ball of radius 1 m that either stays or falls."""
    body = None if fixed else Body(2.0)
    world = World() if fixed else World(gravity=(0.0, 0.0, -G))
    return Scene(object={"ball": Object(Sphere(1.0), Surface(K, mu=0.5), body)}, world=world)


def push(times, depths) -> np.ndarray:
    """A finger on top of the ball, `depths` (m) deep."""
    return np.stack([0 * times, 0 * times, 1 - np.asarray(depths)], axis=-1)[:, None]


def force_at(hip_t, depths, force_t):
    recording = Recording(
        hip=push(hip_t, depths), hip_t=hip_t, force=np.zeros((len(force_t), 1, 3)), force_t=force_t
    )
    observation = observation_of(ball(), recording, CHANNELS, "r")
    return np.asarray(predicted(ball(), observation)["force"])[:, 0, 2]


def test_a_force_belongs_to_the_time_of_its_hip():
    t = 2.0 + 1e-3 * np.arange(5)
    depths = np.array([0, 1, 2, 4, 3]) * 1e-3
    np.testing.assert_allclose(force_at(t, depths, t), K * depths, atol=1e-9)


def test_between_two_steps_a_force_is_interpolated():
    t = 1e-3 * np.arange(4)
    found = force_at(t, np.array([0, 1, 2, 4]) * 1e-3, np.array([0.5e-3, 2.25e-3]))
    np.testing.assert_allclose(found, [0.5, 2.5], atol=1e-9)


@pytest.mark.parametrize("rate", [100.0, 333.0, 3000.0])
def test_a_hip_clock_of_another_rate_is_resampled(rate):
    t = np.arange(0, 0.2, 1 / rate)
    force_t = np.array([0.0105, 0.0413, 0.1234])
    # The depth grows evenly, so that linear interpolation is exact.
    np.testing.assert_allclose(force_at(t, 0.02 * t, force_t), K * 0.02 * force_t, atol=1e-9)


def test_a_hip_clock_that_is_slow_by_little_does_not_drift():
    t = 1.0005e-3 * np.arange(2000)
    force_t = np.array([1.0, 1.9])
    np.testing.assert_allclose(force_at(t, 0.001 * t, force_t), K * 0.001 * force_t, rtol=1e-6)


def test_samples_outside_the_time_of_hip_are_left_out():
    t = 1e-3 * np.arange(5)
    force_t = np.array([-1.0, 0.001, 0.004, 0.0045, 9.0])
    np.testing.assert_allclose(force_at(t, np.full(5, DEPTH), force_t), [K * DEPTH] * 2)


def falling(pose_t, steps=5, **changes):
    t = 1e-3 * np.arange(steps)
    pose = np.zeros((len(pose_t), 7))
    pose[:, 3] = 1
    pose[:, :3] = changes.get("measured", np.zeros((len(pose_t), 3)))
    recording = Recording(hip=np.tile(AWAY, (steps, 1, 1)), hip_t=t, pose=pose, pose_t=pose_t)
    return observation_of(ball(fixed=False), recording, CHANNELS, "r")


def fallen(steps):
    """Semi-implicit Euler: after n steps a falling body is g dt^2 n (n + 1) / 2 down."""
    return -G * 1e-6 * steps * (steps + 1) / 2


def test_a_pose_belongs_to_the_end_of_its_step():
    pose_t = 1e-3 * np.arange(6)
    pose = predicted(ball(fixed=False), falling(pose_t))["pose"]
    np.testing.assert_allclose(pose[:, 0, 2], fallen(np.arange(6)), atol=1e-15)


def test_poses_are_seen_until_one_step_after_the_last_hip():
    pose = predicted(ball(fixed=False), falling(np.array([0.0, 0.0045, 0.0055])))["pose"]
    np.testing.assert_allclose(pose[:, 0, 2], [0, (fallen(4) + fallen(5)) / 2], atol=1e-15)


def test_residuals_are_predicted_minus_measured_over_the_noise():
    measured = np.array([[1e-3, 0, 0], [0, 2e-3, 0]])
    observation = falling(np.array([0.0, 0.003]), measured=measured)
    noise = Noise(jnp.asarray(1.0), jnp.asarray(1e-3), jnp.asarray(0.01))
    r = residuals(ball(fixed=False), observation, noise)
    assert sorted(r) == ["angle", "position"]
    np.testing.assert_allclose(r["position"], [[-1, 0, 0], [0, -2, fallen(3) / 1e-3]], atol=1e-12)
    np.testing.assert_allclose(r["angle"], 0, atol=1e-12)


def test_a_turn_is_measured_in_rad_and_the_sign_of_a_quaternion_does_not_matter():
    pose_t, half = np.array([0.0, 0.001]), 0.05
    pose = np.zeros((2, 7))
    pose[:, 3:5] = [[np.cos(half), np.sin(half)], [-np.cos(half), -np.sin(half)]]
    recording = Recording(hip=np.tile(AWAY, (3, 1, 1)), hip_t=1e-3 * np.arange(3), pose=pose, pose_t=pose_t)
    observation = observation_of(ball(fixed=False), recording, ("pose",), "r")
    one = jnp.asarray(1.0)
    r = residuals(ball(fixed=False), observation, Noise(one, one, one))["angle"]
    np.testing.assert_allclose(r, [[-0.1, 0, 0]] * 2, atol=1e-12)


def test_quaternions_of_either_sign_are_interpolated(monkeypatch):
    """q and -q are the same turn: between the two lies that turn, not half a turn away."""
    scene, observation = ball(fixed=False), falling(np.array([0.0005, 0.0013, 0.0045]))
    smooth = predicted(scene, observation)["pose"]

    def flipping(*given, **more):
        final, reply = rollout(*given, **more)
        pose = reply.pose.at[::2, :, 3:].multiply(-1.0)
        return final, eqx.tree_at(lambda r: r.pose, reply, pose)

    monkeypatch.setattr("hapjax_fitting.observation.rollout", flipping)
    np.testing.assert_allclose(predicted(scene, observation)["pose"], smooth, atol=1e-15)


@pytest.mark.slow
def test_residuals_in_one_vector_are_taken_apart_by_channel():
    scene, observation = ball(fixed=False), falling(np.array([0.0, 0.0045]))
    noise = Noise(*(jnp.asarray(x) for x in (1.0, 1e-3, 0.01)))
    mass = (Parameter("object.ball.body.mass", None, Identity()),)
    problem = Problem(scene, (jax.tree.map(lambda x: x[None], observation),), noise, mass)
    found = stacked_residuals(jnp.ones(1), problem)
    parts = {key: np.asarray(part[0]) for key, part in channels_of(found, problem)}
    np.testing.assert_allclose(parts["position"][1, 2], (fallen(4) + fallen(5)) / 2 / 1e-3)
    np.testing.assert_allclose(parts["angle"], 0, atol=1e-12)


def test_only_the_chosen_channels_are_compared():
    recording = Recording(
        hip=np.tile(AWAY, (3, 1, 1)),
        hip_t=1e-3 * np.arange(3),
        force=np.zeros((3, 1, 3)),
        force_t=1e-3 * np.arange(3),
        pose=np.array([[0, 0, 0, 1.0, 0, 0, 0]]),
        pose_t=np.zeros(1),
    )
    scene = ball(fixed=False)
    assert observation_of(scene, recording, ("force",), "r").pose is None
    assert observation_of(scene, recording, ("pose",), "r").force is None


def test_what_the_model_cannot_follow_is_a_large_finite_residual():
    observation = falling(np.array([0.005]), measured=np.array([[10.0, 0, 0]]))
    tiny = jnp.asarray(1e-6)
    r = residuals(ball(fixed=False), observation, Noise(tiny, tiny, tiny))["position"]
    assert np.abs(r).max() == 1e6


HIP = dict(hip=np.zeros((3, 1, 3)), hip_t=1e-3 * np.arange(3))
FORCE = dict(force=np.zeros((3, 1, 3)), force_t=1e-3 * np.arange(3))
POSE = dict(pose=np.array([[1, 0, 0, 1.0, 0, 0, 0]]), pose_t=np.zeros(1))


@pytest.mark.parametrize(
    ("scene", "parts", "message"),
    [
        (ball(), FORCE, "^run: hip was not recorded"),
        (ball(), dict(hip=np.zeros((1, 1, 3)), hip_t=np.zeros(1)) | FORCE, "^run: hip has 1 sample"),
        (ball(), HIP, "^run: nothing to compare was recorded; allowed: a recording with force or pose"),
        (
            ball(),
            HIP | dict(force=np.array([[[0, 0, 0]], [[0, -1e308, 0]]]), force_t=np.array([0, 2e-3])),
            r"^run: force is -1e\+308 N at 0.002 s; allowed: -1e\+06 to 1e\+06 N$",
        ),
        (ball(), FORCE | HIP | dict(hip=np.full((3, 1, 3), 2e6)), r"^run: hip is 2e\+06 m at 0 s"),
        (
            ball(False),
            HIP | dict(pose=POSE["pose"] * [[[3e7] + [1] * 6]], pose_t=np.zeros(1)),
            r"^run: pose is 3e\+07 m at 0",
        ),
        (ball(), HIP | POSE, "^run: pose has 1 objects; allowed: 0"),
        (
            ball(),
            HIP | dict(force=np.zeros((2, 1, 3)), force_t=np.array([5.0, 6.0])),
            "^run: force_t runs from 5 to 6 s; allowed: .* 0 to 0.002 s, counted from the same moment$",
        ),
        (
            ball(),
            HIP | dict(force=FORCE["force"], force_t=1763859600.5 + FORCE["force_t"]),
            "^run: force_t runs from 176385960. to .*; its clock looks like Unix time$",
        ),
        (
            ball(),
            FORCE | dict(hip=HIP["hip"], hip_t=1763859600 + HIP["hip_t"]),
            "^run: force_t runs from 0 to .*; the clock of hip looks like Unix time$",
        ),
        (
            ball(),
            FORCE | dict(hip=np.zeros((2, 1, 3)), hip_t=np.array([0.0, 1e9])),
            "^run: hip lasts 1e.09 s",
        ),
        (
            ball(),
            FORCE | dict(hip=np.zeros((2, 1, 3)), hip_t=np.array([0.0, 1e-5])),
            "^run: hip lasts 1e-05 s, 1 steps",
        ),
    ],
)
def test_refusals(scene, parts, message):
    with pytest.raises(InputError, match=message):
        observation_of(scene, Recording(**parts), CHANNELS, "run")
