"""Which motion to record next."""

import json
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import hapjax
from fitting_cases import BOTH, MU, SIGMA, STIFFNESS, floor, forces, recorded, stroke
from hapjax import InputError, Recording
from hapjax.cli import main
from hapjax_fitting import fit, suggest
from hapjax_fitting.candidates import MOTIONS


def pressing() -> Recording:
    t, path = stroke(steps=200, length=0.0)
    force = forces(floor(), path) + SIGMA * np.random.default_rng(0).standard_normal(path.shape)
    return Recording(hip=path, hip_t=t, force=force, force_t=t)


@cache
def pressed() -> Any:
    return fit(floor(0.5, 700.0), pressing(), BOTH, noise={"force": SIGMA}, starts=2)


@pytest.mark.slow
def test_after_pressing_alone_a_stroke_is_suggested_for_mu():
    found = suggest(pressed())
    strokes = {"slow stroke", "fast stroke", "stroke with rising load", "circle"}
    assert found.best in strokes and found.best_for[MU] in strokes
    assert found.now[MU] == pytest.approx(1.0) and found.errors[found.best][MU] < 0.01
    for useless in ("press", "tap"):
        assert found.errors[useless][MU] == pytest.approx(1.0, rel=1e-3)
    words = " ".join(found.section().sentences)
    assert f"Record next: {found.best}" in words and f"For {MU}: {found.best_for[MU]}" in words
    assert set(found.gain) == set(MOTIONS) and min(found.gain.values()) > 0


@pytest.mark.slow
def test_what_is_promised_is_what_a_recording_of_it_gives():
    """The motion that is suggested is made, and fitted together with the pressing."""
    found = suggest(pressed())
    path = found.paths[found.best]
    t = 1e-3 * np.arange(len(path))
    force = forces(floor(), path) + SIGMA * np.random.default_rng(1).standard_normal(path.shape)
    late = slice(100, None)  # measured from where the motions begin to differ
    more = Recording(hip=path, hip_t=t, force=force[late], force_t=t[late])
    result: Any = fit(floor(0.5, 700.0), [pressing(), more], BOTH, noise={"force": SIGMA}, starts=2)
    for name in BOTH:
        estimate = result.parameters[name]
        assert estimate.standard_error / estimate.estimate == pytest.approx(
            found.errors[found.best][name], rel=0.3
        )


@pytest.mark.slow
def test_a_heavier_press_is_suggested_where_the_stiffness_alone_is_free():
    exact = pressing()
    assert exact.force is not None
    coarse = replace(exact, force=0.1 * np.rint(exact.force / 0.1))
    gains = []
    for recording, least in ((exact, 1.0), (coarse, 1.5)):
        result: Any = fit(floor(0.5, 700.0), recording, [STIFFNESS], noise={"force": SIGMA}, starts=2)
        found, number = suggest(result), result.parameters[STIFFNESS]
        assert found.best in ("press", "stroke with rising load")
        # Errors now are those of the fit, with what steps of the sensor add, and a motion is measured by the same sensor.
        assert result.widened[0] >= least
        assert found.now[STIFFNESS] == pytest.approx(number.standard_error / number.estimate)
        gains.append(found.errors["press"][STIFFNESS] / found.now[STIFFNESS])
    assert gains[0] == pytest.approx(gains[1], rel=0.05)


@pytest.mark.slow
def test_the_command_line_says_and_writes_it(tmp_path, capsys):
    pressing().save(tmp_path / "press.npz")
    hapjax.save_scene(floor(0.5, 700.0), tmp_path / "floor.toml")
    files = ["--json", str(tmp_path / "fit.json"), "--report", str(tmp_path)]
    arguments = ["--scene", str(tmp_path / "floor.toml"), "--free", *BOTH, "--starts", "2", *files]
    assert main(["fit", str(tmp_path / "press.npz"), *arguments, "--suggest"]) == 0
    figures = json.loads((tmp_path / "fit.json").read_text())["suggestion"]
    assert f"Record next: {figures['best']}" in " ".join(capsys.readouterr().out.split())
    assert "stroke" in figures["best_for"][MU] and set(figures["motions"]) == set(MOTIONS)
    assert "<h2>What to record next</h2>" in (tmp_path / "report.html").read_text()


@pytest.mark.slow
def test_without_a_contact_there_is_nothing_to_go_by():
    recording = recorded(floor(), steps=200, depth=-5e-4)
    with pytest.raises(InputError, match="nothing touched"):
        suggest(fit(floor(), recording, BOTH, noise={"force": SIGMA}, starts=2))
