"""Samples at which the model left the range of sense: dropped and counted; the fit is that of the others."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hapjax
from fitting_cases import BOTH, SIGMA, STIFFNESS, floor, forces, recorded
from hapjax import Recording
from hapjax_fitting import fit
from hapjax_fitting.course import Course
from hapjax_fitting.observation import observation_of, predicted
from hapjax_fitting.report import _warnings, write_report

IN_BALL = [1.0, 0.0, 1.01]
OPTIONS: dict[str, Any] = dict(noise={"force": SIGMA}, starts=1, observe="force")


def with_ball(scene, moves=True):
    """The floor, and beside it a ball so stiff that a finger in it meets a force beyond all sense."""
    ball = hapjax.Object(
        hapjax.Sphere(0.05),
        hapjax.Surface(1e16, mu=0.5),
        hapjax.Body(0.01) if moves else None,
        position=(1.0, 0.0, 1.0),
    )
    return hapjax.Scene(object=dict(scene.object) | {"ball": ball}, integrator=scene.integrator)


OFF = with_ball(floor(mu=0.9, stiffness=500.0))


def astray(recording: Recording, rows) -> Recording:
    """The recording with the finger in the ball meanwhile."""
    hip = np.array(recording.hip)
    hip[rows] = IN_BALL
    return replace(recording, hip=hip)


def cut(recording: Recording, rows) -> Recording:
    """The recording without those samples of force."""
    assert recording.force is not None and recording.force_t is not None
    force, times = (np.delete(x, rows, axis=0) for x in (recording.force, recording.force_t))
    return replace(recording, force=force, force_t=times)


def assert_same(result, other):
    """The same numbers, and the same residuals, as far as a search finds them."""
    for name, estimate in other.parameters.items():
        found = result.parameters[name]
        assert abs(found.estimate - estimate.estimate) < 1e-3 * estimate.standard_error
        assert found.standard_error == pytest.approx(estimate.standard_error, rel=1e-3)
    assert result.residual_rms["force"] == pytest.approx(other.residual_rms["force"], rel=1e-3)
    assert result.measured == other.measured and result.converged


@pytest.mark.slow
def test_of_the_only_recording_what_comes_before_is_fitted():
    whole, lost = recorded(floor(), steps=200), slice(120, 200)
    result = fit(OFF, astray(whole, lost), BOTH, **OPTIONS)
    assert result.lost == {"recording 1": 80} and result.to_dict()["lost"] == result.lost
    left = fit(OFF, cut(whole, lost), BOTH, **OPTIONS)
    assert_same(result, left)
    words = "The model left the range of sense; dropped were 80 samples of recording 1."
    assert words in _warnings(result) and not any("range of sense" in w for w in _warnings(left))


@pytest.mark.slow
def test_a_recording_lost_from_its_beginning_is_dropped():
    good = recorded(floor(), steps=200)
    both = fit(OFF, [good, astray(good, slice(0, 200))], BOTH, names=["good", "bad"], **OPTIONS)
    assert both.lost == {"bad": 200} and both.names == ("good",) and len(both.recordings) == 1
    assert_same(both, fit(OFF, good, BOTH, **OPTIONS))


def taps() -> Recording:
    """Five times down on the floor and along it, with noise on the force."""
    t = 1e-3 * np.arange(400)
    phase = t % 0.08
    z = np.where(phase < 0.03, -0.002 * np.sin(np.pi * phase / 0.03), 0.005)
    path = np.stack([0.02 * np.sin(40 * t), 0 * t, z], axis=-1)[:, None]
    noise = SIGMA * np.random.default_rng(0).standard_normal(path.shape)
    return Recording(hip=path, hip_t=t, force=forces(floor(), path) + noise, force_t=t)


@pytest.mark.slow
def test_of_a_spell_what_comes_after_is_dropped_and_the_next_spells_are_fitted():
    whole, scene = taps(), with_ball(floor(mu=0.9, stiffness=500.0), moves=False)
    result = fit(scene, astray(whole, [175]), BOTH, **OPTIONS)
    assert result.problem.groups[0].spells is not None
    assert result.lost == {"recording 1": 15}  # the third is from 160 to 190
    assert_same(result, fit(scene, cut(whole, slice(175, 190)), BOTH, **OPTIONS))


@pytest.mark.slow
def test_what_better_numbers_follow_comes_back():
    """From a start at which every touch is lost, what is known beforehand leads to where none is."""
    known = {STIFFNESS: (600.0, 0.5)}
    far, near = (
        fit(floor(stiffness=k), recorded(floor(), steps=200), STIFFNESS, priors=known, **OPTIONS)
        for k in (1e20, 600.0)
    )
    assert not far.lost and far.loss == pytest.approx(near.loss, rel=1e-6)
    assert_same(far, near)


def test_of_what_moves_the_next_restart_finds_it_again():
    """Forces at and between steps, and poses, which are those of the ends of steps."""
    steps, lost, restart = 60, 25, 40
    whole = recorded(floor(), steps=steps)
    still = np.tile([1.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0], (steps, 1, 1))
    assert whole.hip_t is not None
    seen = replace(
        whole, pose=still, pose_t=whole.hip_t, force_t=whole.hip_t + 0.5e-3 * (np.arange(steps) % 2)
    )
    none = jnp.zeros((steps, 1, 3))
    course = Course(jnp.asarray(still), none, none, jnp.arange(steps) % 20 == 0)

    @jax.jit
    def said(hips):
        return predicted(OFF, replace(observation, hips=hips, course=course))

    observation = observation_of(OFF, seen, ("force", "pose"), "seen")
    expected, found = said(observation.hips), said(observation.hips.at[lost].set(jnp.array([IN_BALL])))
    assert float(jnp.max(expected["force"])) > 0.5
    assert observation.force is not None and observation.pose is not None
    time = {
        key: np.asarray(samples.index) + np.asarray(samples.weight)
        for key, samples in (("force", observation.force), ("pose", observation.pose))
    }
    gone = {"force": (time["force"] > lost - 1) & (time["force"] < restart)}
    gone["pose"] = (time["pose"] > lost) & (time["pose"] < restart + 1)
    for key, rows in gone.items():
        assert np.isnan(found[key][rows]).all() and rows.any()
        np.testing.assert_allclose(found[key][~rows], expected[key][~rows], rtol=0, atol=1e-12)


@pytest.mark.slow
def test_nothing_is_claimed_where_the_model_is_lost_at_all_samples(tmp_path):
    bad = astray(recorded(floor(), steps=200), slice(0, 200))
    result = fit(OFF, bad, BOTH, **OPTIONS)
    assert not result.converged and "left the range of sense" in (result.reason or "")
    assert result.lost == {"recording 1": 200}
    assert not result.residual_rms and np.isnan(result.loss)
    assert all(p.estimate is None and p.interval95 == (None, None) for p in result.parameters.values())
    assert "left the range of sense" in write_report(result, tmp_path).read_text()
