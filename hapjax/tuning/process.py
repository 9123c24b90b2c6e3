"""The process that estimates numbers of a scene while it is felt, and hands them to the servo."""

import json
import os
import select
import sys
import threading
import time
from contextlib import suppress
from typing import Any

import jax
import numpy as np

from ..errors import InputError
from ..extras import need
from ..paths import with_numbers
from ..scene_file import load_scene
from .sensor import CHUNK, SimulatedSensor
from .settings import Tuning, said
from .window import Window

PERIOD = 0.02  # s between two looks at the bus
_AGAIN = 0.25  # s between two looks for a new window
STARTS = 2  # of a fit; the first is what the servo has
_NICE = 10  # the servo and the recorder come first


class _Listener:
    """Takes the ticks of a run, while a fit takes its time, and gives them away in chunks.

    **Attributes:** `about` the run.
    """

    def __init__(self, run: str, process: int):
        self._reader = need("hapjax_devices", "devices").TickReader(run, 600.0, process=process)
        self.about = self._reader.about
        self._waiting, self._lock, self._over = np.zeros(0, self.about.tick), threading.Lock(), False
        threading.Thread(target=self._listen, daemon=True).start()

    @property
    def over(self) -> bool:
        """Whether the run has ended."""
        return self._over

    def chunk(self) -> np.ndarray | None:
        """The next CHUNK ticks, `None` where there are not so many yet."""
        with self._lock:
            if len(self._waiting) < CHUNK:
                return None
            taken, self._waiting = self._waiting[:CHUNK], self._waiting[CHUNK:]
        return taken

    def _listen(self) -> None:
        while self._reader.is_alive():
            ticks = self._reader.take()
            with self._lock:
                self._waiting = np.concatenate([self._waiting, ticks])
            time.sleep(PERIOD)
        self._over = True


class Tuner:
    """Fits the live numbers of a run to what the sensors measured in its last seconds.

    **Arguments:** `tuning`, what is asked for; `numbers`, the run's live numbers; `rate` of the run, Hz.

    **Attributes:** `estimates`, the newest that may be handed over, by path: empty where there are none.
    """

    def __init__(self, tuning: Tuning, numbers: Any, rate: float):
        self._numbers, self._scene = numbers, load_scene(tuning.scene)
        self._sensor = SimulatedSensor(load_scene(tuning.truth), rate)
        self._window = Window(tuning.window, rate, 10 * self._sensor.noise)
        self.estimates: dict[str, float] = {}

    def take(self, ticks: np.ndarray) -> None:
        """Measure what CHUNK ticks were."""
        self._window.add(ticks, self._sensor.measure(ticks["hip"], ticks["gimbal"]))

    @property
    def lacks(self) -> str:
        """Why there is nothing that could be estimated, in words, where that has been so for long."""
        return self._window.lacks

    def estimate(self) -> dict[str, Any] | None:
        """What a fit to the newest window finds, for the user and for a file; `None` where there is no new window."""
        recording = self._window.cut()
        if recording is None:
            return None
        assert recording.hip_t is not None
        now = self._numbers.now()
        result = need("hapjax_fitting", "fitting").fit(
            with_numbers(self._scene, now), recording, [*now], starts=STARTS
        )
        found = {name: each for name, each in result.parameters.items() if each.identified}
        self.estimates = (
            {name: float(each.estimate) for name, each in found.items()} if result.converged else {}
        )
        shown = {
            name: (float(each.estimate), [*map(float, each.interval95)]) if name in found else None
            for name, each in result.parameters.items()
        }
        why = "" if result.converged else f"; not converged: {result.reason}"
        times = [float(recording.hip_t[0]), float(recording.hip_t[-1])]
        return {
            "from_s": times[0],
            "until_s": times[1],
            "converged": bool(result.converged),
            "parameters": {
                name: None if each is None else {"estimate": each[0], "interval95": each[1]}
                for name, each in shown.items()
            },
            "sentence": f"{times[0]:.1f} to {times[1]:.1f} s: {said(shown)}{why}",
        }

    def adopt(self) -> dict[str, Any]:
        """Hand the newest estimates to the servo; how that went, in words."""
        if not self.estimates:
            return {"adopted": None, "sentence": "there is no estimate to be handed over yet"}
        try:
            tick = self._numbers.set(values_of(self.estimates, self._numbers.now()))
        except InputError as error:
            return {"adopted": None, "sentence": f"not handed over: {error}"}
        self.estimates = {}
        return {"adopted": tick, "sentence": f"handed over: they count from tick {tick} on"}


def values_of(estimates: dict[str, float], now: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The numbers of each path, with estimates in the place of those that are named, as `path` or `path[3]`."""
    values = {path: np.array(number, np.float64) for path, number in now.items()}
    for name, estimate in estimates.items():
        path, _, index = name.rstrip("]").partition("[")
        values[path][int(index) if index else ()] = estimate
    return values


def main(arguments: list[str]) -> int:
    """Estimate until the run ends; say what is found as lines of JSON; hand over when a line comes in.

    Returns the exit code: 0, or 2 for bad input.
    """
    if len(arguments) != 2:
        print("usage: python -m hapjax.tuning JSON PROCESS, as hapjax run --tune starts it", file=sys.stderr)
        return 2
    with suppress(OSError):
        os.nice(_NICE)
    devices, process = need("hapjax_devices", "devices"), int(arguments[1])
    try:
        tuning = Tuning(**json.loads(arguments[0]))
        need("hapjax_fitting", "fitting")
        with jax.enable_x64(True):
            listener = _Listener(tuning.run, process)
            with devices.Numbers(tuning.run, 600.0, process) as numbers:
                tuner = Tuner(tuning, numbers, listener.about.rate)
                _loop(tuner, listener, tuning.adopt)
    except devices.NotBegun:
        return 0  # why is for that process to say
    except InputError as error:
        print(f"hapjax: {error}", file=sys.stderr)
        return 2
    return 0


def _loop(tuner: Tuner, listener: _Listener, always: bool) -> None:
    again, lacked = 0.0, {""}
    while not listener.over:
        while (ticks := listener.chunk()) is not None:
            tuner.take(ticks)
        found = None
        if time.monotonic() >= again:
            found, again = tuner.estimate(), time.monotonic() + _AGAIN
        if found is not None:
            _tell(found)
        if tuner.lacks not in lacked:
            lacked.add(tuner.lacks)
            _tell({"sentence": f"no estimate: {tuner.lacks}"})
        if _asked() or (always and found is not None and tuner.estimates):
            _tell(tuner.adopt())
        time.sleep(PERIOD)


def _asked() -> bool:
    """Whether a line has come in since the last time."""
    found = False
    while select.select([sys.stdin], [], [], 0)[0] and os.read(sys.stdin.fileno(), 4096):
        found = True
    return found


def _tell(found: dict[str, Any]) -> None:
    print(json.dumps(found), flush=True)
