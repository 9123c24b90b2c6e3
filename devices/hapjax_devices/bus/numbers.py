"""Live numbers of a run's scene: set from any process, taken by the servo between two ticks."""

import time
from collections.abc import Mapping
from typing import Any

import numpy as np

from hapjax import InputError, Scene
from hapjax.paths import number_at, with_numbers

from . import services
from .about import About, scene_of
from .publisher import TickPublisher
from .reader import TickReader

_AGAIN = 0.05  # s after which numbers that nobody has taken are sent again: the servo may not know of this sender yet


class Inbox:
    """The servo's end: new numbers go into the packed step's memory, where the bus and so a recording have them too.

    They were checked before they were sent. Here, in the middle of a loop, there is time only to see that each is finite
    and not below what is allowed; and it is said a tick later what was taken, not to do all in one tick.

    **Arguments:** `about` the run; its `scene`; the `bus`, on which it is said what was taken and what was refused.

    **Raises:** `InputError` where there is no shared memory to be had.
    """

    def __init__(self, about: About, scene: Scene, bus: TickPublisher):
        self._live, self._places, self._bus = about.live, about.live_at, bus
        self._low = [
            low for path, (first, end) in about.live.items() for low in [_low(scene, path)] * (end - first)
        ]
        self._high, self._sample = float(np.finfo(about.dtype).max), about.numbers
        self._news: tuple[str, str, list[float]] | None = None  # that is still to be told
        self._node = services.join(about.run)
        with services.said(f"the live numbers of {about.run}"):
            self._service = services.numbers(self._node, about.run, about.numbers)
            self._port = self._service.subscriber_builder().create()
        # What is done for the first time takes ten times as long.
        memory = np.zeros(int(self._places.max()) + 1, about.dtype)
        self._taken(0, memory, [1.0] * len(self._low))
        self._said([1.0] * len(self._low))
        self._news = None

    def put(self, tick: int, memory: Any) -> Any:
        """The memory for the step of a tick: with the newest numbers that came, or, where none did, as it is."""
        if self._news is not None:
            self._tell()
        sample = self._port.receive()
        if sample is None:
            return memory
        while sample is not None:
            values = services.values(sample, self._sample)
            sample = self._port.receive()
        return self._taken(tick, memory, values)

    def _taken(self, tick: int, memory: Any, values: list[float]) -> Any:
        # Written so that NaN is not allowed either.
        if not all(low <= value <= self._high for low, value in zip(self._low, values, strict=True)):
            self._news = ("refused", f"numbers refused at tick {tick}: ", values)
            return memory
        new = np.array(memory)
        before = new[self._places].tolist()
        new[self._places] = values
        if new[self._places].tolist() == before:
            return memory
        self._news = ("numbers", f"from tick {tick} on ", values)
        return new

    def _tell(self) -> None:
        assert self._news is not None
        kind, said, values = self._news
        self._bus.event(kind, said + self._said(values))
        self._news = None

    def _said(self, values: list[float]) -> str:
        left, parts = iter(values), []
        for path, (first, end) in self._live.items():
            parts.append(f"{path} is {' '.join(f'{next(left):.6g}' for _ in range(first, end))}")
        return ", ".join(parts)

    def close(self) -> None:
        """Leave the bus."""
        if self._news is not None:
            self._tell()
        self._port.delete()
        self._service = self._node = None

    def __enter__(self) -> "Inbox":
        return self

    def __exit__(self, *exception) -> None:
        self.close()


class Numbers:
    """The live numbers of a run, read and set from any process of the same user.

    **Arguments:** `run`, its name; `patience`, s to wait for it to begin; the number of its `process`, `None`: of any.

    **Attributes:** `about` the run.

    **Raises:** `InputError` where there is no such run, or it has no live numbers.
    """

    def __init__(self, run: str, patience: float = 20.0, process: int | None = None):
        self._reader = TickReader(run, patience, process=process)
        self.about = self._reader.about
        if not self.about.live:
            self._reader.close()
            raise InputError(f"the run {run} has no live numbers; allowed: a run that was begun with some")
        self._scene = scene_of(self.about)
        self._node = services.join(run)
        with services.said(f"the live numbers of {run}"):
            self._service = services.numbers(self._node, run, self.about.numbers)
            self._port = self._service.publisher_builder().create()
        self._now = {path: np.asarray(number_at(self._scene, path)) for path in self.about.live}

    def now(self) -> dict[str, np.ndarray]:
        """The numbers of the newest tick, by their paths."""
        ticks = self._reader.take()
        if len(ticks):
            self._note(ticks["memory"][-1])
        return dict(self._now)

    def set(self, values: Mapping[str, Any], timeout: float = 5.0) -> int:
        """Give the run other numbers, all at once; returns the tick from which on it has them.

        **Arguments:** `values` by path; those that are left out stay. `timeout`, s until the run is to have taken them.

        **Raises:** `InputError` for a path that is not live, for values that the scene cannot have, and where the run does
        not take them in time.
        """
        for path in values:
            if path not in self.about.live:
                raise InputError(f"{path} is not live; allowed: {', '.join(self.about.live)}")
        new = {**self.now(), **values}
        changed = with_numbers(self._scene, new)
        wanted = np.concatenate([np.ravel(np.asarray(number_at(changed, path))) for path in self.about.live])
        until, sent = time.monotonic() + timeout, -np.inf
        while time.monotonic() < until and self._reader.is_alive():
            if time.monotonic() > sent + _AGAIN:
                services.send(self._port, "Numbers", np.array([(wanted,)], self.about.numbers))
                sent = time.monotonic()
            ticks = self._reader.take()
            held = ticks["memory"][:, self.about.live_at]
            there = np.flatnonzero((held == wanted.astype(held.dtype)).all(axis=1))
            if len(there):
                self._note(ticks["memory"][there[0]])
                return int(ticks["tick"][there[0]])
            time.sleep(2e-3)
        raise InputError(
            f"the run {self.about.run} has not taken the numbers in {timeout:g} s; allowed: a run that goes on"
        )

    def close(self) -> None:
        """Leave the bus."""
        self._port.delete()
        self._service = self._node = None
        self._reader.close()

    def __enter__(self) -> "Numbers":
        return self

    def __exit__(self, *exception) -> None:
        self.close()

    def _note(self, memory: np.ndarray) -> None:
        for path, (first, end) in self.about.live.items():
            self._now[path] = memory[first:end].reshape(self._now[path].shape)


def _low(scene: Scene, path: str) -> float:
    """The least that a scene takes for each of the numbers at a path, -inf where they may be below 0 or are a matrix."""
    number = np.asarray(number_at(scene, path))
    if number.ndim > 1 or _takes(scene, path, np.full(number.shape, -1.0)):
        return -np.inf
    return 0.0 if _takes(scene, path, np.zeros(number.shape)) else float(np.finfo(number.dtype).tiny)


def _takes(scene: Scene, path: str, value: np.ndarray) -> bool:
    try:
        with_numbers(scene, {path: value})
    except InputError:
        return False
    return True
