"""Recording: fingers, forces, gimbals and object poses as they were logged, each with its own clock."""

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..files import check_writable
from . import csv_file, mcap_file, npz_file, parquet_file
from .channels import ARRAYS, CHANNELS, Refusal, checked, longest_pause, recorded_time
from .cleaning import cleaned
from .content import Content
from .finding import Finding

_FORMATS = {".npz": npz_file, ".csv": csv_file, ".mcap": mcap_file, ".parquet": parquet_file}


@dataclass(frozen=True, eq=False, kw_only=True)
class Recording:
    """What was logged of F fingers and O moving objects, in SI units, in the world frame (z up).

    Each channel has its own clock: times in seconds, finite and strictly increasing, of any origin that the
    channels share. A channel that was not measured is None, and so are its times; at least one was measured.
    The arrays are kept as read-only float64.

    **Attributes:**

    - `hip`: (T, F, 3) m, haptic interface points (fingertips); `hip_t`: (T,) s.
    - `force`: (T, F, 3) N, the force on the finger; `force_t`: (T,) s.
    - `model_force`: (T, F, 3) N, what the scene answered in the servo loop, before a device put it out;
      `model_force_t`: (T,) s. It is no measurement, and no fit looks at it.
    - `gimbal`: (T, F) rad, angle of the finger's instrumented gimbal; `gimbal_t`: (T,) s.
    - `pose`: (T, O, 7), x y z in m and the unit quaternion qw qx qy qz of each moving object in the scene's
      order, or (T, 7) for one object; `pose_t`: (T,) s. Quaternions are normalised.
    - `findings`: what was noticed and repaired when it was loaded.

    **Raises:** `hapjax.InputError`, naming the channel, the row (counted from 0) and what was expected: wrong
    shapes, no real numbers, NaN or infinity, times that do not increase, samples without times, channels of
    different finger counts, a quaternion whose norm is off 1 by more than 0.001, nothing recorded at all.
    """

    hip: np.ndarray | None = None
    hip_t: np.ndarray | None = None
    force: np.ndarray | None = None
    force_t: np.ndarray | None = None
    model_force: np.ndarray | None = None
    model_force_t: np.ndarray | None = None
    gimbal: np.ndarray | None = None
    gimbal_t: np.ndarray | None = None
    pose: np.ndarray | None = None
    pose_t: np.ndarray | None = None
    findings: tuple[Finding, ...] = ()

    def __post_init__(self):
        counts: dict[str, tuple[str, int]] = {}
        for name, channel in CHANNELS.items():
            samples, times = checked(name, getattr(self, name), getattr(self, f"{name}_t"))
            object.__setattr__(self, name, samples)
            object.__setattr__(self, f"{name}_t", times)
            if samples is None:
                continue
            first, count = counts.setdefault(channel.items, (name, samples.shape[1]))
            if samples.shape[1] != count:
                problem = (
                    f"expected as many {channel.items} as {first} has, {count}, found {samples.shape[1]}"
                )
                raise Refusal(name, problem)
        if not counts:
            raise InputError(f"nothing is recorded; expected one or more of {', '.join(CHANNELS)}")

    @property
    def fingers(self) -> int:
        """How many fingers were recorded; 0 where only objects were."""
        return next(
            (x.shape[1] for x in (self.hip, self.force, self.model_force, self.gimbal) if x is not None), 0
        )

    def check_pauses(self) -> None:
        """Refuse a path whose pauses, which a model would have to go through, are far longer than what was recorded.

        **Raises:** `hapjax.InputError` if they are over 60 s and 10 times the samples at their usual interval.
        """
        if self.hip_t is None or len(self.hip_t) < 2:
            return
        with np.errstate(over="ignore"):
            gaps, span = np.diff(self.hip_t), self.hip_t[-1] - self.hip_t[0]
        recorded = recorded_time(self.hip_t)
        if span - recorded > longest_pause(self.hip_t):
            after = int(np.argmax(gaps))
            problem = f"found {recorded:.4g} s of samples and a jump ahead by {gaps[after]:.4g} s after it"
            raise InputError(
                f"hip, row {after} at {self.hip_t[after]:.6g} s: expected a clock that goes on, {problem}"
            )

    def hip_every(self, dt: float) -> np.ndarray:
        """The fingers' path (N, F, 3) m at intervals of `dt` s, from the first sample on, for a model to follow.

        As recorded where the clock ticks at `dt` (to a thousandth of it), else linearly interpolated.

        **Raises:** `hapjax.InputError` if `hip` was not recorded, has one sample, would have over 10 million, or is
            refused by `check_pauses`.
        """
        if self.hip is None or self.hip_t is None:
            raise InputError("hip was not recorded; expected the fingers' positions")
        if len(self.hip_t) < 2:
            raise InputError("hip has one sample; expected at least two")
        self.check_pauses()
        with np.errstate(over="ignore"):
            gaps, span = np.diff(self.hip_t), self.hip_t[-1] - self.hip_t[0]
        if np.allclose(gaps, dt, rtol=0, atol=1e-3 * dt):
            return self.hip
        if span > 1e7 * dt:
            raise InputError(f"hip spans {span:g} s; expected at most 10 million intervals of {dt:g} s")
        grid = self.hip_t[0] + dt * np.arange(int(np.floor(span / dt + 1e-6)) + 1)
        flat = self.hip.reshape(len(self.hip_t), -1)
        return np.stack([np.interp(grid, self.hip_t, c) for c in flat.T], axis=-1).reshape(
            -1, *self.hip.shape[1:]
        )

    def gimbal_at(self, times: np.ndarray) -> np.ndarray:
        """The gimbals' angles (N, F) rad at the `times` (N,) s, for a model to follow.

        Linearly interpolated; before the first sample and after the last they stay as they are there.

        **Raises:** `hapjax.InputError` if `gimbal` was not recorded.
        """
        if self.gimbal is None or self.gimbal_t is None:
            raise InputError("gimbal was not recorded; expected the angles of the fingers' gimbals")
        return np.stack([np.interp(times, self.gimbal_t, angle) for angle in self.gimbal.T], axis=-1)

    @classmethod
    def load(
        cls, path: str | os.PathLike[str], topics: Mapping[str, Sequence[str]] | None = None
    ) -> "Recording":
        """Read a recording as it is from a `.npz`, `.csv`, `.mcap` or `.parquet` file; `load_recording` cleans it too.

        **Arguments:** `topics`, of a ROS 2 bag (`.mcap`): the topics of `hip`, `force` and `pose`, one for each finger or
        object, such as `{"hip": ["/left/tip", "/right/tip"], "force": ["/left/sensor", "/right/sensor"]}`.

        **Raises:** `hapjax.InputError`, naming the file, the channel, the row (a line of a CSV file, counted
        from 1; an index into an NPZ file's arrays, a row of a Parquet file's table or a message of an MCAP file's
        channel, counted from 0) and what was expected.
        """
        return _built(Path(path), _content(Path(path), topics))

    @staticmethod
    def check_writable(path: str | os.PathLike[str]) -> None:
        """Refuse, before any work is done for it, a path that `save` could not write. **Raises:** `InputError`."""
        _format(Path(path))
        check_writable(path)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the recording as `.npz`, `.csv`, `.mcap` or `.parquet`, whole or not at all; `load` gives back the very
        numbers.

        **Raises:** `hapjax.InputError` if the suffix is another, or the file cannot be written.
        """
        path = Path(path)
        arrays = {name: getattr(self, name) for name in ARRAYS}
        _format(path).write({name: array for name, array in arrays.items() if array is not None}, path)


def load_recording(
    path: str | os.PathLike[str], topics: Mapping[str, Sequence[str]] | None = None
) -> Recording:
    """Read a recording from a file, clean it, and say in its `findings` what was noticed and what was done.

    Samples that are no numbers, that come twice or whose time goes back are dropped; so are the repetitions of a held
    sample and lone samples that no finger could have reached. Dropouts and odd units of time are only reported.

    **Arguments:** as for `Recording.load`.

    **Raises:** `hapjax.InputError` as `Recording.load`, and where so much would have to be dropped that the recording
    needs a look.
    """
    path = Path(path)
    return _built(path, cleaned(path, _content(path, topics)))


def _content(path: Path, topics: Mapping[str, Sequence[str]] | None) -> Content:
    form = _format(path)
    if topics is not None and form is not mcap_file:
        raise InputError(f"{path}: topics are named for it; expected a ROS 2 bag, *.mcap")
    try:
        return form.read(path) if topics is None else mcap_file.read(path, topics)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except InputError:
        raise
    except ValueError as error:  # a NUL in the name
        raise InputError(f"{path}: cannot be read: {error}") from error


def _built(path: Path, content: Content) -> Recording:
    for array in content.arrays.values():
        array.flags.writeable = False  # so that none is copied
    try:
        return Recording(**content.arrays, findings=content.findings)  # pyright: ignore[reportArgumentType]
    except Refusal as refusal:
        row = "" if refusal.row is None else f", {content.place(refusal.channel, refusal.row)}"
        raise InputError(f"{path}, {refusal.channel}{row}: {refusal.problem}") from None
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _format(path: Path):
    if path.suffix.lower() not in _FORMATS:
        raise InputError(f"{path}: expected a recording named {', '.join('*' + s for s in _FORMATS)}")
    return _FORMATS[path.suffix.lower()]
