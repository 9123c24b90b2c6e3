"""The viewer as a process: how it is started, and how it is stopped."""

import os
import signal
import socket
import subprocess
import sys
from contextlib import suppress
from importlib.util import find_spec

from hapjax import InputError
from hapjax.extras import need

from ..bus import NotBegun

_NICE = 5  # the servo and the recorder come first


class ViewerProcess:
    """A viewer of a run in a process of its own, which the servo does not wait for. It says on stdout where its page is.

    It ends when the run does, when it is asked to, and when the process that started it is no more.

    **Arguments:** `run`, its name on the bus, which may be still to come for `patience` s; `host` and `port` of the page;
    the number of the `process` whose run it is to be, `None`: of any.
    """

    def __init__(self, run: str, host: str, port: int, patience: float = 20.0, process: int | None = None):
        command = [sys.executable, "-m", __package__, run, host, str(port), repr(patience)]
        command += [str(os.getpid()), *([] if process is None else [str(process)])]
        self._process = subprocess.Popen(command, start_new_session=True)

    @property
    def pid(self) -> int:
        """The number of its process."""
        return self._process.pid

    def code(self) -> int | None:
        """Its exit code, below 0 where a signal killed it, `None` while it goes on."""
        return self._process.poll()

    def end(self, patience: float) -> int:
        """Ask it to end, kill it after `patience` s; its exit code."""
        self._process.terminate()
        try:
            return self._process.wait(patience)
        except subprocess.TimeoutExpired:
            self._process.kill()
            return self._process.wait()


def check(host: str, port: int) -> None:
    """Refuse a viewer without its library, and an address that cannot be listened at: viser would take another port, or wait
    for ever. **Raises:** `InputError`."""
    if find_spec("viser") is None:
        need("viser", "viewer")
    if not 0 <= port <= 65535:
        raise InputError(f"port is {port}; allowed: 0 (any that is free) to 65535")
    if not host:  # to a socket these are all addresses
        raise InputError("host is ''; allowed: an address of this computer, 0.0.0.0: all that it has")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        socket.create_server((host, port), family=family).close()
    except OSError as error:
        raise InputError(
            f"{host}:{port} cannot be listened at ({error.strerror or error}); allowed: an address of this computer "
            "and a free port, 0: any"
        ) from None


def main(arguments: list[str]) -> int:
    """Show a run until it ends or SIGTERM or Ctrl-C comes; returns the exit code: 0, or 2 for bad input."""
    if not 3 <= len(arguments) <= 6:
        print(
            "usage: python -m hapjax_devices.viewer RUN HOST PORT [PATIENCE [PARENT [PROCESS]]]",
            file=sys.stderr,
        )
        return 2
    asked = stop_asked()
    with suppress(OSError):
        os.nice(_NICE)
    run, host, port, *more = arguments
    # Who started it says which number it has: it may have ended while this was imported.
    parent = int(more[1]) if more[1:] else os.getppid()
    process = int(more[2]) if more[2:] else None

    def over() -> bool:
        return bool(asked) or os.getppid() != parent

    try:
        watch = need("hapjax_devices.viewer.live", "viewer").watch
        watch(run, host, int(port), float(*more[:1] or [20.0]), over, process)
    except NotBegun:
        return 0  # why is for its process to say
    except InputError as error:
        print(f"hapjax: {error}", file=sys.stderr)
        return 2
    return 0


def stop_asked() -> list[int]:
    """A list that gets the number of each signal that asks for the end from now on."""
    asked: list[int] = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda n, _: asked.append(n))
    return asked
