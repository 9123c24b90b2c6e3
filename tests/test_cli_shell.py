"""The command line on a terminal and in a shell: its version, completion, colours, and the examples of its help."""

import json
import os
import pty
import re
import shlex
import signal
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path
from urllib.request import urlopen

import jax
import numpy as np
import pytest

import hapjax
from hapjax.cli import COMMANDS, main
from test_cli import example
from test_docs import block, section

HAPJAX = str(Path(sys.executable).parent / "hapjax")


def helped(command, capsys) -> str:
    """The help of a command, in lines as long as they like."""
    with pytest.raises(SystemExit) as ended:
        main([command, "--help"])
    assert ended.value.code == 0
    return " ".join(capsys.readouterr().out.replace("│", " ").split())


def test_it_says_its_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"hapjax {version('hapjax')}\n"
    with pytest.raises(SystemExit):
        main(["--help"])
    assert "hapjax --version" in " ".join(capsys.readouterr().out.split())


# Completion -----------------------------------------------------------------------------------------------


def completed(script, *words) -> list[str]:
    """What bash offers for the last word."""
    shell = f"""source {script}
        COMP_WORDS=({" ".join(map(shlex.quote, words))}); COMP_CWORD={len(words) - 1}; COMP_LINE="{" ".join(words)}"
        COMP_POINT=${{#COMP_LINE}}
        $(complete -p hapjax | sed 's/.*-F \\([^ ]*\\) .*/\\1/')
        printf '%s\\n' "${{COMPREPLY[@]}}" """
    command = ["bash", "-c", f"shopt -s expand_aliases; {shell}"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()


def test_bash_completes_commands_options_and_choices(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(["--print-completion", "bash"])
    script = tmp_path / "hapjax.bash"
    script.write_text(capsys.readouterr().out)
    assert set(completed(script, "hapjax", "d")) == {"demo", "devices", "doctor"}
    assert "--scene" in completed(script, "hapjax", "fit", "--sc")
    assert set(completed(script, "hapjax", "export", "a.toml", "--to", "")) == {"mjcf", "urdf"}


def test_zsh_has_a_script_and_other_shells_are_refused(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["--print-completion", "zsh"])
    assert not ended.value.code and "doctor" in capsys.readouterr().out
    for flag in ("--print-completion", "--tyro-print-completion"):
        assert main([flag, "fish"]) == 2
        assert capsys.readouterr().err == f"hapjax: {flag} is 'fish'; allowed: bash, zsh\n"


# Colours --------------------------------------------------------------------------------------------------

COLOUR = re.compile(r"\x1b\[[0-9;]*(?:3[0-9]|4[0-9]|9[0-9])[0-9;]*m")


def on_a_terminal(arguments, **environment) -> str:
    """What a program writes to a terminal."""
    primary, secondary = pty.openpty()
    kept = {key: value for key, value in os.environ.items() if key not in ("NO_COLOR", "FORCE_COLOR")}
    run = subprocess.Popen(arguments, stdout=secondary, stderr=secondary, env=kept | environment)
    os.close(secondary)
    said = b""
    while True:
        try:
            part = os.read(primary, 65536)
        except OSError:  # Linux's end of a terminal
            break
        if not part:
            break
        said += part
    os.close(primary)
    assert run.wait() == 0
    return said.decode()


@pytest.mark.slow
def test_colours_are_for_terminals_that_want_them():
    """Of tyro's help and of a table and a bar of rich."""
    program = (
        "import sys; from rich.console import Console; from hapjax.cli import main\n"
        "Console().print('[green]green[/]'); sys.argv = ['hapjax', 'fit', '--help']; main()"
    )
    command = [sys.executable, "-c", program]
    coloured = on_a_terminal(command, TERM="xterm-256color")
    assert COLOUR.search(coloured.partition("green")[0]) and "\x1b[" in coloured.partition("Example")[2]
    plain = on_a_terminal(command, TERM="xterm-256color", NO_COLOR="1")
    assert "Example" in plain and not COLOUR.search(plain) and "\x1b[" not in plain.partition("usage")[2]


def test_what_is_no_terminal_has_no_colours(capsys):
    assert "\x1b[" not in helped("fit", capsys)


# Examples -------------------------------------------------------------------------------------------------

# Tests of their own run what takes long.
ELSEWHERE = {
    "demo": "tests/test_cli.py",
    "simulate": "tests/test_docs.py",
    "fit": "tests/test_docs.py",
    "benchmark": "tests/test_cli.py",
}

QUICKER = {"doctor": ["--seconds", "0.1"]}
ENDLESS = "view"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A folder with the files that the examples name."""
    place = tmp_path_factory.mktemp("examples")
    (place / "cube.toml").write_text(block("scene_file.md", "toml"))
    hapjax.save_urdf(hapjax.load_scene(place / "cube.toml"), place / "cube.urdf")
    hip = np.zeros((20, 1, 3))
    hapjax.Recording(hip=hip, hip_t=np.arange(20) * 1e-3).save(place / "lift.mcap")
    return place


@pytest.mark.parametrize("command", COMMANDS)
def test_help_and_page_begin_with_one_example(command, capsys):
    told, first = (
        shlex.join(["hapjax", *example(command)]),
        re.findall(r"^hapjax .*", section(command), re.MULTILINE)[0],
    )
    assert told == first and f"Example: {told} " in helped(command, capsys)
    if command in ELSEWHERE:
        assert command in (Path(__file__).parents[1] / ELSEWHERE[command]).read_text()


@pytest.mark.slow
@pytest.mark.parametrize("command", [name for name in COMMANDS if name not in (*ELSEWHERE, ENDLESS)])
def test_the_example_works(command, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    arguments = example(command)
    before = set(folder.iterdir())
    assert main([*arguments, *QUICKER.get(command, [])]) == 0, capsys.readouterr().err
    options = dict(zip(arguments, arguments[1:], strict=False))
    for option in ("--out", "--json"):
        if option in options:
            assert (folder / options[option]).stat().st_size > 0
    written = {path.name for path in set(folder.iterdir()) - before}
    assert written == {options[o] for o in ("--out", "--json") if o in options}


def test_a_program_reads_what_files_were_made_into(folder, tmp_path, monkeypatch):
    monkeypatch.chdir(folder)
    found = {}
    for number, (command, *rest) in enumerate(
        (
            ("export", "cube.toml", "--to", "urdf", "--out", tmp_path / "cube.urdf"),
            ("import", "cube.urdf", "--out", tmp_path / "cube.toml"),
            ("recover", "lift.mcap", "--out", tmp_path / "whole.mcap"),
        )
    ):
        file = tmp_path / f"{number}.json"
        assert main([command, *map(str, rest), "--json", str(file)]) == 0
        found[command] = json.loads(file.read_text())
        assert found[command].pop("file") == str(rest[-1])
        for key in ("file", *found[command]):
            assert f"`{key}`" in section(command)
    with jax.enable_x64(True):
        scene = hapjax.load_scene("cube.toml")
    assert found["export"]["left_out"]
    assert found["export"] == {"left_out": [*hapjax.save_urdf(scene, tmp_path / "again.urdf")]}
    assert found["import"] == {"objects": {"cube": {"shape": "box", "mass": pytest.approx(0.2)}}}
    assert found["recover"] == {"messages": {"/hip": 20}, "lost": [], "whole": True}
    assert main(["export", "cube.toml", "--to", "urdf", "--json", "nowhere/a.json"]) == 2
    assert not (folder / "nowhere").exists()


@pytest.mark.parametrize("words", [["--json", "-"], ["--json=-"]], ids=" ".join)
def test_figures_go_to_standard_output_and_all_else_to_stderr(words, folder, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    scene, out = str(folder / "cube.toml"), str(tmp_path / "cube.urdf")
    assert main(["export", scene, "--to", "urdf", "--out", out, *words]) == 0
    said = capsys.readouterr()
    figures = json.loads(said.out)
    assert figures["file"] == out
    assert said.err.splitlines() == [*(f"hapjax: {scene}: {s}" for s in figures["left_out"]), out]
    assert [path.name for path in tmp_path.iterdir()] == ["cube.urdf"]


@pytest.mark.parametrize("through_a_link", [False, True])
def test_what_is_open_is_no_place_for_figures(through_a_link, folder, tmp_path, capsys):
    """The file that a shell opened for `>>` has lines that are to stay."""
    kept, link = tmp_path / "kept.txt", tmp_path / "figures.json"
    kept.write_text("earlier\n")
    with kept.open("a") as shell:
        place = f"/dev/fd/{shell.fileno()}"
        link.symlink_to(place)
        named = str(link) if through_a_link else place
        out = tmp_path / "cube.urdf"
        export = ["export", str(folder / "cube.toml"), "--to", "urdf", "--out", str(out)]
        assert main([*export, "--json", named]) == 2
    assert kept.read_text() == "earlier\n" and not out.exists()
    said = capsys.readouterr()
    assert said.out == "" and f"{named}: cannot be written" in said.err and "--json -" in said.err


@pytest.mark.slow
def test_the_example_without_an_end_works_until_it_is_ended(folder):
    pytest.importorskip("viser", reason="the viewer needs the extra viewer")
    command = [HAPJAX, *example(ENDLESS), "--scene", "cube.toml", "--port", "0"]
    with subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        try:
            said = process.stdout.readline()
            address = re.search(r"http://127\.0\.0\.1:\d+", said)
            assert address, said
            with urlopen(address[0]) as page:
                assert page.status == 200 and b"viser" in page.read().lower()
            process.send_signal(signal.SIGINT)
            assert process.wait(20) == 0
        finally:
            process.kill()
