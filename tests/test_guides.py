"""The guides, followed word for word: files are written, commands given, programs run, in their order and in one folder."""

import contextlib
import io
import json
import re
import shlex
from pathlib import Path
from typing import Any

import concept_figures
import numpy as np
import pytest

import hapjax
from hapjax import cli

DOCS = Path(__file__).resolve().parents[1] / "docs"
FOLLOWED = ("docs/start.md", "docs/guides/device.md", "docs/guides/mesh.md", "docs/guides/recording.md")
INSTALLING = ("python3 -m venv ", ". env/bin/activate", "pip install ")


def follow(page):
    """Do what a page says, in the folder that is the present one; what its programs left."""
    text, left = (DOCS / page).read_text(), dict[str, Any](__name__="__main__")
    blocks = re.findall(r'^```(\w+)(?: title="([\w.]+)")?\n(.*?)^```$', text, re.DOTALL | re.MULTILINE)
    printed = None
    for language, title, block in blocks:
        if title:
            Path(title).write_text(block)
        elif language == "sh":
            for line in block.replace("\\\n", " ").splitlines():
                assert line.startswith(INSTALLING) or command(line) == 0, line
        elif language == "python":
            with contextlib.redirect_stdout(io.StringIO()) as out:
                exec(compile(block, page, "exec"), left)
            printed = out.getvalue()
        else:
            assert language == "text" and printed == block, (printed, block)
    return left


def command(line):
    """The exit code of a line of the shell."""
    program, *arguments = shlex.split(line)
    assert program == "hapjax", line
    try:
        return cli.main(arguments)
    except SystemExit as ended:
        return ended.code


def found(file="fit.json"):
    """The estimates of a fit by the last part of their names."""
    fit = json.loads(Path(file).read_text())
    assert fit["converged"] and not fit["findings"], fit
    return {name.split(".")[-1]: p["estimate"] for name, p in fit["parameters"].items()}


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.slow
def test_the_start_ends_in_a_fitted_mu(capsys):
    follow("start.md")
    recording = hapjax.load_recording("stroke.mcap")
    assert recording.force is not None and recording.model_force is not None
    if np.abs(recording.force - recording.model_force).max() > 0.01:
        pytest.skip("this machine was too busy for the servo loop, which put out no force for a while")
    assert found() == {"mu": pytest.approx(0.5, rel=0.01), "stiffness": pytest.approx(1000, rel=0.01)}
    assert Path("report/report.html").stat().st_size > 10_000


@pytest.mark.slow
def test_the_guide_to_a_recording_finds_what_was_touched(capsys):
    follow("guides/recording.md")
    assert found() == {"mu": pytest.approx(0.35, rel=0.02), "stiffness": pytest.approx(900, rel=0.02)}


@pytest.mark.slow
def test_the_guide_to_a_device_records(capsys):
    follow("guides/device.md")
    recording = hapjax.Recording.load("wall.npz")
    assert recording.hip is not None and recording.force is not None
    np.testing.assert_allclose(recording.force[-1, 0, 0], -500 * recording.hip[-1, 0, 0], rtol=0.01)


@pytest.mark.slow
def test_the_guide_to_a_mesh_touches_it(capsys):
    left = follow("guides/mesh.md")
    volume = float(left["part"].shape.volume())
    assert volume == pytest.approx(np.pi * 0.025**2 * 0.04, rel=0.02)
    assert float(left["part"].body.mass) == pytest.approx(1050 * volume, rel=1e-5)


# Concepts -------------------------------------------------------------------------------------------------


def test_the_concepts_step_prints_what_is_shown():
    follow("concepts.md")


def curves(figure):
    return {line.get_label(): np.asarray(line.get_ydata()) for line in figure.axes[0].lines}


def test_every_figure_of_the_concepts_is_drawn_and_shown():
    shown = re.findall(r"\]\(images/(\w+)\.svg\)", (DOCS / "concepts.md").read_text())
    assert shown == list(concept_figures.FIGURES)
    assert concept_figures.svg(concept_figures.god_object()).lstrip().startswith(b"<?xml")


def test_the_figures_show_what_is_said_below_them():
    stroke = curves(concept_figures.stick_and_slip())
    along, slips = stroke["tangential force, sticks"], stroke["slips"]
    assert 0.3 < np.isfinite(slips).mean() < 0.7 and np.nanmax(np.abs(along)) <= 0.6 * 800 * 2.5e-3 + 1e-3
    swings = curves(concept_figures.gravity_drop())
    assert np.abs(swings["A = 1.2 A_crit"]).max() < 1e-3
    soon = {label: curve[200] for label, curve in swings.items()}
    assert soon["A = 0.3 A_crit"] > 2 * soon["A = 0.8 A_crit"] > 10
