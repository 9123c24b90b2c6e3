"""Ctrl-C during a fit: what was found so far is kept."""

import json
import signal
import subprocess
import sys
from contextlib import nullcontext

import pytest

import hapjax
import hapjax_fitting
from fitting_cases import BOTH, MU, SIGMA, floor, recorded
from hapjax import InputError
from hapjax.cli import main
from hapjax_fitting import fit, table
from hapjax_fitting.interrupt import once_more
from hapjax_fitting.progress import done
from hapjax_fitting.solve import Trace


@pytest.fixture(autouse=True)
def python_listens():
    """A program that a shell starts in the background is deaf to SIGINT."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def interrupting(monkeypatch, at, times=1):
    """Have the process send itself a SIGINT at a step of the solver."""
    add, count = Trace.add, [0]

    def adding(self, *step):
        add(self, *step)
        count[0] += 1
        if count[0] >= at and times > 0 and count[0] < at + times:
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(Trace, "add", adding)
    return count


def fitted(**options):
    return fit(floor(0.9, 500.0), recorded(floor()), BOTH, noise={"force": SIGMA}, starts=2, **options)


@pytest.mark.parametrize("progress", [False, True])
def test_an_interrupted_fit_keeps_the_best_so_far(monkeypatch, progress, capfd):
    whole = fitted()
    steps = sum(map(len, whole.trace.values()))
    count = interrupting(monkeypatch, at=4)
    result = fitted(progress=progress)
    assert count[0] < steps and not result.converged and result.interrupted
    assert result.reason == f"interrupted after {count[0]} steps"
    assert result.loss == pytest.approx(min(result.trace[0].values()), rel=1e-9)
    assert whole.loss * (1 - 1e-9) <= result.loss < result.trace[0][0]
    assert result.parameters[MU].estimate != whole.parameters[MU].estimate
    assert "Not converged: interrupted after" in str(table(result).caption)
    assert "Traceback" not in "".join(capfd.readouterr())
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    assert signal.set_wakeup_fd(-1) == -1


def test_with_nothing_found_yet_an_interrupt_goes_on(monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(sys.modules["hapjax_fitting.search"], "shots", stop)
    with pytest.raises(KeyboardInterrupt):
        fitted()


def test_a_handler_of_the_programs_own_is_left_alone(monkeypatch):
    heard = []
    before = signal.signal(signal.SIGINT, lambda *_: heard.append(1))
    try:
        interrupting(monkeypatch, at=3)
        result = fitted()
    finally:
        signal.signal(signal.SIGINT, before)
    assert heard == [1] and result.converged


INTERRUPTED = """
import signal, sys
from hapjax_command import run
from hapjax_fitting.solve import Trace
signal.signal(signal.SIGINT, signal.default_int_handler)
add, count = Trace.add, [0]
def adding(self, *step):
    add(self, *step)
    count[0] += 1
    if count[0] == 4:
        signal.raise_signal(signal.SIGINT)
Trace.add = adding
run()
"""


@pytest.mark.parametrize(
    ("stopped", "times", "kept"), [(False, 1, True), (False, 2, False), (True, 1, False)]
)
def test_one_interrupt_after_the_search_keeps_what_it_found(stopped, times, kept):
    trace, left = Trace(interrupted=stopped), [KeyboardInterrupt()] * times

    def made():
        if left:
            raise left.pop()
        return trace.interrupted

    with nullcontext() if kept else pytest.raises(KeyboardInterrupt):
        assert once_more(trace, made)


@pytest.mark.slow
def test_the_command_line_writes_what_it_has(tmp_path):
    """In a program of its own, where only the thread that fits has 64 bits on, and that of callbacks has not."""
    recorded(floor()).save(tmp_path / "stroke.npz")
    hapjax.save_scene(floor(0.9, 500.0), tmp_path / "scene.toml")
    arguments = ["fit", "stroke.npz", "--scene", "scene.toml", "--free", *BOTH, "--json", "fit.json"]
    program = [sys.executable, "-c", INTERRUPTED, *arguments, "--report", "report"]
    said = subprocess.run(program, cwd=tmp_path, capture_output=True, text=True)
    assert said.returncode == 130, said.stderr
    assert "mu" in said.stdout
    figures = json.loads((tmp_path / "fit.json").read_text())
    assert figures["converged"] is False and figures["reason"].startswith("interrupted after")
    assert "interrupted after" in (tmp_path / "report" / "report.html").read_text()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fails", "code"), [(KeyboardInterrupt(), 130), (InputError("suggest has no contact"), 2)]
)
def test_what_fails_beside_the_fit_does_not_throw_it_away(fails, code, tmp_path, monkeypatch, capsys):
    def suggest(result):
        raise fails

    monkeypatch.setattr(hapjax_fitting, "suggest", suggest)
    recorded(floor()).save(tmp_path / "stroke.npz")
    hapjax.save_scene(floor(), tmp_path / "scene.toml")
    arguments = ["--scene", str(tmp_path / "scene.toml"), "--free", MU, "--starts", "1", "--profile", MU]
    file = tmp_path / "fit.json"
    assert main(["fit", str(tmp_path / "stroke.npz"), *arguments, "--suggest", "--json", str(file)]) == code
    figures = json.loads(file.read_text())
    assert figures["converged"] and MU in figures["profiles"] and "suggestion" not in figures
    said = capsys.readouterr()
    assert "Profile" in said.out and ("no contact" in said.err) is (code == 2)


def test_the_time_left_goes_by_the_steps_that_other_starts_took():
    trace = Trace(losses={0: {0: 9.0, 4: 1.0}})
    assert done(trace, max_steps=100) == pytest.approx(0.04)
    trace.losses[1] = {0: 8.0, 2: 1.0}
    assert done(trace, max_steps=100) == pytest.approx(1.5)
    trace.losses[1][40] = 1.0
    assert done(trace, max_steps=100) < 2
