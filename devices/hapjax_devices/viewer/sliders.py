"""Sliders for the live numbers of a run."""

from collections.abc import Callable, Mapping
from threading import Lock
from typing import Any, NamedTuple

import numpy as np

from hapjax import InputError

MOST = 6  # numbers of a list that have a slider each
_UNITS = {  # the unit that is shown, and how many of it are one in SI
    "mass": ("g", 1e3),
    "stiffness": ("N/m", 1.0),
    "tangential_stiffness": ("N/m", 1.0),
    "damping": ("s/m", 1.0),
    "critical_area": ("mm²", 1e6),
    "twist_damping": ("mN m s/rad", 1e3),
}


class Scale(NamedTuple):
    """What a slider shows of a number: its `label`, how many of the shown unit are one in SI, `per`, and its ends."""

    label: str
    per: float
    low: float
    high: float

    @property
    def step(self) -> float:
        """How finely it can be set: a power of ten, of which 200 or more fit."""
        return 10 ** float(np.floor(np.log10((self.high - self.low) / 200)))

    def shown(self, value: float) -> float:
        """A number (SI) as it is shown: to six digits, in single precision there are no more, and within the ends."""
        return float(np.clip(float(f"{value * self.per:.6g}"), self.low, self.high))


def scale(path: str, value: float) -> Scale:
    """The slider of a number that is `value` (SI) at first: from a tenth to four times of it, of a mu from 0 to 1.5 or
    twice of it."""
    *parts, name = path.split(".")
    bare = name.partition("[")[0]
    owner = parts[1] if parts[0] in ("object", "contact") else parts[0]
    unit, per = _UNITS.get(bare, ("", 1.0))
    shown = "A_crit" if bare == "critical_area" else name.replace("_", " ")
    label = f"{owner}: {shown}" + (f" ({unit})" if unit else "")
    if bare.startswith("mu"):
        return Scale(label, per, 0.0, max(1.5, 2 * value))
    low, high = sorted(float(f"{part * value * per:.6g}") for part in (0.1, 4)) if value else (0.0, 1.0)
    return Scale(label, per, low, high)


class Sliders:
    """A slider for each live number of a run; what is set there, the run gets.

    **Arguments:** `server`; `give`, as `Numbers.set` gives the run other numbers; `now`, what they are, by path.

    **Attributes:** `refused`, why the last setting was not taken, empty where it was.
    """

    def __init__(self, server: Any, give: Callable[..., int], now: Mapping[str, np.ndarray]):
        self._give, self._lock, self.refused = give, Lock(), ""
        self._known = {path: np.array(value, np.float64) for path, value in now.items()}
        self._asked: dict[tuple[str, int], float] = {}
        self._sliders: dict[tuple[str, int], tuple[Any, Scale]] = {}
        for path, value in self._known.items():
            for index, number in enumerate(value.ravel()[:MOST] if value.size <= MOST else []):
                self._add(server, path if value.ndim == 0 else f"{path}[{index}]", (path, index), number)

    def _add(self, server: Any, name: str, key: tuple[str, int], number: float) -> None:
        kind = scale(name, float(number))
        made = server.gui.add_slider(
            kind.label, min=kind.low, max=kind.high, step=kind.step, initial_value=kind.shown(float(number))
        )
        self._sliders[key] = made, kind

        @made.on_update
        def _(event: Any) -> None:
            if event.client is not None:
                with self._lock:
                    self._asked[key] = event.target.value / kind.per

    def turn(self, now: Mapping[str, np.ndarray]) -> None:
        """Give the run what was asked for since the last time, and show what others have changed; `now`: what is."""
        with self._lock:
            asked, self._asked = self._asked, {}
        for path, value in now.items():
            if not asked and np.any(value != self._known[path]):
                self._show(path, value)
            self._known[path] = np.array(value, np.float64)
        if asked:
            self._set(asked)

    def _set(self, asked: Mapping[tuple[str, int], float]) -> None:
        wanted = {path: self._known[path].copy() for path, _ in asked}
        for (path, index), number in asked.items():
            wanted[path].flat[index] = number
        try:
            self._give(wanted, timeout=1.0)
            self._known |= wanted
            self.refused = ""
        except InputError as error:
            self.refused = str(error)
            for path, _ in asked:
                self._show(path, self._known[path])

    def _show(self, path: str, value: np.ndarray) -> None:
        for index, number in enumerate(np.ravel(value)):
            if (path, index) in self._sliders:
                slider, kind = self._sliders[path, index]
                slider.value = kind.shown(float(number))
