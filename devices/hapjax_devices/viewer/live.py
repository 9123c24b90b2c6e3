"""A run as it goes on: what its ticks say is drawn, and what a user does on the page the run gets."""

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import numpy as np
from jaxtyping import Float

from hapjax import InputError, Scene
from hapjax.paths import number_at

from ..bus import About, NotBegun, Numbers, TickReader
from ..bus.about import scene_of
from . import plots
from .grip import Grip
from .moments import Moments, moments
from .plots import Plots
from .server import serving
from .sliders import Sliders
from .stage import Stage, camera

FRAME = 1 / 60  # s
_TOLD = 1.0  # s between two reports of how the run does
_LAST = 0.2  # s in which the last word reaches the pages
_EVENTS = 5  # that are shown
_COUNTED = ("missed", "ramped")  # of which there may be many


class Decoder:
    """What the ticks of a run say.

    **Arguments:** `about` the run; its `scene`.

    **Attributes:** `felt`, the numbers of the objects that fingers feel.
    """

    def __init__(self, about: About, scene: Scene):
        self._about = about
        self.felt = [list(scene.object).index(name) for name in about.touch_at]
        self._moving = [list(scene.object).index(name) for name in about.objects]
        each = [about.touch_at[name] for name in about.touch_at]
        self._touch_at = {part: np.array([at[part] for at in each]) for part in each[0]} if each else {}
        self._pose = at_first(scene)
        torsion = scene.torsion
        self._critical = float(getattr(torsion, "critical_area", np.nan))
        self._shapes = {path: np.shape(number_at(scene, path)) for path in about.live}

    def moments(self, ticks: np.ndarray) -> Moments:
        """The moments of these ticks."""
        about, memory = self._about, ticks["memory"].astype(np.float64)
        pose = np.tile(self._pose, (len(ticks), 1, 1))
        if about.objects:
            pose[:, self._moving] = memory[:, np.array(about.pose_at)]
        touch = {part: memory[:, at] for part, at in self._touch_at.items()}
        place = about.live.get("torsion.critical_area")
        critical = np.full(len(ticks), self._critical) if place is None else memory[:, place[0]]
        time = ticks["tick"] / about.rate
        return moments(time, ticks["hip"], ticks["force"], pose, self.felt, touch, critical)

    def live(self, tick: Any) -> dict[str, np.ndarray]:
        """The live numbers of a tick, by path."""
        live = self._about.live.items()
        return {path: tick["memory"][first:end].reshape(self._shapes[path]) for path, (first, end) in live}


def watch(
    run: str,
    host: str,
    port: int,
    patience: float,
    over: Callable[[], bool],
    process: int | None = None,
) -> None:
    """Show a run, that of the `process` of this number, on a page at `host` and `port`, from its beginning, for which
    `patience` s are waited, to its end, or until `over`.

    **Raises:** `InputError` where there is no such run, it does not say what its scene is, or the address cannot be had;
    `NotBegun`, which is one, where the process has ended.
    """
    with ExitStack() as stack:
        reader = _reader(run, patience, over, process)
        if reader is None:
            return
        stack.enter_context(reader)
        scene = scene_of(reader.about)
        while not len(ticks := reader.take()):
            if over() or not reader.is_alive():
                return
            time.sleep(FRAME)
        page = Page(stack, reader, scene, host, port, ticks)
        for _ in frames(lambda: over() or not reader.is_alive()):
            page.take(reader.take())
        if not reader.is_alive():
            page.end()


def frames(over: Callable[[], bool]) -> Iterator[float]:
    """When each frame is drawn (s), `FRAME` apart, or as long as drawing one takes, until it is `over`."""
    next_frame = time.monotonic()
    while not over():
        yield next_frame
        next_frame = max(next_frame + FRAME, time.monotonic())
        time.sleep(max(0.0, next_frame - time.monotonic()))


def _reader(run: str, patience: float, over: Callable[[], bool], process: int | None) -> TickReader | None:
    until = time.monotonic() + patience
    while not over():
        try:
            return TickReader(run, 0.5, process=process)
        except NotBegun:
            raise
        except InputError:
            if time.monotonic() > until:
                raise
    return None


class Page:
    """The page of a run.

    **Arguments:** `stack`, on which what has to be closed is put; the `reader` of the run; its `scene`; `host` and `port`;
    its first `ticks`.
    """

    def __init__(
        self, stack: ExitStack, reader: TickReader, scene: Scene, host: str, port: int, ticks: np.ndarray
    ):
        about = reader.about
        self._reader, self._decoder = reader, Decoder(about, scene)
        self._every, self._said = max(1, round(about.rate / plots.RATE)), []
        self._drawn = self._told = 0.0  # when, s
        server = self._server = stack.enter_context(
            serving(f"hapjax: {about.run}", host, port, camera(scene))
        )
        self._stage = Stage(server, scene, about.fingers)
        self._status = server.gui.add_markdown("")
        self._grip = self._sliders = None
        by_mouse = [place for place, device in enumerate(about.devices) if device["type"] == "BrowserDevice"]
        if by_mouse:
            self._grip = stack.enter_context(Grip(server, self._stage, about.run, by_mouse, ticks["hip"][-1]))
        if about.live:
            numbers = stack.enter_context(Numbers(about.run, process=about.process))
            with server.gui.add_folder("numbers of the scene"):
                self._sliders = Sliders(server, numbers.set, self._decoder.live(ticks[-1]))
        self._plots = Plots(server, about.fingers)
        looks(server, self._stage)
        self._window = self._decoder.moments(ticks[-1:])

    def take(self, ticks: np.ndarray) -> None:
        """Show ticks that have come, the last one, and what happened."""
        if self._grip is not None:
            self._grip.send(bool(self._server.get_clients()))
        if not len(ticks):
            return
        every = ticks[ticks["tick"] % self._every == 0]
        self._window = newest(self._window + self._decoder.moments(every))
        now = time.monotonic()
        if not self._server.get_clients():
            return
        with self._server.atomic():
            self._stage.show(self._decoder.moments(ticks[-1:]))
            if now > self._drawn + plots.PERIOD:
                self._drawn = now
                self._plots.show(self._window)
            if now > self._told + _TOLD:
                self._told = now
                self._status.content = self._words(ticks[-1])
        self._server.flush()  # viser would wait for a frame, and for what sending takes, before each
        if self._sliders is not None:
            self._sliders.turn(self._decoder.live(ticks[-1]))

    def end(self) -> None:
        """Say that nothing more comes."""
        if self._server.get_clients():
            self._status.content = f"The run has ended.\n\n{self._status.content}"
            self._server.flush()
            time.sleep(_LAST)

    def _words(self, tick: Any) -> str:
        """How the run does, and what happened of late."""
        about = self._reader.about
        for event in self._reader.events():
            if event.kind not in _COUNTED:
                self._said.append(f"{max(event.tick, 0) / about.rate:.2f} s: {event.said(about.fingers)}")
        self._said = self._said[-_EVENTS:]
        refused = (
            [] if self._sliders is None or not self._sliders.refused else [f"**{self._sliders.refused}**"]
        )
        begun = f"{tick['tick'] / about.rate:.1f} s, {about.rate:g} Hz, missed ticks: {tick['missed']}"
        return "\n\n".join([begun, *refused, *self._said])


def newest(window: Moments) -> Moments:
    """What of a window a plot shows."""
    return window[int(np.searchsorted(window.time, window.time[-1] - plots.SECONDS)) :]


def looks(server: Any, stage: Stage) -> None:
    """What a user may hide."""
    with server.gui.add_folder("what is drawn", expand_by_default=False):
        for label, handles in stage.parts.items():
            box = server.gui.add_checkbox(label, initial_value=True)

            @box.on_update
            def _(event: Any, handles=handles) -> None:
                for handle in handles:
                    handle.visible = event.target.value


def at_first(scene: Scene) -> Float[np.ndarray, "O 7"]:
    """Where the scene puts its objects, x y z (m) qw qx qy qz."""
    rows = [np.concatenate([thing.position, thing.orientation]) for thing in scene.object.values()]
    pose = np.array(rows, np.float64)
    pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1, keepdims=True)
    return pose
