"""The notebooks: stored without outputs, executed without a warning, and what they print is so."""

import re
from pathlib import Path

import nbformat
import pytest
from notebooks import NOTEBOOKS, executed, text_of

ROOT = Path(__file__).resolve().parents[1]
NUMBER = r"(-?[0-9.]+(?:e[-+]?[0-9]+)?)"

# What is printed, and between which numbers.
CLAIMS = {
    "tune_mu_and_stiffness": [
        (rf"mu {NUMBER}, stiffness", 0.4499, 0.4501),
        (rf"stiffness {NUMBER} N/m", 799.9, 800.1),
        (rf"from mu = {NUMBER} on", 3, 5),
    ],
    "calibrate_a_surface": [
        (rf"surface.mu +not identified +no: at least {NUMBER}", 0.2, 0.25),
        (rf"surface.mu +0.4200 +{NUMBER} ±", 0.41, 0.43),
        (rf"surface.stiffness +950.0 +{NUMBER} ±", 940, 960),
        (rf"converged: True, {NUMBER} of 8 starts", 2, 8),
    ],
    "two_finger_lift": [
        (rf"body.mass +{NUMBER} ±", 0.149, 0.151),
        (rf"inertia\[0\] +{NUMBER} ±", 1.09e-4, 1.11e-4),
        (rf"critical_area +{NUMBER} ±", 1.98e-5, 2.02e-5),
        (rf"converged: True; residuals {NUMBER} N", 0.019, 0.021),
    ],
    "design_an_excitation": [
        (rf"damping: {NUMBER} before", 0.56, 0.58),
        (rf"damping: .* {NUMBER} now", 0.76, 0.78),
        (rf"damping: .*\n.* {NUMBER} % before", 20, 80),
        (rf"damping: .*\n.* {NUMBER} % now", 9.2, 9.5),  # 0.072 s/m
        (rf"damping: .*\n.* foretold {NUMBER} %", 12.9, 13.3),  # 0.075 s/m
        (rf"mu: .*\n.* {NUMBER} % now", 0.2, 0.22),
        (rf"mu: .*\n.* foretold {NUMBER} %", 0.2, 0.22),
        (rf"stiffness: .*\n.* {NUMBER} % now", 0.085, 0.105),
        (rf"stiffness: .*\n.* foretold {NUMBER} %", 0.085, 0.105),
    ],
    "choose_an_integrator": [
        (rf"semi_implicit: off by [0-9.]+, {NUMBER},", 200, 300),
        (rf"substeps: off by [0-9.]+, {NUMBER},", 0, 2),
        (rf"within 2e-06 m: lie_midpoint, {NUMBER} substeps", 2, 2),
        (rf"SemiImplicit: .* and {NUMBER} mm", 100, 1e6),
        (rf"Implicit: after 0.1 s between {NUMBER} and 30 mm", 30, 30),
    ],
    "a_thousand_recordings": [
        (rf"{NUMBER} recordings of 120 ms", 1000, 1000),
        (rf"converged: False\nresiduals {NUMBER} N, noise 0.05", 0.1, 0.2),
        (rf"residuals {NUMBER} N, converged: True", 0.049, 0.051),
        (rf"hold the truth: {NUMBER} of 100", 90, 100),
    ],
}


def read(path):
    return nbformat.read(path, as_version=4)


def test_every_notebook_is_tested_and_in_the_documentation():
    assert {path.stem for path in NOTEBOOKS} == set(CLAIMS)
    nav = re.findall(r"lessons/(\w+)\.md", (ROOT / "mkdocs.yml").read_text())
    assert sorted(nav) == sorted(CLAIMS)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_stored_without_outputs(path):
    notebook = read(path)
    nbformat.validate(notebook)
    for cell in notebook.cells:
        if cell.cell_type == "code":
            assert cell.outputs == [] and cell.execution_count is None
    assert notebook.cells[0].source.startswith("# ")  # a lesson has a title


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_shows_its_claims(path):
    notebook = executed(path)
    outputs = [output for cell in notebook.cells for output in cell.get("outputs", [])]
    assert not [o.text for o in outputs if o.get("name") == "stderr"]
    assert not [o for o in outputs if o.output_type == "execute_result"]  # such as <Legend at 0x7f...>
    assert any("image/svg+xml" in o.get("data", {}) for o in outputs)
    text = "\n".join(map(text_of, outputs))
    for pattern, low, high in CLAIMS[path.stem]:
        found = re.search(pattern, text)
        assert found, (pattern, text)
        assert low <= float(found[1]) <= high, (pattern, found[0])
