"""Every command in README and docs gets as far as where its work begins; every program is whole, and what it imports exists.

Until there a command has read its arguments and the files that the page names, and has refused what cannot be.
"""

import ast
import importlib
import re
import shlex
import tomllib
from pathlib import Path

import jax
import numpy as np
import pytest

import hapjax
from hapjax.cli import COMMANDS, main
from hapjax_devices import demo
from test_docs import block
from test_guides import FOLLOWED
from test_recording_mcap import bag

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]

# Where the work of a command begins, once all is checked; those that are not here are quick, and done.
WORK = {
    "demo": ("hapjax.demo", "_record"),
    "run": ("hapjax_devices.session.supervisor", "_Watch"),
    "simulate": ("hapjax.cli.simulate", "_answers"),
    "fit": ("hapjax_fitting.fit", "searched"),
    "view": ("hapjax_devices.viewer.replay", "attached_scene"),
    "doctor": ("hapjax_devices.doctor.examine", "_examined"),
    "benchmark latency": ("hapjax.benchmark.latency", "pack"),
    "benchmark scene": ("hapjax.benchmark.scene", "_cost"),
    "benchmark stability": ("hapjax.benchmark.stability", "measure"),
    "benchmark error": ("hapjax.benchmark.error", "measure"),
    "benchmark gradient": ("hapjax.benchmark.gradient", "side_by_side"),
    "benchmark batch": ("hapjax.benchmark.batch", "measure"),
    "benchmark fit": ("hapjax_fitting.benchmark.efficiency", "measure"),
    "planar_push": ("planar_push", "fit_all"),
    "cube_toss": ("cube_toss", "read"),
    "dry_friction": ("dry_friction", "read"),
}
LEFT_OPEN = [
    "cube.toml",
    "--free",
    "object.cube.body.mass",
]  # of `--scene ...`, which a page leaves to its reader


class Begun(Exception):
    """The work of a command has begun."""


def blocks(language):
    """The blocks of code in a language of all pages, each as (page, text)."""
    for page in PAGES:
        for text in re.findall(rf"^```{language}\n(.*?)^```$", page.read_text(), re.DOTALL | re.MULTILINE):
            yield page.relative_to(ROOT).as_posix(), text


def lines():
    """The lines of the shell, each as (page, words)."""
    for page, text in blocks("sh"):
        kept = re.search(r'^fit="(.*)"$', text, re.MULTILINE)  # for the lines below it
        for line in text.replace("\\\n", " ").splitlines():
            words = shlex.split(line.replace("$fit", kept[1] if kept else "$fit"), comments=True)
            yield page, [word for word in words if word != "&"]


def programs(name):
    """What comes after a program's name, of every line in which it is called."""
    return [(page, words[words.index(name) + 1 :]) for page, words in lines() if name in words]


def expanded(words):
    """As a shell has them, with an answer to what is left open."""
    for word in words:
        if word == "...":
            yield from LEFT_OPEN
        else:
            yield from sorted(map(str, Path().glob(word))) if "*" in word else [word]


@pytest.fixture
def works(monkeypatch):
    """No command does its work: it tells that it has begun."""

    def begun(*_, **__):
        raise Begun

    for module, name in WORK.values():
        monkeypatch.setattr(importlib.import_module(module), name, begun)
    for name in ("initialize", "shutdown"):  # there is no other process to meet
        monkeypatch.setattr(jax.distributed, name, lambda *_: None)


def felt(file, fingers, moves):
    """A recording of fingers, and of the pose of a cube where it moves."""
    t, noise = 1e-3 * np.arange(60), np.random.default_rng(0)
    hip = noise.normal(0, 1e-3, (60, fingers, 3)) + [[0.03 * i, 0, -1e-3] for i in range(fingers)]
    channels = {"hip": hip, "hip_t": t, "force": noise.normal(0, 0.1, hip.shape), "force_t": t}
    if moves:
        pose = noise.normal(0, 1e-4, (60, 7)) + [0, 0, 0.03, 1, 0, 0, 0]
        pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
        channels |= {"pose": pose, "pose_t": t}
    hapjax.Recording(**channels).save(file)


@pytest.fixture
def named(tmp_path, monkeypatch):
    """In the present folder all files that pages name: the one they show, those of the demo, those of a reader."""
    monkeypatch.chdir(tmp_path)
    for folder in ("hapjax-demo", "recordings"):
        Path(folder).mkdir()
    for name in ("cube.toml", "guess.toml"):
        Path(name).write_text(block("scene_file.md", "toml"))
    hapjax.save_urdf(hapjax.load_scene("cube.toml"), "cube.urdf")
    hapjax.save_scene(demo.scene(), "hapjax-demo/fitted.toml")
    for task, fingers in ((demo.three_finger_lift, 3), (demo.two_finger_swing, 2)):
        felt(f"hapjax-demo/{task.__name__}.npz", fingers, moves=True)
    for file in ("lift.npz", "lift.mcap"):
        felt(file, 3, moves=True)
    floor = hapjax.Object(hapjax.Plane(), hapjax.Surface(800.0, mu=0.6))
    hapjax.save_scene(hapjax.Scene({"floor": floor}), "floor.toml")
    for file in ("push", "a", "b", "c", "recordings/1", "recordings/2"):
        felt(f"{file}.npz", 1, moves=False)
    read = hapjax.load_recording("hapjax-demo/two_finger_swing.npz")
    assert read.hip is not None and read.force is not None and read.pose is not None
    stamps, topics = 10**9 + 10**6 * np.arange(60), {"/cube": ("PoseStamped", read.pose[:, 0])}
    for i, side in enumerate(("left", "right")):
        topics |= {f"/{side}/tip": ("PointStamped", read.hip[:, i])}
        topics |= {f"/{side}/sensor": ("WrenchStamped", read.force[:, i])}
    bag("bag_0.mcap", {topic: (kind, stamps, numbers) for topic, (kind, numbers) in topics.items()})


def begins(call, words):
    """Whether a command gets as far as its work: it ends there, or it is done with the exit code 0."""
    try:
        return call(words) == 0 and "done"
    except Begun:
        return "begun"
    except SystemExit:
        return False


@pytest.mark.slow
def test_every_line_with_hapjax_gets_as_far_as_its_work(works, named, capsys):
    given = {tuple(expanded(words)): page for page, words in programs("hapjax") if page not in FOLLOWED}
    assert len(given) > 30
    for words, page in given.items():
        recorded = [words[i + 1] for i, word in enumerate(words) if word == "--record"]
        for file in recorded:
            Path(file).unlink()  # it is to be a new one
        kind = " ".join(words[: 1 + (words[0] == "benchmark")])
        assert begins(main, list(words)) == ("begun" if kind in WORK else "done"), (
            page,
            words,
            capsys.readouterr(),
        )
        for file in recorded:
            felt(file, 3, moves=True)  # for the lines below
    assert {words[0] for words in given} == set(COMMANDS)


def test_every_line_with_an_example_gets_as_far_as_its_work(works, capsys):
    given = [(page, words) for page, words in programs("python") if words[0].startswith("examples/")]
    assert len(given) > 4
    for page, (script, *words) in given:
        assert (ROOT / script).is_file(), (page, script)
        if (name := Path(script).stem) in WORK:
            assert begins(importlib.import_module(name).main, words) == "begun", (
                page,
                words,
                capsys.readouterr(),
            )
    assert {Path(words[0]).stem for _, words in given} <= {*WORK, "gravity_drop"}  # test_examples.py runs it


def test_what_is_to_be_installed_and_made_is_there():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    named = {
        extra
        for page in PAGES
        for group in re.findall(r"(?:'\.|hapjax)\[([\w,]+)\]'", page.read_text())
        for extra in group.split(",")
    }
    assert named and named <= set(extras)
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    made = [words[0] for _, words in programs("make")]
    assert made and set(made) <= set(targets)


def test_programs_in_python_are_whole_and_import_what_exists():
    shown = list(blocks("python"))
    assert len(shown) > 10
    for page, text in shown:
        for node in ast.walk(ast.parse(text, page)):
            if isinstance(node, ast.ImportFrom):
                module = importlib.import_module(node.module or "")
                for name in node.names:
                    if not hasattr(module, name.name):
                        importlib.import_module(f"{node.module}.{name.name}")
            elif (
                isinstance(node, ast.Attribute)
                and isinstance(node.value, ast.Name)
                and node.value.id == "hapjax"
            ):
                assert hasattr(importlib.import_module("hapjax"), node.attr), (page, node.attr)
