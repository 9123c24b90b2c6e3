"""The last seconds of what was felt and measured, as a recording to fit to."""

from typing import Any

import numpy as np

from ..recording import Recording
from .sensor import Measured

KEPT = 3  # windows: of the newest of them one is chosen that begins with no touch
FORCE_RATE, POSE_RATE = 500.0, 100.0  # Hz, at most


class Window:
    """Keeps the last seconds, and cuts a window from them that begins while no finger touches anything.

    In the middle of a touch a model could not know how friction is stretched; at a window's beginning it takes it to be not.

    **Arguments:** how long the window is, `seconds`; the `rate` of ticks, Hz; `least`, N, a measured force that is a touch.

    **Attributes:** `lacks`, why there was none when it was last cut, though there were enough ticks, in words.
    """

    def __init__(self, seconds: float, rate: float, least: float):
        self._rate, self._least, self.length = rate, least, round(seconds * rate)
        self._parts: list[tuple[np.ndarray, Measured]] = []
        self._from = -self.length  # the tick at which the last window began
        self.lacks = ""

    def add(self, ticks: np.ndarray, measured: Measured) -> None:
        """Note ticks, as a `TickReader` takes them, and what was measured then. Where some were lost, it begins anew."""
        if self._parts and ticks["tick"][0] != self._parts[-1][0]["tick"][-1] + 1:
            self._parts.clear()
        self._parts.append((ticks, measured))
        while sum(len(part) for part, _ in self._parts[1:]) >= KEPT * self.length:
            del self._parts[0]

    def cut(self) -> Recording | None:
        """The newest window that begins without a touch and has some; `None` where there is none, or half of it was in
        the one before."""
        self.lacks = ""
        count = sum(len(part) for part, _ in self._parts)
        if count <= self.length:
            return None
        ticks = np.concatenate([part for part, _ in self._parts])
        force = np.concatenate([measured.force for _, measured in self._parts])
        pose = np.concatenate([measured.pose for _, measured in self._parts])
        touching = (ticks["force"] != 0).any(axis=(1, 2)) | (np.linalg.norm(force, axis=2) > self._least).any(
            axis=1
        )
        begins = np.flatnonzero(~touching[: len(ticks) - self.length])
        if count >= KEPT * self.length:
            self.lacks = self._lack(touching, begins)
        if not len(begins):
            return None
        cut = slice(begins[-1], begins[-1] + self.length)
        first = int(ticks["tick"][cut.start])
        if not touching[cut].any() or first < self._from + self.length // 2:
            return None
        self._from = first
        return self._recording(ticks[cut], force[cut], pose[cut])

    def _lack(self, touching: np.ndarray, begins: np.ndarray) -> str:
        last, window = f"in the last {KEPT * self.length / self._rate:g} s", f"{self.length / self._rate:g} s"
        if not touching.any():
            return f"no finger touched anything {last}"
        if not len(begins):
            return f"some finger touched something all the time {last}; a window of {window} begins where none does"
        return ""

    def _recording(self, ticks: np.ndarray, force: np.ndarray, pose: np.ndarray) -> Recording:
        times = ticks["tick"] / self._rate
        some, few = (max(1, round(self._rate / rate)) for rate in (FORCE_RATE, POSE_RATE))
        channels: dict[str, Any] = {"hip": ticks["hip"], "hip_t": times}
        channels |= {"force": force[::some], "force_t": times[::some]}
        if ticks["gimbal"].shape[1]:
            channels |= {"gimbal": ticks["gimbal"], "gimbal_t": times}
        if pose.shape[1]:  # a step's poses belong to its end
            channels |= {"pose": pose[::few], "pose_t": times[::few] + 1 / self._rate}
        return Recording(**channels)
