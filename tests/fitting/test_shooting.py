"""Shooting: from numbers far off, at which what is held is dropped, to ones from which a fit arrives."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from fitting_cases import held_cube, shaken_cube
from hapjax import Body, Box, Contact, Object, Plane, Recording, Scene, World, cast, init, rollout
from hapjax_fitting import fit
from hapjax_fitting.noise import noise_of
from hapjax_fitting.parameters import free_parameters
from hapjax_fitting.problem import Problem, grouped, loss_at, stacked_residuals
from hapjax_fitting.shooting import shots
from hapjax_fitting.solve import Trace, listen, solve
from hapjax_fitting.success import gone_astray, why_not

MASS, STIFFNESS = FREE = ["object.cube.body.mass", "object.cube.surface.stiffness"]


def within(result, name, truth, widths=3.0):
    p = result.parameters[name]
    return p.identified and abs(p.estimate - truth) <= widths * p.standard_error


def problem_of(scene, recording):
    parameters = free_parameters(scene, FREE)
    groups = grouped(scene, [recording], ("force", "pose"), ["r"], parameters)
    return Problem(scene, groups, noise_of([recording], None, jnp.float64), parameters)


@pytest.mark.slow
def test_shooting_arrives_from_where_single_shooting_fails():
    """Mass ten times too large and stiffness ten times too small: the cube is dropped at once."""
    recording = shaken_cube()
    problem = problem_of(held_cube(), recording)
    truth = problem.start()
    far = truth + jnp.log(jnp.array([10.0, 0.1]))
    with listen(Trace()) as trace:
        near = shots(far[None], problem, [recording])
    loss, kept = trace.best[0]  # should the search end before the solver runs
    assert loss == pytest.approx(float(loss_at(jnp.asarray(kept), problem)), rel=1e-9)
    np.testing.assert_allclose(kept, truth, atol=0.05)
    np.testing.assert_allclose(near[0], truth, atol=0.05)
    best = float(loss_at(truth, problem))
    assert float(loss_at(near[0], problem)) < 2 * best
    alone = solve(stacked_residuals, far[None], jnp.arange(1), problem, 1e-8, 1e-8, 100)
    assert float(alone.loss[0]) > 10 * best


@pytest.mark.slow
def test_a_moving_object_is_fitted_from_forces_and_poses():
    result = fit(held_cube(mass=0.02, stiffness=80.0), shaken_cube(), FREE, starts=3, spread=1.3)
    assert result.converged and result.starts_at_best == result.starts < 3  # none is tried in vain
    assert within(result, MASS, 0.2) and within(result, STIFFNESS, 800.0)
    error = result.parameters[MASS].standard_error
    assert error is not None and error < 0.01
    assert set(result.residual_rms) == {"force", "pose", "angle"}
    assert result.residual_rms["pose"] == pytest.approx(1e-4, rel=0.1)
    poses = fit(held_cube(0.25), shaken_cube(), [MASS], observe="pose", starts=2, spread=1.3)
    assert within(poses, MASS, 0.2, widths=4) and set(poses.residual_rms) == {"pose", "angle"}
    assert (poses.parameters[MASS].standard_error or 0) > error


@pytest.mark.slow
def test_a_drop_is_found_from_where_every_descent_ends_beside_it():
    """A cube that falls nearly flat bounces from corner to corner: many numbers bounce it almost as it was seen."""
    stiffness, damping = free = [f"contact.cube_on_floor.{name}" for name in ("stiffness", "damping")]
    scene, recording = dropped_cube()
    best = fit(scene, recording, free, starts=1)
    assert best.converged and within(best, stiffness, 3000.0) and within(best, damping, 0.4)
    for factor, seed in ((10.0, 0), (0.1, 1)):
        off = eqx.tree_at(
            lambda s: (s.contact["cube_on_floor"].stiffness, s.contact["cube_on_floor"].damping),
            scene,
            replace_fn=lambda x, f=factor: x * f,
        )
        result = fit(off, recording, free, starts=2, seed=seed)
        assert result.converged and result.loss == pytest.approx(best.loss, abs=0.1)


def dropped_cube(tilt=0.03):
    cube = Object(Box((0.06,) * 3), None, Body(0.2), (0, 0, 0.08), (np.cos(tilt / 2), np.sin(tilt / 2), 0, 0))
    contact = {"cube_on_floor": Contact(3000.0, mu=0.3, damping=0.4, between=("cube", "floor"))}
    parts = {"cube": cube, "floor": Object(Plane())}
    scene = cast(Scene(parts, contact, world=World(gravity=(0.0, 0.0, -9.81))), jnp.float64)
    t, hip = 1e-3 * np.arange(400), np.zeros((400, 1, 3)) + [0.0, 0.0, 1.0]
    pose = np.array(rollout(scene, init(scene, hip[0]), jnp.asarray(hip))[1].pose)
    random = np.random.default_rng(0)
    pose[..., :3] += 1e-4 * random.standard_normal(pose[..., :3].shape)
    pose[..., 3:] += 5e-4 * random.standard_normal(pose[..., 3:].shape)
    pose[..., 3:] /= np.linalg.norm(pose[..., 3:], axis=-1, keepdims=True)
    return scene, Recording(hip=hip, hip_t=t, pose=pose, pose_t=t + 1e-3)


def test_where_no_pose_was_measured_the_starts_are_as_they_were():
    shaken = shaken_cube()
    unseen = replace(shaken, pose=None, pose_t=None)
    starts = jnp.zeros((2, 2))
    assert shots(starts, problem_of(held_cube(), unseen), [unseen]) is starts


def test_a_fit_that_does_not_explain_the_data_needs_two_starts_that_agree():
    assert why_not(True, 1.1, 1, 4) is None and why_not(True, 5.0, 2, 4) is None
    assert why_not(True, 1.9, 1, 1) is None and "1 of 4" in (why_not(True, 1.9, 1, 4) or "")
    assert "2 of 3" in (why_not(True, 5.0, 2, 3, True) or "") and why_not(True, 5.0, 4, 8, True) is None
    assert (
        why_not(True, 5.04, 1, 4)
        == "the residuals are 5.0 times the noise, and 1 of 4 starts ended at this loss"
    )
    assert "3 of 16" in (why_not(True, 4.7, 3, 16) or "") and why_not(True, 4.7, 4, 16) is None
    assert "max_steps" in (why_not(False, 1.0, 4, 4) or "")


@pytest.mark.parametrize(("alike", "noises", "stray"), [(3, 4.7, True), (8, 4.7, False), (3, 1.0, False)])
def test_starts_of_which_few_agree_on_what_explains_nothing_have_gone_astray(alike, noises, stray):
    places = np.arange(16)
    losses = jnp.asarray(500 * noises**2 * (1.0 + np.where(places < alike, 0, places)))
    assert gone_astray(losses, 1000) is stray
