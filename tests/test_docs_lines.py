"""Every program and every line of the shell in README and docs is run by a test, or it is said here why not."""

import re
from pathlib import Path

import numpy as np
import pytest

import hapjax
from hapjax.cli import main
from test_cli import example
from test_docs import block
from test_docs_commands import PAGES, ROOT
from test_guides import FOLLOWED, INSTALLING

# By the tests that run all programs of these pages.
PROGRAMS = {
    "test_docs.py": ("README.md", "docs/index.md", "docs/devices.md", "docs/hardware.md", "docs/physics.md"),
    "test_guides.py": (
        "docs/concepts.md",
        *(f"docs/guides/{name}.md" for name in ("device", "mesh", "recording")),
    ),
    "test_docs_programs.py": (
        *("CONTRIBUTING.md", "docs/cluster.md", "docs/fitting.md", "docs/realtime.md", "docs/recording.md"),
    ),
}
# What is not run as it stands, and what runs the like.
NOT_PROGRAMS = {
    "with_laws(scene": "takes a minute to compile; tests/fitting/test_compare.py, with other laws",
    "unsettled(": "takes an hour; tests/test_benchmark_stability.py, in few cells",
}
HERE = ("hapjax simulate", "hapjax export", "hapjax import")
# All that begin with `hapjax` or are an example are taken by test_docs_commands.py as far as where their work begins.
NOT_LINES = {
    r"make ": "make runs the tests; .ci/run runs make",
    r"pip install |python3 -m venv |\. (\.v)?env/": "minutes each: make packages, by hand, installs with each extra alone",
    r"sudo ": "it changes the system",
    r"source ": "tests/test_cli_shell.py, in bash",
    r"hapjax demo ": "tests/test_cli.py",
    r"hapjax run .*(falcon|browser|--view|--tune)": "devices, a page or no end: tests/devices/test_run.py, test_viewer.py",
    r"hapjax run .* --seconds \d+ --record ": "tests/test_guides.py, the like of start.md, and tests/devices/test_run.py",
    r"hapjax benchmark latency": "tests/test_cli.py, with a loop of 0.2 s",
    r"hapjax benchmark (?!latency)": "minutes to hours: test_benchmark_*.py, fitting/test_benchmark_fit.py, on less",
    r"hapjax fit .*": "half a minute; tests/test_docs.py, test_guides.py and test_cli.py, of the like",
    r"(srun|XLA_FLAGS=\S+|fit=|\$fit) ": "a cluster, or several processes: tests/fitting/test_sharding.py",
    r"fit=": "as above",
    r"export XLA_FLAGS=": "it is for the benchmark below it",
    r"python examples/": "data that is not here, or minutes: tests/examples",
    r"hapjax view ": "no end: tests/test_cli_shell.py and tests/devices/test_viewer_replay.py",
}


def shown(language):
    """All blocks of a language, each as (page, text)."""
    for page in PAGES:
        for text in re.findall(
            rf"^ *```{language}\n(.*?)^ *```$", page.read_text(), re.DOTALL | re.MULTILINE
        ):
            yield page.relative_to(ROOT).as_posix(), text


def lines():
    """All lines of the shell but remarks, each as (page, line)."""
    for page, text in shown("sh"):
        for line in text.replace("\\\n", " ").splitlines():
            if said := " ".join(re.sub(r"(^|\s)#.*", "", line).split()):
                yield page, said


def run_elsewhere(page, line):
    examples = [" ".join(["hapjax", *example(name)]) for name in ("run", "recover", "devices", "doctor")]
    return (page in FOLLOWED and not line.startswith(INSTALLING)) or line in examples


def test_every_program_is_run_or_it_is_said_why_not():
    run = {page for pages in PROGRAMS.values() for page in pages}
    left = [(page, text) for page, text in shown("python") if page not in run]
    assert run <= {page for page, _ in shown("python")}
    for page, text in left:
        assert any(words in text for words in NOT_PROGRAMS), (page, text)
    for words in NOT_PROGRAMS:
        assert any(words in text for _, text in shown("python")), words
    for test, pages in PROGRAMS.items():
        text = (Path(__file__).parent / test).read_text()
        assert all(Path(page).name in text for page in pages), test


def test_every_line_is_run_or_it_is_said_why_not():
    left = [line for page, line in lines() if not run_elsewhere(page, line) and not line.startswith(HERE)]
    reasons = {line: [reason for reason in NOT_LINES if re.match(reason, line)] for line in left}
    assert [line for line, found in reasons.items() if not found] == []
    assert {reason for found in reasons.values() for reason in found} == {*NOT_LINES}


@pytest.mark.slow
def test_lines_of_files_run(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("cube.toml").write_text(block("scene_file.md", "toml"))
    hapjax.save_urdf(hapjax.load_scene("cube.toml"), "cube.urdf")
    Path("hapjax-demo").mkdir()
    Path("hapjax-demo/fitted.toml").write_text(Path("cube.toml").read_text())
    for name in ("lift.npz", "lift.mcap"):
        hapjax.Recording(hip=np.zeros((20, 1, 3)), hip_t=np.arange(20) * 1e-3).save(name)
    found = {line for _, line in lines() if line.startswith(HERE)}
    assert len(found) > 5
    for line in found:
        assert main(line.split()[1:]) == 0, (line, capsys.readouterr().err)
    for name in ("answer.csv", "answer.npz", "cube.xml", "cube.urdf", "again.toml"):
        assert Path(name).stat().st_size > 0
