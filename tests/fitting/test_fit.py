"""fit on synthetic recordings: what was put in is found again, and what cannot be known is not claimed."""

import json
import sys
from dataclasses import replace
from functools import cache
from typing import Any

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
import scipy.optimize

import hapjax
from fitting_cases import (
    BOTH,
    MU,
    SIGMA,
    STIFFNESS,
    TRUTH,
    floor,
    forces,
    recorded,
    stroke,
)
from hapjax import InputError, Recording, load_recording, load_scene, save_scene
from hapjax_fitting import fit, table
from hapjax_fitting.noise import noise_of
from hapjax_fitting.parameters import free_parameters
from hapjax_fitting.problem import Problem, grouped, stacked_residuals
from hapjax_fitting.solve import jacobian

NOISE = {"force": SIGMA}
OFF = floor(mu=0.9, stiffness=500.0)


def fitted(recordings, scene=OFF, free=BOTH, **options) -> Any:
    """A fit with few starts, all tests with the same, so that they share what was compiled."""
    return fit(scene, recordings, free, **{"noise": NOISE, "starts": 2} | options)


def within(result, name, truth, widths=3.0):
    p = result.parameters[name]
    return p.identified and abs(p.estimate - truth) <= widths * p.standard_error


@cache
def draws():
    """Estimates, standard errors and ends of the 95 % intervals, each (600, 2); the noise alone differs."""
    t, path = stroke()
    clean = forces(floor(), path)
    found = []
    with pytest.MonkeyPatch.context() as patch:
        # What takes time and changes no number: the checks of types, and the search for what is odd about a recording.
        patch.setattr(jaxtyping.config, "jaxtyping_disable", True)
        patch.setattr(sys.modules[fit.__module__], "findings_of", lambda *_: ())
        for seed in range(600):
            force = clean + SIGMA * np.random.default_rng(seed).standard_normal(clean.shape)
            result = fitted(Recording(hip=path, hip_t=t, force=force, force_t=t), starts=1)
            found.append([(p.estimate, p.standard_error, *p.interval95) for p in result.parameters.values()])
    return np.moveaxis(np.array(found), -1, 0)


@pytest.mark.slow
def test_estimates_lie_within_3_standard_errors_of_the_truth():
    estimate, error, _, _ = draws()
    # Both numbers in at least 99 of 100 draws; of 600, because of 100 chance takes two too often.
    inside = np.abs(estimate - list(TRUTH.values())) <= 3 * error
    assert np.sum(inside.all(axis=1)) >= 594


@pytest.mark.slow
def test_standard_errors_are_the_errors_that_are_made():
    estimate, error, _, _ = draws()
    made = np.sqrt(np.mean((estimate - list(TRUTH.values())) ** 2, axis=0))
    np.testing.assert_allclose(made / error.mean(axis=0), 1, atol=0.09)


@pytest.mark.slow
def test_95_percent_intervals_hold_the_truth_about_95_times_in_100():
    _, _, low, high = draws()
    held = np.sum((low <= list(TRUTH.values())) & (list(TRUTH.values()) <= high), axis=0)
    assert held.min() >= 558 and held.max() <= 582


@pytest.mark.parametrize("seed", range(3))
def test_mu_and_stiffness_are_found_and_noise_is_estimated(seed):
    given, estimated = (fitted(recorded(floor(), seed), noise=n) for n in (NOISE, None))
    for result in (given, estimated):
        assert result.converged
        assert within(result, MU, 0.6, widths=4) and within(result, STIFFNESS, 800.0, widths=4)
        assert result.residual_rms["force"] == pytest.approx(SIGMA, rel=0.05)
    assert estimated.noise["force"] == pytest.approx(SIGMA, rel=0.15)
    errors = [[p.standard_error for p in r.parameters.values()] for r in (given, estimated)]
    np.testing.assert_allclose(errors[0], errors[1], rtol=0.2)


def test_scipy_finds_the_same():
    result = fitted(recorded(floor()))
    problem = problem_of(OFF, [recorded(floor())])
    ours = np.log([result.parameters[name].estimate for name in BOTH])
    theirs = scipy.optimize.least_squares(
        lambda x: np.asarray(residuals_of(jnp.asarray(x), problem)),
        np.log([0.7, 700.0]),
        xtol=1e-12,
        ftol=1e-12,
    )
    np.testing.assert_allclose(ours, theirs.x, atol=1e-6)
    assert result.loss == pytest.approx(theirs.cost, rel=1e-9)
    covariance = np.linalg.inv(theirs.jac.T @ theirs.jac)
    np.testing.assert_allclose(result.covariance, covariance, rtol=1e-3)


def problem_of(scene, recordings, free=BOTH):
    parameters = free_parameters(scene, free)
    groups = grouped(scene, recordings, ("force", "pose"), ["r"] * len(recordings), parameters)
    return Problem(scene, groups, noise_of(recordings, NOISE, jnp.float64), parameters)


residuals_of = jax.jit(stacked_residuals)


@pytest.mark.slow
def test_the_jacobian_is_that_of_central_differences():
    problem = problem_of(OFF, [recorded(floor())])
    free, h = jnp.log(jnp.array([0.55, 770.0])), 1e-6
    matrix, _ = jacobian(stacked_residuals, free, problem)
    for i in range(2):
        step = h * jnp.eye(2)[i]
        difference = (residuals_of(free + step, problem) - residuals_of(free - step, problem)) / (2 * h)
        np.testing.assert_allclose(matrix[:, i], difference, atol=1e-5 * float(jnp.abs(difference).max()))


NO_SLIP: dict[str, Any] = dict(length=2e-4)


@pytest.mark.parametrize("start", [0.01, 0.3, 0.9, 30.0])
def test_without_slip_mu_is_a_lower_bound(start):
    t, path = stroke(**NO_SLIP)
    touching = path[:, 0, 2] < 0
    force = forces(floor(), path)[touching, 0]
    ratio = np.max(np.linalg.norm(force[:, :2], axis=1) / force[:, 2])
    result = fitted(recorded(floor(), **NO_SLIP), scene=floor(start, 700.0))
    p = result.parameters[MU]
    assert (p.identified, p.estimate, p.standard_error, p.interval95[1]) == (False, None, None, None)
    assert ratio * 0.98 <= p.interval95[0] <= ratio * (1 + 1e-9) < 0.6
    assert "slipped" in p.reason
    assert within(result, STIFFNESS, 800.0)


@pytest.mark.parametrize("start", [0.01, 0.15, 5.0, 50.0])
def test_with_slip_mu_is_found_from_far_below_and_far_above(start):
    result = fitted(recorded(floor(mu=0.2), length=2e-3), scene=floor(start, 500.0), noise=None)
    assert within(result, MU, 0.2, widths=4)
    assert result.starts >= result.starts_at_best >= 1


def light_press(truth):
    """A finger that presses and hardly moves: nothing slips."""
    t = 1e-3 * np.arange(1000)
    path = np.stack([5e-4 * np.sin(20 * t), 0 * t, -0.0025 - 5e-4 * np.sin(13 * t)], axis=-1)[:, None]
    force = forces(truth, path) + SIGMA * np.random.default_rng(1).standard_normal(path.shape)
    return Recording(hip=path, hip_t=t, force=force, force_t=t)


@pytest.mark.slow
def test_without_slip_the_optimum_is_found_from_a_mu_at_which_all_starts_slip():
    result = fitted(light_press(floor()), scene=floor(0.05, 1600.0), noise=None)
    mu = result.parameters[MU]
    assert not mu.identified and mu.reason == "nothing slipped" and 0.1 < mu.interval95[0] < 0.6
    assert within(result, STIFFNESS, 800.0, widths=4)
    assert result.residual_rms["force"] == pytest.approx(SIGMA, rel=0.1)


def test_a_model_that_does_not_explain_the_data_gives_no_bound():
    recording = light_press(floor())
    wave = np.sin(0.2 * np.arange(1000))[:, None, None] * np.array([0.0, 0.0, 1.0])
    mu = fitted(replace(recording, force=recording.force + wave), scene=floor()).parameters[MU]
    assert mu.interval95 == (None, None) and mu.reason == "the model does not explain the data"


@pytest.mark.parametrize("noise", [None, NOISE])
def test_a_dead_sensor_gives_no_bound(noise):
    recording = light_press(floor())
    dead = replace(recording, force=np.zeros_like(recording.force))
    mu = fitted(dead, scene=floor(), noise=noise).parameters[MU]
    assert mu.interval95 == (None, None) and "slipped" not in mu.reason


@pytest.mark.slow
def test_without_contact_nothing_is_identified():
    t, path = stroke()
    force = SIGMA * np.random.default_rng(0).standard_normal((len(t), 1, 3))
    recording = Recording(hip=path + [0, 0, 1.0], hip_t=t, force=force, force_t=t)
    result = fitted(recording)
    mu, stiffness = (result.parameters[name] for name in BOTH)
    assert not mu.identified and mu.reason == "nothing touched" and mu.interval95 == (None, None)
    assert not stiffness.identified and stiffness.reason == "the data do not depend on it"


def test_a_slip_that_the_noise_hides_is_not_an_estimate():
    gripping = forces(floor(mu=100.0), stroke(length=1e-3)[1])[:, 0]
    ratio = np.max(np.linalg.norm(gripping[100:, :2], axis=1) / gripping[100:, 2])
    # The pull grows with the length of the stroke: here to a thousandth more than friction holds.
    p = fitted(recorded(floor(), length=1e-3 * 0.6 / ratio * 1.001)).parameters[MU]
    assert not p.identified and p.interval95[0] == pytest.approx(0.6, rel=0.02)


def test_errors_of_the_model_widen_the_intervals():
    """The recording has damping, the fitted scene has none: neighbouring residuals err alike."""
    result = fitted(recorded(floor(damping=2.0), sigma=0.002), noise=None)
    naive = fitted(recorded(floor(damping=2.0), sigma=0.002), noise={"force": 0.002})
    for name in BOTH:
        assert result.parameters[name].standard_error > 10 * naive.parameters[name].standard_error
    assert result.residual_rms["force"] > 5 * result.noise["force"]
    assert within(result, STIFFNESS, 800.0)


def test_noise_that_differs_by_axis_widens_the_intervals_of_what_shows_along_it():
    """The stiffness shows in the load, of which the noise is ten times that of the friction."""
    (t, path), clean = stroke(), forces(floor(), stroke()[1])
    force = clean + np.array([0.01, 0.01, 0.1]) * np.random.default_rng(0).standard_normal(clean.shape)
    result = fitted(Recording(hip=path, hip_t=t, force=force, force_t=t), noise=None)
    error = result.parameters[STIFFNESS].standard_error
    assert error == pytest.approx(800.0 * 0.1 / np.linalg.norm(clean[..., 2]), rel=0.15)
    assert within(result, STIFFNESS, 800.0) and result.widened[1] > 1.5


def test_a_function_selects_as_paths_do():
    recording = recorded(floor())
    chosen = fitted(
        recording, free=lambda s: (s.object["floor"].surface.mu, s.object["floor"].surface.stiffness)
    )
    assert chosen.parameters == fitted(recording).parameters


@pytest.mark.slow
def test_samples_that_are_few_are_compared_at_their_times():
    result = fitted(recorded(floor(), every=10))
    assert within(result, MU, 0.6) and within(result, STIFFNESS, 800.0)
    ten_times = fitted(recorded(floor())).parameters[STIFFNESS].standard_error
    assert result.parameters[STIFFNESS].standard_error == pytest.approx(ten_times * np.sqrt(10), rel=0.1)


@pytest.mark.slow
def test_recordings_of_unequal_length_are_fitted_together():
    parts = [recorded(floor(), 0), recorded(floor(), 1, steps=300), recorded(floor(), 2)]
    together = fitted(parts)
    assert within(together, MU, 0.6, widths=4) and within(together, STIFFNESS, 800.0, widths=4)
    # Information adds up: the inverse covariances do, at nearly the same estimates.
    apart = sum(np.linalg.inv(fitted(part).covariance) for part in parts)
    np.testing.assert_allclose(np.linalg.inv(together.covariance), apart, rtol=0.02)


@pytest.mark.slow
def test_static_and_kinetic_friction_are_told_apart(tmp_path):
    truth = floor(mu_static=0.7, mu_kinetic=0.4)
    free = ["object.floor.surface.mu_static", "object.floor.surface.mu_kinetic"]
    off = floor(mu_static=1.0, mu_kinetic=0.5)
    result = fitted(recorded(truth), scene=off, free=free)
    assert within(result, free[0], 0.7) and within(result, free[1], 0.4)
    low, high = result.parameters[free[0]].interval95
    assert low < 0.7 < high < 1.05 * low
    assert result.residual_rms["force"] == pytest.approx(SIGMA, rel=0.05)
    # Where the two are one, the interval reaches down to where the kinetic one may be, and the scene holds the estimate.
    plain = fitted(recorded(floor(mu_static=0.5, mu_kinetic=0.5)), scene=off, free=free)
    static, kinetic = (plain.parameters[name] for name in free)
    assert static.interval95[0] == kinetic.interval95[0] < 0.5 < static.interval95[1] < 0.6
    assert "no more than 0.5" in static.reason and static.reason in str(table(plain).caption)
    save_scene(plain.scene, tmp_path / "floor.toml")
    surface: Any = load_scene(tmp_path / "floor.toml").object["floor"].surface
    assert float(surface.mu_static) == pytest.approx(static.estimate, rel=1e-6)
    stuck = fitted(recorded(truth, length=2e-4), scene=off, free=free).parameters
    assert not stuck[free[0]].identified and 0 < stuck[free[0]].interval95[0] <= 0.7
    assert not stuck[free[1]].identified and stuck[free[1]].interval95 == (None, None)
    assert stuck[free[1]].reason == "nothing slid"


@pytest.mark.slow
def test_an_object_may_be_called_as_a_number_is():
    scene = hapjax.Scene(
        object={
            "mu_static": hapjax.Object(hapjax.Plane(), hapjax.Surface(800.0, mu_static=0.7, mu_kinetic=0.4))
        }
    )
    path = "object.mu_static.surface.mu_static"
    assert within(fitted(recorded(scene), scene=scene, free=[path]), path, 0.7)


@pytest.mark.slow
def test_bounds_hold():
    off, limits = floor(0.4, 800.0), {MU: (0.1, 0.5)}
    assert within(fitted(recorded(floor(mu=0.3)), scene=off, free=[MU], bounds=limits), MU, 0.3)
    beyond = fitted(recorded(floor()), scene=off, free=[MU], bounds=limits)
    p = beyond.parameters[MU]
    assert not p.identified and p.reason == "ran to its bound 0.5"
    assert p.interval95[0] == pytest.approx(0.5, rel=0.01)
    assert float(beyond.scene.object["floor"].surface.mu) <= 0.5


@pytest.mark.slow
def test_a_product_alone_does_not_identify_its_factors():
    """In free fall nothing depends on the mass; on one spring the ratio k / m alone shows in the poses."""
    cube = hapjax.Object(
        hapjax.Box((0.1,) * 3), hapjax.Surface(200.0, mu=0.5), hapjax.Body(0.5, rotation=False)
    )
    scene = hapjax.Scene(object={"cube": cube})
    t, path = 1e-3 * np.arange(300), np.tile([0.0, 0.0, 0.048], (300, 1, 1))
    _, reply = hapjax.rollout(scene, hapjax.init(scene, path[0]), path)
    noise = 1e-5 * np.random.default_rng(0).standard_normal((300, 1, 3))
    pose = np.asarray(reply.pose) + np.pad(noise, [(0, 0), (0, 0), (0, 4)])
    free = ["object.cube.surface.stiffness", "object.cube.body.mass"]
    recording = Recording(hip=path, hip_t=t, pose=pose, pose_t=t + 1e-3)
    result = fitted(recording, scene=scene, free=free, observe="pose", noise={"position": 1e-5})
    for name, other in (free, free[::-1]):
        assert not result.parameters[name].identified
        assert result.parameters[name].reason == f"not to be told apart from {other}"
    sentence = f"In these 0.299 s they fix {free[0]} and {free[1]} only through their ratio."
    assert result.identifiability == (sentence,)


def test_scenes_of_either_precision_are_fitted(dtype):
    result = fitted(recorded(hapjax.cast(floor(), dtype)), scene=hapjax.cast(OFF, dtype))
    assert within(result, MU, 0.6) and within(result, STIFFNESS, 800.0)
    assert result.starts_at_best == 2


def test_starts_are_the_same_for_the_same_seed_and_the_first_is_the_scene():
    first, again = (fitted(recorded(floor()), seed=7) for _ in range(2))
    assert first.trace == again.trace and first.parameters == again.parameters
    assert sorted(first.trace) == [0, 1]
    start = float(
        jnp.sum(residuals_of(jnp.log(jnp.array([0.9, 500.0])), problem_of(OFF, [recorded(floor())])) ** 2) / 2
    )
    assert first.trace[0][0] == pytest.approx(start, rel=1e-9)
    assert first.trace[1][0] != pytest.approx(start, rel=1e-3)


def test_json_is_strict_and_has_the_agreed_keys(tmp_path):
    def no_constant(name):
        raise AssertionError(f"{name} is not JSON")

    result = fitted(recorded(floor(), **NO_SLIP))
    result.save_json(tmp_path / "fit.json")
    read = json.loads((tmp_path / "fit.json").read_text(), parse_constant=no_constant)
    assert set(read) >= {"parameters", "loss", "residual_rms", "converged", "starts", "wall_s"}
    assert read["converged"] is True and read["reason"] is None
    assert list(read["parameters"]) == BOTH
    mu, stiffness = (read["parameters"][name] for name in BOTH)
    assert set(mu) >= {"estimate", "standard_error", "interval95", "identified"}
    assert mu["estimate"] is None and mu["interval95"][1] is None and mu["identified"] is False
    assert read["identifiability"] == [
        f"The data fix {STIFFNESS}.",
        f"They do not fix {MU}: nothing slipped.",
    ]
    low, high = stiffness["interval95"]
    assert low < stiffness["estimate"] < high and stiffness["identified"] is True


def test_json_has_null_for_what_is_not_finite(tmp_path):
    result = replace(fitted(recorded(floor())), loss=np.inf, residual_rms={"force": np.nan})
    result.save_json(tmp_path / "fit.json")
    read = json.loads((tmp_path / "fit.json").read_text())
    assert read["loss"] is None and read["residual_rms"] == {"force": None}


def test_progress_is_shown_on_stderr_alone_and_on_a_terminal_alone(capfd, monkeypatch):
    for name in ("FORCE_COLOR", "TTY_COMPATIBLE"):
        monkeypatch.delenv(name, raising=False)
    fitted(recorded(floor()), progress=True)
    assert capfd.readouterr() == ("", "")
    monkeypatch.setenv("FORCE_COLOR", "1")  # rich takes stderr for a terminal
    fitted(recorded(floor()), progress=True)
    out, err = capfd.readouterr()
    assert out == "" and "of 2, step" in err and "left" in err
    fitted(recorded(floor()))
    assert capfd.readouterr() == ("", "")


def short():
    return recorded(floor(), steps=30)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (dict(recordings=[]), "no recording is given"),
        (dict(observe=()), "observe is empty"),
        (dict(observe=("force", "gimbal")), "observe names 'gimbal'; allowed: force, pose"),
        (dict(observe="pose"), "no object in the scene moves"),
        (dict(free=[]), "free is empty"),
        (dict(free=["object.floor.surface.m"]), "has no m"),
        (dict(bounds={STIFFNESS: (1.0, 10.0)}), "starts at 500; allowed: between its bounds 1 and 10"),
        (dict(noise={"force": 0.0}), "noise of force is 0.0"),
        (dict(noise={"position": float("nan")}), "noise of position is nan"),
        (dict(noise={"mass": 1.0}), "noise names mass"),
        (dict(starts=0), "starts is 0; allowed: a whole number from 1 to 10000"),
        (dict(starts=True), "starts is True"),
        (dict(max_steps=0), "max_steps is 0"),
        (dict(seed=-1), "seed is -1"),
        (dict(spread=0.5), "spread is 0.5; allowed: 1 to 1000000"),
        (dict(spread=float("nan")), "spread is nan"),
        (dict(names=["a", "b"]), "names has 2 names for 1 recordings"),
        (
            dict(recordings=[Recording(hip=np.zeros((9, 1, 3)), hip_t=np.arange(9.0))], names=["lift"]),
            "^lift: nothing to",
        ),
        (
            dict(recordings=Recording(force=np.zeros((9, 1, 3)), force_t=np.arange(9.0))),
            "recording 1: hip was not",
        ),
    ],
)
def test_refusals(options, message):
    arguments = dict(recordings=short(), free=BOTH) | options
    with pytest.raises(InputError, match=message) as refusal:
        fit(OFF, arguments.pop("recordings"), arguments.pop("free"), **arguments)
    assert "\n" not in str(refusal.value)


def test_more_free_numbers_than_measured_ones_are_refused():
    t, path = stroke(steps=3)
    box = hapjax.Scene(
        object={"box": hapjax.Object(hapjax.Box((1, 1, 1)), hapjax.Surface(9.0, mu=[0.5] * 6))}
    )
    recording = Recording(hip=path, hip_t=t, force=np.zeros((2, 1, 3)), force_t=t[:2])
    with pytest.raises(InputError, match="free has 6 numbers, and the recordings 6 to fit them to"):
        fit(box, recording, "object.box.surface.mu")


def test_one_wild_time_does_not_make_a_fit_long(tmp_path):
    """A CSV file with one time of 1000 s too many, or of which nothing was cleaned."""
    true = recorded(floor())
    true.save(tmp_path / "a.csv")
    lines = (tmp_path / "a.csv").read_text().splitlines()
    wild = ",".join(["1000.4", *lines[-1].split(",")[1:]])
    (tmp_path / "a.csv").write_text("\n".join([*lines, wild]) + "\n")
    cleaned = load_recording(tmp_path / "a.csv")
    result = fitted(cleaned)
    assert result.parameters[MU].estimate == pytest.approx(TRUTH[MU], rel=0.02)
    assert {finding.kind for finding in result.findings} == {"time jump"}
    with pytest.raises(InputError, match=r"recording 1: hip, row 399 at 0\.399 s: .*jump ahead by 1000 s"):
        fitted(Recording.load(tmp_path / "a.csv"))
