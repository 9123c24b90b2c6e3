"""The program: which commands there are, how bad arguments are refused, and exit codes."""

import os
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from importlib.metadata import version
from itertools import pairwise
from pathlib import Path
from typing import Any

import tyro
from tyro import _errors as parse_errors

from ..errors import InputError
from .benchmark import benchmark
from .demo import demo
from .devices import devices
from .doctor import doctor
from .export import export
from .fit import fit
from .import_model import import_model
from .recover import recover
from .run import run as run_session
from .simulate import simulate
from .view import view

_SHELLS = ("bash", "zsh")
_OURS = {"--print-completion": "--tyro-print-completion", "--write-completion": "--tyro-write-completion"}
_ABOUT = """Touch, hold and identify virtual objects: friction, stiffness, torsional grip, inertia.

hapjax --version says which it is, hapjax --print-completion bash (or zsh) what completes its words in a shell."""
COMMANDS = {
    "demo": demo,
    "run": run_session,
    "simulate": simulate,
    "fit": fit,
    "view": view,
    "benchmark": benchmark,
    "export": export,
    "import": import_model,
    "recover": recover,
    "devices": devices,
    "doctor": doctor,
}


def main(arguments: list[str] | None = None) -> int:
    """Run the command line. Bad input ends with one sentence on stderr and the exit code 2.

    1: the system failed (a full disk, say), or the demo missed a truth; 130: interrupted.
    """
    try:
        return _run(sys.argv[1:] if arguments is None else arguments) or 0
    except InputError as error:
        return _say(str(error), 2)
    except KeyboardInterrupt:
        return _say("interrupted", 130)
    except OSError as error:
        return _say(f"{error.filename or 'output'}: {error.strerror or error}", 1)


def _run(arguments: list[str]) -> int | None:
    if arguments == ["--version"]:
        print(f"hapjax {version('hapjax')}")
        return 0
    _check_completion(arguments)
    _check_once(arguments)
    if os.environ.get("NO_COLOR"):  # rich heeds it, tyro does not
        tyro._experimental_options["ansi_codes"] = False
    with parse_errors.on_parse_error(_refuse), _figures_on_stdout(arguments) as words:
        result = tyro.extras.subcommand_cli_from_dict(
            COMMANDS,
            prog="hapjax",
            description=_ABOUT,
            args=[_OURS.get(word, word) for word in words],
        )
    sys.stdout.flush()
    return result


@contextmanager
def _figures_on_stdout(arguments: list[str]) -> Iterator[list[str]]:
    """The arguments, with a file for the `-` of `--json -`, which is printed at the end; all other words go to stderr."""
    words = [
        w for argument in arguments for w in (argument.split("=") if argument == "--json=-" else [argument])
    ]
    place = next((i for i, two in enumerate(pairwise(words)) if two == ("--json", "-")), None)
    if place is None:
        yield words
        return
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "figures.json"
        try:
            with redirect_stdout(sys.stderr):
                yield [*words[: place + 1], str(file), *words[place + 2 :]]
        finally:  # also of a command that is refused or interrupted once it has figures
            if file.exists():
                sys.stdout.write(file.read_text())
                sys.stdout.flush()


def _say(sentence: str, code: int) -> int:
    # A file's own words may hold what steers a terminal.
    plain = "".join(c if c.isprintable() else "?" for c in " ".join(sentence.split()))
    print(f"hapjax: {plain}", file=sys.stderr)
    return code


def _check_once(arguments: list[str]) -> None:
    """Refuse an option that is given twice: of all but the last nothing would be left."""
    options = [a.split("=")[0].replace("_", "-") for a in arguments if a.startswith("--")]
    for option, times in Counter(options).items():
        if times > 1:
            raise InputError(
                f"{option} is given {times} times; allowed: once, with all of its values after it"
            )


def _check_completion(arguments: list[str]) -> None:
    """Refuse shells that tyro has no completion for by itself; it would end in a traceback."""
    for flag, shell in pairwise([*arguments, ""]):
        if flag in (*_OURS, *_OURS.values()) and shell not in _SHELLS:
            raise InputError(f"{flag} is {shell!r}; allowed: {', '.join(_SHELLS)}")


def _refuse(event: parse_errors.ParseErrorEvent) -> None:
    """Say in one sentence why the arguments are refused, in place of tyro's box of many lines."""
    raise InputError(f"{_reason(event)}; see {event.prog} --help")


def _reason(event: parse_errors.ParseErrorEvent) -> str:
    match event:
        case parse_errors.MissingArgs(missing_arguments=missing):
            return f"missing: {', '.join(_flag(m.arg) for m in missing)}"
        case parse_errors.MissingSubcommand(found_token=found):
            return f"{'no command' if found is None else repr(found)} given; allowed: {', '.join(COMMANDS)}"
        case parse_errors.InvalidChoice(argument=argument, value=value, choices=choices):
            return f"{_flag(argument)} is {value!r}; allowed: {', '.join(choices)}"
        case parse_errors.UnrecognizedArgs(tokens=tokens):
            return f"unknown: {' '.join(tokens)}"
        case parse_errors.BadValue(argument=argument, offending_value=value):
            return f"{_flag(argument)} has " + (
                "too few values" if value is None else f"the value {value!r} too many"
            )
        case parse_errors.InstantiationFailure(argument=argument, message=message):
            return f"{'arguments' if argument is None else _flag(argument)}: {' '.join(message.split())}"
    return "the arguments are not understood"


def _flag(argument: Any) -> str:
    return str(argument.lowered.metavar) if argument.is_positional() else argument.lowered.name_or_flags[-1]
