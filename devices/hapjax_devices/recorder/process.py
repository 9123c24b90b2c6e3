"""The recorder as a process: how it is started, what it says, how it is stopped."""

import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from hapjax import InputError

from .record import record

T = TypeVar("T")


class RecorderProcess:
    """A recorder in a process of its own, which the servo's end does not end, nor Ctrl-C: it writes what is left, and the
    file's end.

    **Arguments:** `run`, its name on the bus, which may be still to come for `patience` s; `path` of the new file; the
    number of the `process` whose run it is to be, `None`: of any.
    """

    def __init__(self, run: str, path: Path, patience: float = 20.0, process: int | None = None):
        command = [sys.executable, "-m", __package__, run, str(path), repr(patience)]
        command += [] if process is None else [str(process)]
        self._process = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
        )

    @property
    def pid(self) -> int:
        """The number of its process."""
        return self._process.pid

    def stop(self) -> None:
        """Ask it to write what there is, and to end."""
        self._process.terminate()

    def kill(self) -> None:
        """End it at once. Its file is left without an end; see `hapjax recover`."""
        self._process.kill()

    def is_alive(self) -> bool:
        """Whether its process goes on."""
        return self._process.poll() is None

    def end(self, patience: float) -> tuple[int, str]:
        """What `wait` returns, of a recorder that is asked to end after `patience` s, and killed after as many again."""
        for hurry in (self.stop, self.kill):
            try:
                return self.wait(patience)
            except subprocess.TimeoutExpired:
                hurry()
        return self.wait()

    def wait(self, timeout: float | None = None) -> tuple[int, str]:
        """Its exit code (0, or 1 where the file could not be written on, 2 for bad input) and what it said at its end.

        **Raises:** `subprocess.TimeoutExpired` where it goes on for longer than `timeout` s.
        """
        out, error = self._process.communicate(timeout=timeout)
        said = (error or out).strip().splitlines()
        return self._process.returncode, said[-1] if said else ""


def main(arguments: list[str]) -> int:
    """Record until the run ends or SIGTERM or Ctrl-C comes; returns the exit code."""
    if not 2 <= len(arguments) <= 4:
        print("usage: python -m hapjax_devices.recorder RUN FILE.mcap [PATIENCE [PROCESS]]", file=sys.stderr)
        return 2
    run, path, *more = arguments
    asked: list[int] = []

    def listen() -> None:
        for number in (signal.SIGTERM, signal.SIGINT):
            signal.signal(number, lambda *_: asked.append(1))

    try:
        # Before the run is there, there is nothing to be finished: such a signal then ends it at once.
        patience = _number(float, "patience", *more[:1]) if more else 20.0
        process = _number(int, "process", *more[1:]) if more[1:] else None
        print(record(run, Path(path), lambda: bool(asked), listen, patience, process))
    except KeyboardInterrupt:
        return 130
    except InputError as error:
        print(f"hapjax: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        reason = error.strerror or error
        print(
            f"hapjax: {error.filename}: the recording ends here ({reason}), the servo goes on; "
            "what was written before can be read, and hapjax recover makes it whole",
            file=sys.stderr,
        )
        return 1
    return 0


def _number(kind: Callable[[str], T], name: str, text: str) -> T:
    try:
        return kind(text)
    except ValueError:
        raise InputError(f"{name} is {text!r}; allowed: a number") from None
