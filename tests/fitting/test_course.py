"""The measured course of moving objects: places, velocities and spins from sampled poses."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hapjax import Body, Object, Recording, Scene, Sphere, Surface, World, init, step
from hapjax_fitting.course import Course, course_of
from hapjax_fitting.observation import played

NOISE = np.array([1e-4] * 3 + [2e-3] * 3)  # m, rad
T = 1e-3 * np.arange(1000)


def waved(t):
    """A body that goes to and fro and turns about an axis that turns: place (n, 3), rotation, velocity, spin."""
    place = 0.01 * np.sin(np.outer(t, [9.0, 7.0, 5.0]))
    velocity = 0.01 * np.array([9.0, 7.0, 5.0]) * np.cos(np.outer(t, [9.0, 7.0, 5.0]))
    about_z, about_x = 0.8 * np.sin(6 * t), 0.5 * np.sin(4 * t)
    turn = Rotation.from_euler("ZX", np.stack([about_z, about_x], axis=1))
    spin = np.outer(4.8 * np.cos(6 * t), [0, 0, 1.0])
    spin += (2.0 * np.cos(4 * t))[:, None] * np.stack([np.cos(about_z), np.sin(about_z), 0 * t], axis=1)
    return place, turn, velocity, spin


def sampled(rate, noise=0 * NOISE, seed=0) -> Recording:
    t = np.arange(0.0, 1.0, 1 / rate)
    place, turn, _, _ = waved(t)
    off = noise * np.random.default_rng(seed).standard_normal((len(t), 6))
    turn = turn * Rotation.from_rotvec(off[:, 3:])
    pose = np.concatenate([place + off[:, :3], turn.as_quat(scalar_first=True)], axis=1)
    pose[::2, 3:] *= -1  # the same turns
    return Recording(hip=np.zeros((1000, 1, 3)), hip_t=T, pose=pose[:, None], pose_t=t)


def errors(recording, inside):
    """The largest errors of place (m), angle (rad), velocity (m/s) and spin (rad/s) at some steps."""
    course = course_of(recording, T, NOISE, jnp.float64)
    assert course is not None
    place, turn, velocity, spin = waved(T[inside])
    pose = np.asarray(course.pose)[inside, 0]
    angle = (turn.inv() * Rotation.from_quat(pose[:, 3:], scalar_first=True)).magnitude()
    off = (pose[:, :3] - place, angle, course.velocity[inside, 0] - velocity, course.spin[inside, 0] - spin)
    return [float(np.max(np.abs(x))) for x in off]


INSIDE = slice(100, 900)


def test_a_smooth_course_is_found_between_its_samples():
    place, angle, velocity, spin = errors(sampled(200.0), INSIDE)
    assert place < 1e-6 and angle < 1e-4 and velocity < 1e-4 and spin < 0.02


def test_noise_is_smoothed_by_more_samples_where_there_are_more():
    few, many = (errors(sampled(rate, NOISE), INSIDE) for rate in (100.0, 1000.0))
    assert few[0] < 2e-4 and few[2] < 0.01  # 2 standard deviations of a place; 10 mm/s of up to 120
    # A velocity from 9 samples in 8 ms would err by up to 70 mm/s.
    assert many[0] < few[0] and many[2] < 0.01


def test_there_are_no_restarts_where_nothing_was_measured():
    recording = sampled(100.0)
    pose, t = recording.pose, recording.pose_t
    assert pose is not None and t is not None
    kept = (t > 0.2) & ((t < 0.5) | (t > 0.7))
    course = course_of(
        Recording(hip=recording.hip, hip_t=T, pose=pose[kept], pose_t=t[kept]), T, NOISE, float
    )
    assert course is not None
    restart = np.asarray(course.restart)
    assert not restart[:200].any() and not restart[500:700].any() and restart[250:480].all()
    each = np.flatnonzero(course.windows(50).restart)
    np.testing.assert_array_equal(each, [*range(250, 500, 50), *range(750, 1000, 50)])
    assert not course.uncut().restart.any()


@pytest.mark.parametrize("rate", [15.0, 1.0])
def test_poses_that_are_too_few_are_no_course(rate):
    assert course_of(sampled(rate), T, NOISE, jnp.float64) is None


@pytest.mark.slow
def test_windows_that_begin_where_the_model_is_are_single_shooting():
    """With the model's own motion as the course, the god-objects ride along, and nothing is changed by restarts."""
    ball = Object(
        Sphere(0.03), Surface(800.0, mu=0.6, damping=1.0), Body(0.2, inertia=(9e-5,) * 3, centre=(0, 0, 1e-3))
    )
    scene = Scene(object={"ball": ball}, world=World(gravity=(0.0, 0.0, -9.81)))
    t = 1e-3 * np.arange(150)
    squeeze, shake = np.interp(t, [0.0, 0.02], [0.03, 0.025]), 0.003 * np.sin(40 * t) ** 2
    hips = jnp.stack([np.stack([side * squeeze + shake, shake, 0 * t], axis=-1) for side in (-1, 1)], axis=1)

    def one(state, hip):
        after, reply = step(scene, state, hip)
        return after, (state.motion["ball"], reply.force, reply.pose)

    _, (motion, force, pose) = jax.lax.scan(one, init(scene, hips[0]), hips)
    before = jnp.concatenate([motion.position, motion.orientation], axis=1)[:, None]
    arms = Rotation.from_quat(motion.orientation, scalar_first=True).apply([0, 0, 1e-3])
    velocity = np.asarray(motion.velocity) - np.cross(motion.spin, arms)  # of the frame's origin
    course = Course(before, jnp.asarray(velocity)[:, None], motion.spin[:, None], jnp.ones(len(hips), bool))
    assert float(jnp.max(jnp.abs(force))) > 1.0
    play = jax.jit(lambda course: played(scene, hips, None, course)[1])
    for cut in (course.uncut(), course.windows(1), course.windows(37)):
        reply = play(cut)
        np.testing.assert_allclose(reply.force, force, atol=1e-9)
        np.testing.assert_allclose(reply.pose, pose, atol=1e-12)
    elsewhere = replace(course, pose=course.pose.at[..., 0].add(1e-3)).windows(37)
    assert float(jnp.max(jnp.abs(play(elsewhere).force - force))) > 0.1
