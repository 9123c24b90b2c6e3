"""How far a long command is: shown on a terminal alone, and drawn by another process where this one must not be held up."""

import json
import time
from contextlib import contextmanager

import numpy as np
import pytest

import hapjax
from hapjax import progress
from hapjax.benchmark import scene
from hapjax.cli import main
from hapjax.files import write_json
from hapjax.progress import each_tick, following
from helpers import followed


@pytest.mark.parametrize("apart", [False, True])
def test_a_terminal_alone_is_told(apart, capfd, monkeypatch):
    for name in ("FORCE_COLOR", "TTY_COMPATIBLE"):
        monkeypatch.delenv(name, raising=False)
    with following(2.0, apart) as advance:
        advance("half of it", 1.0)
    assert capfd.readouterr() == ("", "")
    monkeypatch.setenv("FORCE_COLOR", "1")  # rich takes stderr for a terminal
    with following(2.0, apart) as advance:
        advance("half of it", 1.0)
        print("what a program reads")
    out, err = capfd.readouterr()
    assert out == "what a program reads\n" and "half of it" in err


@pytest.mark.parametrize("apart", [False, True])
@pytest.mark.parametrize(("total", "steps"), [(None, 2), (4.0, 0), (4.0, 2)])
def test_the_time_left_is_shown_as_soon_as_it_is_known(apart, total, steps, capfd, monkeypatch):
    """What takes as long as nobody knows shows for how long it has been at it."""
    monkeypatch.setenv("FORCE_COLOR", "1")
    with following(total, apart, doing="reading") as advance:
        for _ in range(steps):
            advance("reading", 1.0)
            time.sleep(0.01)  # so that the two have a speed
    err = capfd.readouterr().err
    assert "reading" in err and "0:00:00" in err
    assert ("left" in err) == (total is not None and steps == 2)


def test_what_is_not_to_be_shown_is_not(capfd, monkeypatch):
    monkeypatch.setenv("FORCE_COLOR", "1")
    with following(2.0, shown=False) as advance:
        advance("half of it", 1.0)
    assert capfd.readouterr() == ("", "")


HELD = """
import pathlib, time
print(flush=True)
for _ in range(500):
    if pathlib.Path("done").exists():
        break
    time.sleep(0.01)
else:
    pathlib.Path("waited").touch()
"""


@pytest.mark.parametrize("program", [HELD, "print()"], ids=["held", "ended"])
def test_nobody_waits_for_what_draws(program, monkeypatch, tmp_path):
    """A terminal that is held reads no more; a process that has ended neither."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FORCE_COLOR", "1")
    (tmp_path / "draw.py").write_text(program)
    monkeypatch.setattr(progress, "__file__", str(tmp_path / "draw.py"))
    with following(1.0, apart=True) as advance:
        for _ in range(5000):  # more than a pipe holds
            advance("a loop that goes on", 1e-4)
        (tmp_path / "done").touch()
    assert not (tmp_path / "waited").exists()


@pytest.mark.slow
def test_a_step_of_each_scene_is_told(monkeypatch):
    bars = followed(monkeypatch, scene)
    table = hapjax.Object(hapjax.Plane(), hapjax.Surface(1000.0, mu=0.5))
    parts = scene.measure(hapjax.Scene({"table": table}), 1)["parts"]
    assert [part["without"] for part in parts] == ["everything", "object.table.surface"]
    assert parts[0]["equations"] > parts[1]["equations"] and all(part["step_us"] > 0 for part in parts)
    assert bars == [{"total": 12.0, "told": 12.0, "apart": True}]


def test_a_command_says_what_it_is_at_before_its_work_and_in_it(tmp_path, monkeypatch):
    stages, table, file = [], str(tmp_path / "table.toml"), str(tmp_path / "a.mcap")

    @contextmanager
    def at(total, *, doing="compiling"):
        stages.append(doing)
        yield lambda *_: None

    monkeypatch.setattr("hapjax.cli.benchmark.following", at)
    monkeypatch.setattr("hapjax.cli.recover.following", at)
    monkeypatch.setattr(scene, "report", lambda *_: None)
    hapjax.save_scene(hapjax.Scene({"table": hapjax.Object(hapjax.Plane())}), table)
    hapjax.Recording(hip=np.zeros((2, 1, 3)), hip_t=np.arange(2.0)).save(file)
    assert main(["benchmark", "scene", "--scene", table]) == main(["recover", file]) == 0
    assert stages == ["loading the library", "reading", "recovering"]


def test_a_loop_tells_of_every_tenth_of_a_second():
    told = []
    tick = each_tick(lambda *said: told.append(said), "holding", 100.0)
    assert not any(tick() for _ in range(29))
    assert told == [("holding", 0.1)] * 2


def test_json_has_null_for_what_is_no_number(tmp_path):
    write_json(tmp_path / "f.json", {"a": (np.nan, 1.0), "b": {"c": [np.inf, np.float64(2), 3]}})
    assert json.loads((tmp_path / "f.json").read_text()) == {"a": [None, 1.0], "b": {"c": [None, 2.0, 3]}}
