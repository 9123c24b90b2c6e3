"""The command `hapjax`: what there is of it before the library, which takes a second or two to import."""

import os
import signal
import sys
from typing import NoReturn


def run() -> NoReturn:
    """Import the command line, run it, and end with its exit code.

    Ctrl-C that comes while it imports would come out as whatever the library in the middle of it makes of that, or be
    lost in one of its callbacks. So it ends the process at once. Of `hapjax run`, which compiles too, it does until the
    session takes the signals, since nothing has begun; other commands have files to put away, and get `KeyboardInterrupt`.
    """
    _open_what_is_closed()
    listens = signal.getsignal(signal.SIGINT) is signal.default_int_handler  # else a shell said not to
    if listens:
        signal.signal(signal.SIGINT, _end)
    from hapjax.cli import main

    if listens and sys.argv[1:2] != ["run"]:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    code = main()
    if code == 130:
        # What compiled code does when it is interrupted goes on in threads of its own, and would fail in the middle of
        # taking everything down.
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


def _end(number: int, frame: object) -> NoReturn:
    os.write(2, b"hapjax: interrupted\n")
    os._exit(130)


def _open_what_is_closed() -> None:
    """Have stdin, stdout and stderr lead nowhere where they were closed: files that are opened would take their place."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode))
            os.set_inheritable(getattr(sys, name).fileno(), True)
