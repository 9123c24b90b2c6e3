"""The command before the library is there: Ctrl-C while it is imported, and files that are closed."""

import subprocess
import sys

import pytest

import hapjax_command

LIBRARY = "import signal\n"
LOST = "try:\n    signal.raise_signal(signal.SIGINT)\nexcept BaseException:\n    pass\n"  # as in a callback
MAIN = """
def main():
    try:
        signal.raise_signal(signal.SIGINT)
    except KeyboardInterrupt:
        print("puts its files away")
        return 130
    return 0
"""
PRINTS = """
def main():
    import os, subprocess, sys
    print("nowhere", sys.stdout.isatty(), flush=True)
    with open(sys.argv[1], "w") as file:
        subprocess.run(["sh", "-c", "echo said; echo said >&2; cat"], check=True)
        print(file.fileno(), file=file)
    return 0
"""
PROGRAM = """if True:
    import signal, sys
    signal.signal(signal.SIGINT, signal.default_int_handler)
    sys.path[:0] = [{library!r}, {folder!r}]
    import hapjax_command
    hapjax_command.run()
"""


@pytest.fixture
def program(tmp_path):
    """Runs the command with a library of one's own."""
    (tmp_path / "hapjax").mkdir()
    folder = hapjax_command.__file__.removesuffix("/hapjax_command.py")
    code = PROGRAM.format(library=str(tmp_path), folder=folder)

    def run(library, *arguments, before=""):
        (tmp_path / "hapjax" / "__init__.py").touch()
        (tmp_path / "hapjax" / "cli.py").write_text(LIBRARY + library)
        command = ["sh", "-c", f'exec "$@" {before}', "sh", sys.executable, "-I", "-c", code, *arguments]
        return subprocess.run(command, capture_output=True, text=True, timeout=60)

    return run


@pytest.mark.parametrize("command", ["run", "fit"])
def test_an_interrupt_while_it_imports_ends_it_with_a_sentence(program, command):
    ended = program(LOST + "main = lambda: 0\n", command)
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "hapjax: interrupted\n")


def test_a_session_is_ended_at_once_until_it_listens_and_what_has_files_puts_them_away(program):
    ended = program(MAIN, "run")
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "", "hapjax: interrupted\n")
    ended = program(MAIN, "fit")
    assert (ended.returncode, ended.stdout, ended.stderr) == (130, "puts its files away\n", "")


@pytest.mark.parametrize("closed", [">&-", "<&- >&- 2>&-", "2>&-"])
def test_files_that_are_closed_lead_nowhere_and_nothing_gets_in_their_place(program, tmp_path, closed):
    ended = program(PRINTS, str(tmp_path / "file"), before=closed)
    assert ended.returncode == 0, ended.stderr
    assert (tmp_path / "file").read_text() == "3\n"
    assert ended.stdout == ("" if ">&-" in closed.split() else "nowhere False\nsaid\n")
    assert ended.stderr == ("" if "2>&-" in closed else "said\n")
