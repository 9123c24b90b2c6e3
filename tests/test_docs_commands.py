"""Every command in README and docs is one that the program takes; every program is whole, and what it imports exists."""

import ast
import importlib
import re
import shlex
import tomllib
from functools import wraps
from pathlib import Path

import pytest

from hapjax.cli import _program

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


def blocks(language):
    """The blocks of code in a language of all pages, each as (page, text)."""
    for page in PAGES:
        for text in re.findall(rf"^```{language}\n(.*?)^```$", page.read_text(), re.DOTALL | re.MULTILINE):
            yield page.name, text


def lines():
    """The lines of the shell, each as (page, words)."""
    for page, text in blocks("sh"):
        for line in text.replace("\\\n", " ").splitlines():
            if line.startswith("fit="):  # kept for the lines below it
                line = line.removeprefix("fit=").strip('"')
            yield page, shlex.split(line, comments=True)


def programs(name):
    """What comes after a program's name, of every line in which it is called."""
    return [(page, words[words.index(name) + 1 :]) for page, words in lines() if name in words]


@pytest.fixture
def asked(monkeypatch):
    """The commands that were called, by their names; nothing of them is done."""
    called = []

    def instead(name, command):
        @wraps(command)
        def note(*arguments, **options):
            called.append(name)

        return note

    told = {name: instead(name, command) for name, command in _program.COMMANDS.items()}
    monkeypatch.setattr(_program, "COMMANDS", told)
    return called


def test_every_line_with_hapjax_is_taken_by_the_program(asked, capsys):
    given = [(page, words) for page, words in programs("hapjax") if "..." not in words]
    assert len(given) > 40
    for page, words in given:
        words = [word for word in words if word != "&"]
        assert _program.main(words) == 0, (page, words, capsys.readouterr().err)
    assert asked == [words[0] for _, words in given]
    assert set(asked) == set(_program.COMMANDS)


def test_what_is_to_be_installed_made_and_run_is_there():
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    named = {
        extra
        for page in PAGES
        for group in re.findall(r"(?:'\.|hapjax)\[([\w,]+)\]'", page.read_text())
        for extra in group.split(",")
    }
    assert named and named <= set(extras)
    targets = re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(), re.MULTILINE)
    made, scripts = [w[0] for _, w in programs("make")], [w[0] for _, w in programs("python")]
    assert made and set(made) <= set(targets)
    assert scripts and all((ROOT / script).is_file() for script in scripts if script.startswith("examples/"))


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
