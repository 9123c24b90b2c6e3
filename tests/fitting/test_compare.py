"""Models compared: the law that made the recording wins."""

import json
import sys
from functools import cache
from typing import Any, cast

import numpy as np
import pytest

import hapjax
import hapjax_fitting
from fitting_cases import BOTH, MU, SIGMA, STIFFNESS, floor, recorded
from hapjax import InputError
from hapjax.cli import main
from hapjax_fitting import compare, with_laws
from hapjax_fitting.compare import CRITERIA, _parts
from helpers import followed

STRIBECK = floor(mu_static=0.7, mu_kinetic=0.4, friction=hapjax.Stribeck(0.05, 0.5))


@cache
def compared(made_by) -> Any:
    scene = {"cone": floor(0.5), "stribeck": STRIBECK}[made_by]
    scenes, free = with_laws(floor(0.45), ["cone", "stribeck"], BOTH)
    with pytest.MonkeyPatch.context() as patch:
        bars = followed(patch, sys.modules["hapjax_fitting.compare"])
        found = compare(scenes, recorded(scene, steps=208), free, starts=1, noise={"force": SIGMA})
    assert bars == [{"total": 2.0, "told": 2.0, "apart": False}]
    return found


@pytest.mark.slow
def test_stribecks_law_wins_where_it_made_the_recording():
    found = compared("stribeck")
    assert found.best == dict.fromkeys(CRITERIA, "stribeck")
    cone, stribeck = found.models["cone"], found.models["stribeck"]
    assert stribeck.held_out < 0.8 * cone.held_out
    assert cone.bic - stribeck.bic > 100


@pytest.mark.slow
def test_the_cone_wins_where_it_made_the_recording():
    found = compared("cone")
    assert found.best["bic"] == "cone"
    cone, stribeck = found.models["cone"], found.models["stribeck"]
    # The noise is known: the criteria are the textbook's, of the chi-squared and the count of numbers.
    n = sum(cone.result.measured.values())
    assert (cone.numbers, stribeck.numbers, n) == (2, 5, 624)
    assert cone.aic == pytest.approx(2 * cone.result.loss + 4, rel=1e-9)
    assert cone.aicc == pytest.approx(cone.aic + 12 / 621, rel=1e-12)
    assert stribeck.bic == pytest.approx(2 * stribeck.result.loss + 5 * np.log(624), rel=1e-9)


@pytest.mark.slow
def test_the_comparison_is_printed_and_written(tmp_path, capsys, monkeypatch):
    recorded(STRIBECK, steps=208).save(tmp_path / "stroke.npz")
    hapjax.save_scene(floor(0.45), tmp_path / "floor.toml")

    def already_done(scenes, recordings, free, **options):
        assert (
            list(scenes) == list(free) == ["cone", "stribeck"] and len(recordings) == options["starts"] == 1
        )
        return compared("stribeck")

    monkeypatch.setattr(hapjax_fitting, "compare", already_done)
    files = ["--json", str(tmp_path / "fit.json"), "--report", str(tmp_path / "report")]
    arguments = ["--scene", str(tmp_path / "floor.toml"), "--free", *BOTH, "--starts", "1", *files]
    assert main(["fit", str(tmp_path / "stroke.npz"), *arguments, "--compare", "cone", "stribeck"]) == 0
    out = " ".join(capsys.readouterr().out.split())
    assert "Models compared" in out and "Best: stribeck by AIC, AICc, BIC, held-out error" in out
    figures = json.loads((tmp_path / "fit.json").read_text())
    assert figures["comparison"]["best"]["bic"] == "stribeck"
    assert set(figures["comparison"]["models"]) == {"cone", "stribeck"}
    assert figures["parameters"] == figures["comparison"]["models"]["stribeck"]["parameters"]
    assert "<h2>Models compared</h2>" in (tmp_path / "report" / "report.html").read_text()


def test_laws_take_the_place_of_the_one_whose_mu_is_free():
    laws = ["cone", "viscous", "stribeck", "karnopp", "dahl", "lugre"]
    scenes, free = with_laws(floor(0.4), laws, BOTH)
    surface = "object.floor.surface."
    assert free["cone"] == (MU, STIFFNESS)
    assert free["viscous"] == (MU, surface + "friction.coefficient", STIFFNESS)
    assert free["lugre"] == (
        *(surface + name for name in ("mu_static", "mu_kinetic")),
        *(surface + "friction." + name for name in ("bristle_damping", "viscous", "stribeck_velocity")),
        STIFFNESS,
    )
    for law, scene in scenes.items():
        felt: Any = scene.object["floor"].surface
        assert isinstance(felt.law(), hapjax.friction.LAWS[law])
        assert float(felt.mu if felt.mu is not None else felt.mu_kinetic) == pytest.approx(0.4)
    # Numbers that the scene has are the start.
    scenes, _ = with_laws(STRIBECK, ["lugre", "dahl"], [STIFFNESS, "object.floor.surface.friction.viscous"])
    lugre, dahl = (cast(Any, scenes[law].object["floor"].surface) for law in ("lugre", "dahl"))
    assert float(lugre.friction.viscous) == 0.5 and float(lugre.friction.stribeck_velocity) == 0.05
    assert float(lugre.mu_static) == 0.7 and float(dahl.mu) == 0.4


def test_what_is_held_out_is_each_sample_once():
    recording: Any = recorded(floor(), steps=330)
    parts: Any = _parts([recording], ("force", "pose"))
    assert len(parts) == 4
    for (kept,), (left,) in parts:
        assert len(left.force_t) == 80 and len(kept.force_t) == 240 and len(kept.hip_t) == 330
        assert not np.intersect1d(kept.force_t, left.force_t).size
        assert np.sum(np.diff(left.force_t) > 1.5e-3) == 3  # four pieces, spread over its time
    held = np.concatenate([left.force_t for _, (left,) in parts])
    np.testing.assert_array_equal(np.sort(held), recording.force_t[:320])
    several = [recorded(floor(), seed, steps=40) for seed in range(6)]
    for kept, left in _parts(several, ("force",)):
        assert len(kept) + len(left) == 6 and not set(map(id, kept)) & set(map(id, left))
    assert sorted(len(left) for _, left in _parts(several, ("force",))) == [1, 1, 2, 2]
    assert _parts([recorded(floor(), steps=30)], ("force",)) == []


@pytest.mark.parametrize(
    ("laws", "free", "message"),
    [
        (["cone"], BOTH, "compare names 1 law; allowed: at least two"),
        (["cone", "ice"], BOTH, "compare names 'ice'; allowed: cone, viscous"),
        (["cone", "cone"], BOTH, "compare names cone twice"),
        (["cone", "dahl"], [STIFFNESS], "free names no mu"),
    ],
)
def test_refusals(laws, free, message):
    with pytest.raises(InputError, match=message):
        with_laws(floor(), laws, free)


def test_models_without_a_choice_of_what_is_free_are_refused():
    with pytest.raises(InputError, match="free lacks the model b"):
        compare({"a": floor(), "b": floor()}, recorded(floor(), steps=30), {"a": BOTH})
    with pytest.raises(InputError, match="models has 1; allowed: at least two"):
        compare({"a": floor()}, recorded(floor(), steps=30), BOTH)


@pytest.mark.parametrize(("width", "whole"), [(120, True), (60, False)])
def test_a_section_too_wide_for_the_terminal_numbers_its_columns(width, whole, capsys):
    from rich.console import Console

    from hapjax_fitting import Section

    names = ("object.cube.surface.mu", "object.cube.surface.stiffness", "object.cube.body.mass")
    Console(width=width).print(Section("What", ("So it is.",), ("motion", *names), (("taps", *"123"),)))
    shown = capsys.readouterr().out
    assert ("(2) object.cube.surface.stiffness\n" not in shown) is whole
    assert all(name in shown for name in names) and shown.rstrip().endswith("So it is.")
    assert max(map(len, shown.splitlines())) <= width


def test_a_section_is_escaped(tmp_path):
    from hapjax_fitting import Section

    html = Section("a < b", ("c & d",), ("x", "y"), (("<i>", "1"),)).html()
    assert "a &lt; b" in html and "c &amp; d" in html and "&lt;i&gt;" in html and "<i>" not in html


@pytest.mark.slow
@pytest.mark.parametrize(("stop", "names"), [(1, ["cone"]), (2, ["cone", "stribeck"])])
def test_an_interrupt_keeps_the_models_so_far(monkeypatch, stop, names):
    done = [model.result for model in compared("cone").models.values()]
    calls = []

    def one_after_the_other(*_, **__):
        calls.append(1)
        if len(calls) > stop:
            raise KeyboardInterrupt
        return done[len(calls) - 1]

    monkeypatch.setattr(sys.modules["hapjax_fitting.compare"], "fit", one_after_the_other)
    scenes, free = with_laws(floor(0.45), ["cone", "stribeck"], BOTH)
    found = compare(scenes, recorded(floor(0.5), steps=208), free, starts=1, noise={"force": SIGMA})
    assert found.interrupted and list(found.models) == names and found.best["bic"] == "cone"
    assert all(model.held_out is None for model in found.models.values())
    assert found.section().sentences[0].startswith("Interrupted")
