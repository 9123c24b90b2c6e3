"""The servo as a process: how it is started, what it says, how it is stopped."""

import json
import os
import signal
import subprocess
import sys
from contextlib import suppress

import numpy as np

from hapjax import InputError

from ..bus import Broadcast
from ..device import DeviceError
from ..ending import ENDING
from ..passivity import Passivity
from ..servo import run
from .parent import end_with
from .settings import Session

PATIENCE = 60.0  # s that is waited for the processes that listen: they import and compile


class ServoProcess:
    """The servo of a session in a process of its own, which Ctrl-C in a terminal does not reach.

    It ends when the session's time is over, when it is asked to, and when the process that started it is no more.

    **Arguments:** `session`, what it is to do. What it has to say to the user it says on stderr.
    """

    def __init__(self, session: Session):
        command = [sys.executable, "-m", __package__, session.to_json(), str(os.getpid())]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, start_new_session=True)

    @property
    def pid(self) -> int:
        """The number of its process."""
        return self._process.pid

    def code(self) -> int | None:
        """Its exit code, below 0 where a signal killed it, `None` while it goes on."""
        return self._process.poll()

    def stop(self) -> None:
        """Ask it to let go of the devices and to end."""
        self._process.terminate()

    def wait(self, timeout: float) -> tuple[int, tuple[str, ...]]:
        """Its exit code, and a sentence for each privilege that it had to do without. After `timeout` s it is killed."""
        try:
            out, _ = self._process.communicate(timeout=timeout)
        except subprocess.TimeoutExpired:
            self._process.kill()
            out, _ = self._process.communicate()
        return self._process.returncode, tuple(json.loads(out)["refused"]) if out.strip() else ()


class _Asked:
    """Whether a signal has asked the loop to end. Before it has begun, the first one ends the process, and others leave it
    at that: the kernel may tell of a parent's end twice."""

    def __init__(self, ticks: float):
        self._left = ticks
        self._began = self._asked = False
        for number in ENDING:
            signal.signal(number, self._ask)

    def __call__(self) -> bool:
        """Whether the tick that is done was the last."""
        self._began = True
        self._left -= 1
        return self._asked or self._left <= 0

    def _ask(self, number: int, frame: object) -> None:
        first, self._asked = not self._asked, True
        if first and not self._began:
            raise SystemExit(128 + number)


def main(arguments: list[str]) -> int:
    """Run a session's servo; returns the exit code: 0, 1 where a device failed, 2 for bad input."""
    if len(arguments) != 2:
        print("usage: python -m hapjax_devices.session JSON PARENT, as hapjax run starts it", file=sys.stderr)
        return 2
    said, parent = arguments
    end_with(int(parent))
    try:
        session = Session.from_json(said)
        ticks = np.inf if session.seconds is None else float(round(session.seconds * session.rate))
        result = run(
            session.loaded,
            session.made(),
            None,
            session.rate,
            limits=session.limits(),
            passivity=None if session.passivity is None else Passivity(session.passivity),
            broadcast=Broadcast(session.run, session.readers, PATIENCE),
            stopped=_Asked(ticks),
            live=session.live,
        )
    except (InputError, DeviceError) as error:
        print(f"hapjax: {error}", file=sys.stderr)
        return 2 if isinstance(error, InputError) else 1
    with suppress(BrokenPipeError):  # who started it is no more
        os.write(sys.stdout.fileno(), json.dumps({"refused": result.refused}).encode())
    return 0
