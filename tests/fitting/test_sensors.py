"""Sensors: what was added to a recording is found again, and what is perfect costs nothing."""

import sys
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.extend.core import jaxprs_in_params
from scipy.spatial.transform import Rotation

from fitting_cases import MU, SIGMA, TRUTH, floor, forces, recorded
from hapjax import Body, InputError, Object, Recording, Scene, Sphere, World, init, rollout
from hapjax_fitting import Sensors, fit
from hapjax_fitting.noise import noise_of
from hapjax_fitting.observation import Samples
from hapjax_fitting.parameters import free_parameters, with_values
from hapjax_fitting.problem import Problem, grouped, stacked_residuals
from hapjax_fitting.sensors import Setup, explicit
from hapjax_fitting.spells import onwards

BIAS, GAIN, DELAY, TURN = [0.3, -0.2, 0.1], [1.1, 0.9, 1.05], 2.4e-3, [0.02, -0.03, 0.05]
ALL = {"force_bias": BIAS, "force_gain": GAIN, "force_delay": DELAY, "hip_rotation": TURN}


def circling(sensors: Sensors, steps=300) -> Recording:
    """A finger goes round on the floor at changing depth; recorded by sensors."""
    t = 1e-3 * np.arange(steps)
    angle, depth = 2 * np.pi * t / 0.15, 0.002 + 0.001 * np.sin(30 * t)
    path = np.stack([0.05 * np.cos(angle), 0.05 * np.sin(angle), -depth], axis=-1)[:, None]
    clean = forces(floor(), path)[:, 0]
    late = 0.0 if sensors.force_delay is None else float(sensors.force_delay)
    read = np.stack([np.interp(t - late, t, column) for column in clean.T], axis=-1)[:, None]
    noise = SIGMA * np.random.default_rng(0).standard_normal(read.shape)
    hip = path if sensors.hip_rotation is None else turn(sensors).inv().apply(path[:, 0])[:, None]
    return Recording(hip=hip, hip_t=t, force=np.asarray(sensors.shown(jnp.asarray(read))) + noise, force_t=t)


def turn(sensors) -> Rotation:
    return Rotation.from_rotvec(np.array(sensors.hip_rotation))


@pytest.mark.slow
def test_bias_gain_delay_and_frame_are_found_together():
    truth = Sensors(**ALL)
    options: dict[str, Any] = {"noise": {"force": SIGMA}, "starts": 2}
    result = fit(floor(), circling(truth), [f"sensor.{name}" for name in ALL], **options)
    assert result.converged and result.residual_rms["force"] == pytest.approx(SIGMA, rel=0.1)
    for name, numbers in ALL.items():
        for i, number in enumerate(np.atleast_1d(numbers)):
            p = result.parameters[f"sensor.{name}[{i}]" if np.ndim(numbers) else f"sensor.{name}"]
            assert p.identified and p.estimate is not None and p.standard_error is not None
            assert abs(p.estimate - number) < 4 * p.standard_error < 0.05
        np.testing.assert_allclose(getattr(result.sensors, name), numbers, atol=0.02)


@pytest.mark.slow
def test_known_sensors_are_taken_off(monkeypatch):
    """Also for what is looked for that is odd."""
    known = []
    monkeypatch.setattr(sys.modules["hapjax_fitting.fit"], "findings_of", lambda *a: known.append(a) or ())
    result = fit(floor(0.9), circling(Sensors(**ALL)), MU, sensors=Sensors(**ALL), starts=1)
    assert result.parameters[MU].estimate == pytest.approx(0.6, rel=0.01)
    np.testing.assert_allclose(known[0][-1]["recording 1"].force_delay, DELAY)


@pytest.mark.slow
def test_a_late_pose_is_found():
    dt, late = 1e-3, 7.5e-3
    scene = Scene(
        object={"ball": Object(Sphere(0.1), None, Body(1.0))}, world=World(gravity=(0.0, 0.0, -9.81))
    )
    t = dt * np.arange(200)
    path = np.full((200, 1, 3), 10.0)
    _, reply = rollout(scene, init(scene, jnp.asarray(path[0])), jnp.asarray(path))
    pose = np.asarray(reply.pose)[::10].copy()
    pose[..., :3] += 1e-5 * np.random.default_rng(0).standard_normal(pose[..., :3].shape)
    recording = Recording(hip=path, hip_t=t, pose=pose, pose_t=t[::10] + dt + late)
    noise = {"position": 1e-5, "angle": 1e-3}
    result = fit(scene, recording, "sensor.pose_delay", noise=noise, starts=1)
    p = result.parameters["sensor.pose_delay"]
    assert p.estimate is not None and p.standard_error is not None
    assert abs(p.estimate - late) < 4 * p.standard_error < 1e-4
    blurred = fit(scene, recording, "sensor.pose_delay", noise=noise | {"position": 1.0}, starts=1)
    p = blurred.parameters["sensor.pose_delay"]
    assert not p.identified and p.reason == "the data hardly depend on it"


@pytest.mark.parametrize("late", [0.0, 0.4, 1.0, 2.7, -1.3, 50.0, -50.0])
def test_earlier_samples_are_interpolated_and_differentiable(late, dtype):
    series = jnp.asarray(np.random.default_rng(1).standard_normal((20, 1, 1)), dtype)
    place = np.array([0.0, 0.5, 3.25, 10.0, 18.9])
    index = np.floor(place).astype(np.int32)
    samples = Samples(jnp.zeros((5, 1, 1), dtype), jnp.asarray(index), jnp.asarray(place - index, dtype))

    def read(steps):
        return samples.earlier(steps, 20).between(series)[:, 0, 0]

    found, slope = jax.jvp(read, (jnp.asarray(late, dtype),), (jnp.ones((), dtype),))
    at = np.clip(place - late, 0, 19)
    flat = np.asarray(series[:, 0, 0])
    tolerance = 1e-12 if dtype == jnp.float64 else 1e-5
    np.testing.assert_allclose(found, np.interp(at, np.arange(20), flat), atol=tolerance)
    inside = (place - late > 0) & (place - late < 19) & (np.abs(at - np.round(at)) > 1e-6)
    steps = flat[1:] - flat[:-1]
    np.testing.assert_allclose(slope[inside], -steps[np.floor(at[inside]).astype(int)], atol=tolerance)
    assert found.dtype == dtype


def test_hip_turns_into_the_world():
    sensors = Sensors(hip_rotation=TURN)
    points = np.random.default_rng(2).standard_normal((4, 2, 3))
    expected = turn(sensors).apply(points.reshape(-1, 3)).reshape(points.shape)
    np.testing.assert_allclose(sensors.turned(jnp.asarray(points)), expected, atol=1e-12)


def test_what_was_shown_is_taken_back():
    sensors, force = Sensors(force_bias=BIAS, force_gain=GAIN), np.array([[1.0, 2.0, 3.0]])
    np.testing.assert_allclose(sensors.shown(jnp.asarray(force)), force * GAIN + BIAS)
    np.testing.assert_allclose(sensors.corrected(sensors.shown(jnp.asarray(force))), force)


def test_perfect_sensors_cost_nothing():
    scene, recording = floor(), recorded(floor())
    parameters = free_parameters(scene, [MU])
    groups = grouped(scene, [recording], ("force",), ["r"], parameters)
    noise = noise_of([recording], {"force": SIGMA}, jnp.float64)
    free = jnp.log(jnp.array([0.5]))

    def whole(free, groups, problem):
        changed = with_values(scene, parameters, jnp.stack([jnp.exp(x) for x in free]))

        def one(observation):
            reply = rollout(changed, init(changed, observation.hips[0]), observation.hips)[1]
            samples, lost = observation.force, onwards(reply.lost)
            said = jnp.where(samples.beside(lost)[:, None, None], jnp.nan, samples.between(reply.force))
            r = (said - observation.force.value) / noise.force
            return jnp.where(jnp.abs(r) < 1e6, r, 1e6).reshape(len(r), -1)

        return jnp.concatenate([jax.vmap(one)(groups[0]).ravel()])

    def equations(sensors=None, function=stacked_residuals):
        problem = Problem(scene, groups, noise, parameters, sensors or Sensors())
        if function is whole:
            return _count(jax.make_jaxpr(lambda x: whole(x, groups, problem))(free).jaxpr)
        return _count(jax.make_jaxpr(lambda x: function(x, problem))(free).jaxpr)

    assert equations() <= equations(function=whole)
    assert equations(Sensors(force_bias=BIAS)) > equations()


def _count(jaxpr) -> int:
    """The equations of a program, those inside of its parts with them."""
    parts = (part for equation in jaxpr.eqns for part in jaxprs_in_params(equation.params))
    return len(jaxpr.eqns) + sum(_count(part) for part in parts)


def test_spells_depend_on_the_frame_of_hip():
    t = 1e-3 * np.arange(400)
    path = np.stack([0 * t, 0 * t, 0.004 * np.cos(150 * t)], axis=-1)[:, None]  # ten taps
    recording = Recording(hip=path, hip_t=t, force=0 * path, force_t=t)
    sensors = explicit(Sensors(), ["sensor.hip_rotation"], jnp.float64)

    def cut(path):
        parameters = free_parameters(Setup(floor(), sensors), path)
        return grouped(floor(), [recording], ("force",), ["r"], parameters, sensors)[0].spells is not None

    assert cut(MU)
    assert not cut("sensor.hip_rotation")


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        ({"force_bias": 0.1}, "force_bias is 0.1; allowed: three finite numbers"),
        ({"force_delay": [0.1, 0.2]}, "force_delay is .*; allowed: one finite number"),
        ({"force_delay": np.nan}, "force_delay is nan"),
        ({"force_gain": [1.0, 0.0, 1.0]}, "force_gain is .*; allowed: three numbers above 0"),
    ],
)
def test_numbers_that_no_sensor_has(numbers, message):
    with pytest.raises(InputError, match=message):
        Sensors(**numbers)


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ("sensor.bias", "sensors have no bias; allowed: sensor.force_bias, sensor.force_gain"),
        ("sensor", "sensors have no part without a name"),
        ("sensor.force_bias[3]", r"out of range; allowed: sensor.force_bias\[0\] to \[2\]"),
    ],
)
def test_paths_that_no_sensor_has(path, message):
    with pytest.raises(InputError, match=message):
        fit(floor(), recorded(floor()), [path])


def test_truths_and_sensors_stand_in_one_table():
    free = [*TRUTH, "sensor.force_bias[2]"]
    result = fit(floor(0.9, 500.0), recorded(floor()), free, noise={"force": SIGMA}, starts=1)
    assert list(result.parameters) == free
    assert result.to_dict()["parameters"]["sensor.force_bias[2]"]["identified"]
