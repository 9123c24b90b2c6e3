"""A finger that a mouse moves, on the page of the viewer."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Float

from .bus import services
from .device import DeviceError
from .driver import Driver, State
from .realtime import Clock
from .virtual import ENCODER_STEP, FORCE_LIMIT, VirtualDevice

SPEED = 0.25  # m/s, of what the hand wants: a mouse that jumps is no blow
HOLD, SILENCE = 200_000_000, 3_000_000_000  # ns without a word from the viewer: the hand stops, and lets go


class BrowserDevice(Driver):
    """A finger whose hand goes where a mouse drags it in the viewer of the run; see `Device` and `RecoverableDevice`.

    The hand is that of a `VirtualDevice`, which yields to forces; where it wants to be goes straight towards what the viewer
    last said, at 0.25 m/s at most. When nothing is heard from the viewer for 0.2 s, it stops there; after 3 s that is a
    fault, and no force is put out until the viewer is heard again. Before the first word it stays where it began.

    **Arguments:** the `run` that the viewer shows; the number of the `finger`; `start` (3,) m, where it begins; `period` in
    s, between two reads; `clock`: for tests, `None` is the computer's own.
    """

    force_limit, resolution = FORCE_LIMIT, ENCODER_STEP

    def __init__(
        self,
        run: str,
        finger: int,
        start: Float[np.ndarray, "3"],
        period: float = 1e-3,
        clock: Clock | None = None,
    ):
        super().__init__(clock)
        self.name = f"the browser's finger {finger}"
        self._run, self._finger = run, finger
        self._hand = VirtualDevice(np.array(start, np.float64)[None], period)
        self._node = self._service = self._port = None
        self._heard: int | None = None  # when, ns

    def open(self) -> None:
        """Put the hand at its start; see `Device.open`."""
        self._heard = None
        self._hand.open()
        super().open()

    def _steps(self) -> Iterator[State]:
        self._node = services.join(self._run)
        with services.said(f"the fingers of {self._run}"):
            self._service = services.hands(self._node, self._run)
            self._port = self._service.subscriber_builder().create()
        # Who was never heard is not waited for: the viewer comes after the loop.
        again = self._heard
        while again is not None and self._heard == again:
            yield "waiting"
            self._listen()

    def _read(self) -> Float[np.ndarray, "3"]:
        self._listen()
        if self._heard is not None:
            silent = self._clock.now() - self._heard
            if silent > SILENCE:
                raise DeviceError(
                    f"{self.name} is not held: nothing came from the viewer for {silent * 1e-9:.1f} s"
                )
            if silent > HOLD:
                self._hand.operator.follow(self._hand.operator.goal, SPEED)
        return self._hand.read()

    def _write(self, force: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        return self._hand.write(force)

    def _release(self) -> None:
        if self._port is not None:
            self._port.delete()
        self._port = self._service = self._node = None

    def _listen(self) -> None:
        """Take the newest that the viewer has said."""
        assert self._port is not None
        said = None
        while (sample := self._port.receive()) is not None:
            said = services.values(sample, services.HANDS)
        if said is not None:
            goal = np.array(said[3 * self._finger : 3 * self._finger + 3])
            if np.isfinite(goal).all():
                self._heard = self._clock.now()
                self._hand.operator.follow(goal, SPEED)
