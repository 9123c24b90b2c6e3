"""The mouse as a hand: what it drags is where the fingers on browser devices want to be."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from ..bus import services

CLOSED = 15.0  # mm, by how much each finger may be moved towards the others


class Grip:
    """Lets a user drag fingertips, or the palm and with it all of them, and close the hand by a slider; sends where each
    finger is to be to the run.

    **Arguments:** `server`; the `stage`, whose `tips` and `palm` are dragged; the `run`; the `fingers` that are on browser
    devices; where all fingers are, `hip` (m).

    **Raises:** `hapjax.InputError` where there is no shared memory to be had.
    """

    def __init__(
        self, server: Any, stage: Any, run: str, fingers: Sequence[int], hip: Float[np.ndarray, "F 3"]
    ):
        self._fingers = list(fingers)
        # Of each page that drags: what it took hold of, and where all were to be then, m.
        self._begun: dict[int, tuple[np.ndarray, np.ndarray]] = {}
        self.goals = np.array(hip[self._fingers], np.float64)
        self._node = services.join(run)
        with services.said(f"the fingers of {run}"):
            self._service = services.hands(self._node, run)
            self._port = self._service.publisher_builder().create()
        with server.gui.add_folder("hand"):
            server.gui.add_markdown("Drag a fingertip, or the palm with all of them; close the hand:")
            self._slider = server.gui.add_slider(
                "grip (mm)", min=0.0, max=CLOSED, step=0.1, initial_value=0.0
            )
        stage.tips.on_drag(self._drag_tip)
        stage.palm.on_drag(self._drag_palm)

    def send(self, held: bool) -> None:
        """Say where the fingers are to be, if a page that can move them is open: else the hand is not `held`."""
        if held:
            record = np.full(1, np.nan, services.HANDS)
            record["goals"][0, self._fingers] = closed(self.goals, self._slider.value * 1e-3)
            services.send(self._port, "Hands", record)

    async def _drag_tip(self, event: Any) -> None:
        if event.instance_index in self._fingers:
            self._drag(event, [self._fingers.index(event.instance_index)])

    async def _drag_palm(self, event: Any) -> None:
        self._drag(event, [*range(len(self._fingers))])

    def _drag(self, event: Any, which: list[int]) -> None:
        if event.phase == "start":
            self._begun[event.client_id] = np.array(event.start_position), self.goals.copy()
        if event.client_id in self._begun:
            grabbed, goals = self._begun[event.client_id]
            self.goals[which] = goals[which] + np.array(event.end_position) - grabbed
        if event.phase == "end":
            self._begun.pop(event.client_id, None)

    def close(self) -> None:
        """Leave the bus."""
        self._port.delete()
        self._service = self._node = None

    def __enter__(self) -> "Grip":
        return self

    def __exit__(self, *exception) -> None:
        self.close()


def closed(goals: Float[np.ndarray, "F 3"], by: float) -> Float[np.ndarray, "F 3"]:
    """Where fingers are to be (m), each moved by so many m towards those on the other side, along the line on which they
    are farthest apart."""
    apart = goals - goals.mean(axis=0)
    axis = np.linalg.svd(apart)[2][0]
    return goals - by * np.sign(np.round(apart @ axis, 9))[:, None] * axis
