"""What the documentation shows is what the program reads."""

import re
from pathlib import Path

import numpy as np
import pytest

import hapjax

DOCS = Path(__file__).resolve().parents[1] / "docs"


def block(page, language):
    """The first block of code in a language."""
    found = re.search(rf"^```{language}\n(.*?)^```$", (DOCS / page).read_text(), re.DOTALL | re.MULTILINE)
    assert found, f"{page} has no block of {language}"
    return found[1]


def test_the_scene_file_is_read(tmp_path):
    path = tmp_path / "cube.toml"
    path.write_text(block("scene_file.md", "toml"))
    scene = hapjax.load_scene(path)
    assert scene.moving() == ["cube"]
    assert scene.object["cube"].surface is not None
    assert float(scene.object["cube"].surface.stiffness) == pytest.approx(800)


def test_the_recording_is_read(tmp_path):
    path = tmp_path / "recording.csv"
    path.write_text(block("recording.md", "text"))
    recording = hapjax.Recording.load(path)
    np.testing.assert_array_equal(recording.force_t, [0, 0.01])
    np.testing.assert_array_equal(recording.hip_t, [0, 0.001, 0.002, 0.01])
