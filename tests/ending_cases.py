"""A servo loop in a process of its own, that is to be ended: python ending_cases.py LOG WAY.

Its device writes each force to the file LOG, a line each, and once it pushes says so on stdout; then WAY happens.
"""

import os
import signal
import sys
import time

import jax
import numpy as np

import hapjax
import hapjax_devices as devices

PUSHES = 20  # writes, after which it is in the middle of it


class Logged:
    """A finger deep in a wall."""

    force_limit, resolution = 8.0, 1e-5

    def __init__(self, file: str, way: str):
        self._file, self._way, self._writes = os.open(file, os.O_WRONLY | os.O_CREAT), way, 0

    def open(self): ...

    def read(self):
        return np.array([0.0, 0.0, -0.0025])

    def write(self, force):
        os.write(self._file, f"{float(force[2])!r}\n".encode())
        self._writes += 1
        if self._writes == PUSHES:
            happen(self._way)
        return force

    def close(self):
        os.write(self._file, b"closed\n")

    def __enter__(self):
        self.open()
        return self

    def __exit__(self, *exception):
        self.close()


def happen(way: str) -> None:
    """What ends the loop, in the middle of a write."""
    if way == "exception":
        raise FloatingPointError("the step broke")
    if way == "hang":
        os.kill(os.getpid(), signal.SIGTERM)
        print("hangs", flush=True)
        time.sleep(60)  # until somebody asks again
    if way == "stop":
        print("stops", flush=True)
        os.kill(os.getpid(), signal.SIGSTOP)
    if way.startswith("SIG"):
        os.kill(os.getpid(), getattr(signal, way))


def main(file: str, way: str) -> None:
    """Run until it is ended."""
    jax.config.update("jax_enable_x64", True)
    scene = hapjax.Scene({"wall": hapjax.Object(hapjax.Plane(), hapjax.Surface(800.0, mu=0.5))})
    seconds = 1.0 if way == "stop" else 60.0
    device, gentle = Logged(file, way), devices.Limits(ramp=0.01)
    devices.run(scene, [device], seconds, 500.0, realtime=way in ("stop", "hang"), limits=gentle)


if __name__ == "__main__":
    main(*sys.argv[1:])
