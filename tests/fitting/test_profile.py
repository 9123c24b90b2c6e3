"""Profile likelihood: a parabola where the model is linear, lopsided or open where it is not."""

import json
import sys
from functools import cache
from typing import Any

import numpy as np
import pytest

import hapjax
from fitting_cases import BOTH, MU, SIGMA, STIFFNESS, floor, recorded, stroke
from hapjax import InputError, Recording
from hapjax.cli import main
from hapjax_fitting import fit, profile
from hapjax_fitting.profile import check_names
from helpers import followed

T, PATH = stroke(steps=200, length=0.0)
DEPTH = np.maximum(-PATH[:, 0, 2], 0)


@cache
def pressed(sigma) -> Any:
    """A finger that only presses: the force is k times the depth, linear in k. The noise is known."""
    force = np.zeros((200, 1, 3))
    force[:, 0, 2] = 800.0 * DEPTH
    force += sigma * np.random.default_rng(0).standard_normal(force.shape)
    recording = Recording(hip=PATH, hip_t=T, force=force, force_t=T)
    result = fit(floor(stiffness=700.0), recording, [STIFFNESS], noise={"force": sigma}, starts=2)
    square = np.sum(DEPTH**2)
    return result, np.sum(force[:, 0, 2] * DEPTH) / square, sigma / np.sqrt(square)


@pytest.mark.parametrize("sigma", [SIGMA, 5.0])
def test_where_the_force_is_linear_in_the_number_the_interval_is_the_exact_one(sigma, monkeypatch):
    """Symmetric in the stiffness, so lopsided in its logarithm, which is what was fitted."""
    result, best, error = pressed(sigma)
    bars = followed(monkeypatch, sys.modules["hapjax_fitting.profile"])
    found: Any = profile(result, STIFFNESS)
    assert bars[0]["total"] == 44 <= bars[0]["told"] < 50  # a side may need a step more
    assert found.estimate == pytest.approx(best, rel=1e-5)
    np.testing.assert_allclose(found.interval95, best + error * np.array([-1.95996, 1.95996]), rtol=2e-3)
    np.testing.assert_allclose(found.interval99, best + error * np.array([-2.57583, 2.57583]), rtol=3e-3)
    np.testing.assert_allclose(found.deviance, ((found.values - best) / error) ** 2, atol=0.01)
    local = np.array(result.parameters[STIFFNESS].interval95, float)
    if sigma == SIGMA:
        np.testing.assert_allclose(found.interval95, local, rtol=1e-4)
    else:
        assert np.abs(local - found.interval95).max() > 0.1 * error


@pytest.mark.slow
def test_the_others_are_fitted_anew_and_a_mu_that_never_slips_is_open_above(tmp_path, capsys):
    recorded(floor(), steps=200).save(tmp_path / "stroke.npz")
    hapjax.save_scene(floor(0.5, 700.0), tmp_path / "floor.toml")
    files = ["--json", str(tmp_path / "fit.json"), "--report", str(tmp_path)]
    arguments = ["--scene", str(tmp_path / "floor.toml"), "--free", *BOTH, "--starts", "2", *files]
    assert main(["fit", str(tmp_path / "stroke.npz"), *arguments, "--profile", *BOTH]) == 0
    assert f"Profile of {MU}" in capsys.readouterr().out
    figures = json.loads((tmp_path / "fit.json").read_text())
    page = (tmp_path / "report.html").read_text()
    for name in BOTH:
        low, high = figures["profiles"][name]["interval95"]
        # Little noise: nearly a parabola, but one sixth too narrow if the other number were not fitted anew.
        ends = figures["parameters"][name]["interval95"]
        assert np.abs(np.subtract((low, high), ends)).max() < 0.03 * (high - low)
        assert f'alt="Profile likelihood of {name}"' in page
    never = fit(floor(0.5, 700.0), recorded(floor(), steps=200, length=2e-4), BOTH, starts=2)
    found = profile(never, MU)
    low = never.parameters[MU].interval95[0]
    assert low is not None and found.interval95[1] is None
    assert found.interval95[0] == pytest.approx(low, rel=0.1)
    assert "open" in found.section().rows[0]


def test_what_was_not_free_has_no_profile():
    with pytest.raises(InputError, match=f"profile names {MU}, which is not free; allowed: {STIFFNESS}"):
        profile(pressed(SIGMA)[0], MU)


def test_a_wrong_name_is_refused_before_the_fit(tmp_path, capsys):
    arguments = [
        "--scene",
        str(tmp_path / "absent.toml"),
        "--free",
        *BOTH,
        "--profile",
        "object.floor.surface.damping",
    ]
    assert main(["fit", str(tmp_path / "absent.npz"), *arguments]) == 2
    assert (
        "profile names object.floor.surface.damping, which is not free; allowed: " in capsys.readouterr().err
    )
    for name in ("object.cube.body.mass", "object.cube.body.pseudo_inertia"):
        with pytest.raises(InputError, match=f"{name}, .* allowed: {MU}; of pseudo_inertia there is none"):
            check_names([name], [MU, "object.cube.body.pseudo_inertia"])
    with pytest.raises(InputError, match=f"{MU}, which each recording has for itself; allowed: {MU} @"):
        check_names([MU], BOTH, [MU])
    check_names([f"{MU}[2]", f"{MU} @ stroke.npz"], BOTH)
