"""The process that estimates numbers meanwhile: how it is started, asked, heard and ended."""

import json
import os
import subprocess
import sys
from contextlib import suppress
from typing import Any

from hapjax.tuning.settings import Tuning


class TunerProcess:
    """`python -m hapjax.tuning`, which Ctrl-C in a terminal does not reach.

    **Arguments:** `tuning`, what it is to do; the number of the `process` whose run it is of.
    """

    def __init__(self, tuning: Tuning, process: int):
        command = [sys.executable, "-m", "hapjax.tuning", tuning.to_json(), str(process)]
        self._process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, start_new_session=True
        )
        assert self._process.stdout is not None and self._process.stdin is not None
        self._out, self._in, self._begun = self._process.stdout.fileno(), self._process.stdin.fileno(), b""
        os.set_blocking(self._out, False)

    def code(self) -> int | None:
        """Its exit code, below 0 where a signal killed it, `None` while it goes on."""
        return self._process.poll()

    def adopt(self) -> None:
        """Ask it to hand its newest estimates to the servo."""
        with suppress(BrokenPipeError):  # it has ended, and that is said
            os.write(self._in, b"\n")

    def said(self) -> list[dict[str, Any]]:
        """What it has found, or handed over, since the last time."""
        with suppress(BlockingIOError):
            while more := os.read(self._out, 65536):
                self._begun += more
        *lines, self._begun = self._begun.split(b"\n")
        return [json.loads(line) for line in lines]

    def end(self) -> None:
        """End it: there is nothing that it would have to finish."""
        self._process.kill()
        self._process.communicate()
