"""The table and the HTML page of a fit."""

import base64
import io
import re
import subprocess
import sys
from functools import cache
from typing import Any

import pytest
from PIL import Image
from rich.console import Console

from fitting_cases import BOTH, MU, SIGMA, STIFFNESS, TRUTH, floor, recorded
from hapjax import InputError
from hapjax_fitting import fit, table, write_report


@cache
def result(length=0.02, noise=SIGMA) -> Any:
    names = ["<script>alert(1)</script> & $x$ \u6307"]
    recording = recorded(floor(), length=length)
    return fit(floor(0.9, 500.0), recording, BOTH, noise={"force": noise}, starts=2, names=names)


def printed(shown, width=120):
    file = io.StringIO()
    Console(width=width, file=file, color_system=None).print(shown)
    return file.getvalue()


def cells(text, name):
    """The cells of a parameter's row, which are two spaces or more apart."""
    line = next(line for line in text.splitlines() if name in line)
    return re.split(r" {2,}", line.strip())


def test_the_table_shows_truth_estimate_error_and_interval():
    _, truth, found, interval = cells(printed(table(result(), TRUTH)), MU)
    p = result().parameters[MU]
    assert float(truth) == 0.6
    estimate, error = (float(x) for x in found.split(" ± "))
    assert estimate == pytest.approx(p.estimate, abs=p.standard_error / 10)
    assert error == pytest.approx(p.standard_error, rel=0.05)
    ends = tuple(float(x) for x in interval.split(" to "))
    assert ends == pytest.approx(p.interval95, abs=p.standard_error / 10)


def test_the_table_shows_99_percent_intervals_where_asked():
    text = printed(table(result(), interval99=True))
    assert "99 % interval" in text and "95 %" not in text and "truth" not in text
    low = float(cells(text, MU)[-1].split(" to ")[0])
    assert low == pytest.approx(result().parameters[MU].interval99[0], abs=1e-4)


def test_a_lower_bound_is_said_in_words():
    p = result(length=2e-4).parameters[MU]
    text = printed(table(result(length=2e-4)))
    assert f"at least {p.interval95[0]:.3g}: nothing slipped" in text
    assert f"The data fix {STIFFNESS}." in text and "The data fix" not in printed(table(result()))


def test_residuals_beyond_the_noise_are_warned_of():
    assert "larger than the noise" not in printed(table(result()))
    assert "larger than the noise (force 9." in printed(table(result(noise=SIGMA / 10)))


def test_the_page_is_complete_in_itself(tmp_path):
    path = write_report(result(), tmp_path / "new" / "folder", TRUTH)
    assert path == tmp_path / "new" / "folder" / "report.html"
    assert [p.name for p in path.parent.iterdir()] == ["report.html"]
    page = path.read_text(encoding="utf-8")
    assert len(page) < 3e6
    assert "://" not in page and "<script" not in page and "url(" not in page and "@import" not in page
    assert "&lt;script&gt;alert(1)&lt;/script&gt; &amp; $x$ \u6307" in page
    sources = re.findall(r'src="([^"]*)"', page)
    assert len(sources) == 7
    for source in sources:
        kind, data = source.split(",")
        assert kind == "data:image/png;base64"
        picture = Image.open(io.BytesIO(base64.b64decode(data))).convert("L")
        assert picture.width == 1100 and len(picture.getcolors() or ()) > 10
    for title in (
        "Intervals",
        "Correlations",
        "Cost",
        "measured and predicted",
        "residuals",
        "Stick and slip",
        "cone",
    ):
        assert re.search(f'alt="[^"]*{title}', page)
    for name in (MU, STIFFNESS):
        assert f"<td>{name}</td>" in page


def test_a_page_without_anything_identified(tmp_path):
    write_report(result(length=2e-4), tmp_path)
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "at least 0.10" in page and "nan" not in re.sub(r'src="[^"]*"', "", page).lower()


def test_what_was_there_stays_when_the_page_cannot_be_written(tmp_path):
    (tmp_path / "file").write_text("precious")
    with pytest.raises(InputError, match="no such folder can be made"):
        write_report(result(), tmp_path / "file")
    (tmp_path / "report.html").mkdir()
    with pytest.raises(InputError, match="report.html: cannot be written"):
        write_report(result(), tmp_path)
    assert (tmp_path / "file").read_text() == "precious"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "report.html"]


def test_a_truth_of_what_was_not_free_is_refused(tmp_path):
    for write in (lambda t: table(result(), t), lambda t: write_report(result(), tmp_path, t)):
        with pytest.raises(InputError, match="truth names mass; allowed: object.floor.surface.mu, "):
            write({"mass": 1.0})
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_plots_are_drawn_only_when_a_report_is_written():
    program = "import sys, hapjax_fitting; assert not {'matplotlib', 'PIL'} & set(sys.modules)"
    assert subprocess.run([sys.executable, "-c", program]).returncode == 0
