"""The channels of a recording: their shapes, and the checks that each passes on its own."""

from dataclasses import dataclass

import numpy as np

from ..errors import InputError


@dataclass(frozen=True)
class Channel:
    """What a channel holds at one time: `items` of them (fingers or objects), each of these `parts`."""

    items: str
    parts: tuple[str, ...]

    @property
    def shape(self) -> str:
        """The shape of its array in words; T samples."""
        count = "F" if self.items == "fingers" else "O"
        return f"(T, {count}, {len(self.parts)})" if self.parts else f"(T, {count})"


CHANNELS = {
    "hip": Channel("fingers", ("x", "y", "z")),
    "force": Channel("fingers", ("x", "y", "z")),
    "gimbal": Channel("fingers", ()),
    "pose": Channel("objects", ("x", "y", "z", "qw", "qx", "qy", "qz")),
    "model_force": Channel("fingers", ("x", "y", "z")),
}
ARRAYS = tuple(name + suffix for name in CHANNELS for suffix in ("", "_t"))

UNIT_TOLERANCE = 1e-3
# The norm of a quaternion that was just normalised: left alone, so that what is saved is loaded bit for bit.
ROUNDING = 8 * np.finfo(np.float64).eps


_PAUSE, _PAUSES = 60.0, 10.0  # s and times what was recorded: no clock that jumps farther ahead is believed


def longest_pause(times: np.ndarray) -> float:
    """How long the gaps between the samples of a channel may be, s."""
    return _PAUSE + _PAUSES * recorded_time(times)


def recorded_time(times: np.ndarray) -> float:
    """How long the samples (T,) of a channel, T above 1, last at their usual interval, s."""
    with np.errstate(over="ignore"):
        gaps = np.sort(np.diff(times))
    return len(times) * float(gaps[(len(gaps) - 1) // 2])


class Refusal(InputError):
    """A channel is refused, by name and row; who read it from a file adds the file and the line."""

    def __init__(self, channel: str, problem: str, row: int | None = None):
        super().__init__(f"{channel}: {problem}" if row is None else f"{channel}, row {row}: {problem}")
        self.channel, self.problem, self.row = channel, problem, row


def checked(name: str, samples: object, times: object) -> tuple[np.ndarray | None, np.ndarray | None]:
    """The samples and times of one channel as read-only float64 arrays; both None where it was not measured.

    **Raises:** `Refusal` for what is no channel of that name: see `Recording`.
    """
    if samples is None and times is None:
        return None, None
    if times is None:
        raise Refusal(name, f"its times are missing, expected {name}_t in seconds, shape (T,)")
    if samples is None:
        raise Refusal(name, f"only its times {name}_t are given, expected shape {CHANNELS[name].shape}")
    values, seconds = _numbers(name, samples), _numbers(f"{name}_t", times)
    if name == "pose" and values.shape[1:] == (len(CHANNELS[name].parts),):
        values = values[:, None, :]
    _check_shapes(name, values, seconds)
    _check_finite(name, values, seconds)
    _check_increasing(name, seconds)
    values = _unit_quaternions(values) if name == "pose" else values
    values.flags.writeable = seconds.flags.writeable = False
    return values, seconds


def _numbers(name: str, value: object) -> np.ndarray:
    try:
        array = np.asarray(value)
    except ValueError:
        raise Refusal(name, "expected an array of real numbers, found rows of unequal length") from None
    if array.dtype.kind not in "fiu":
        raise Refusal(name, f"expected an array of real numbers, found one of type {array.dtype}")
    if array.dtype == np.float64 and array.flags.owndata and not array.flags.writeable:
        return array  # nobody writes to it
    with np.errstate(over="ignore"):  # what overflows float64 is then refused as infinite
        return np.array(array, np.float64)


def _check_shapes(name: str, values: np.ndarray, seconds: np.ndarray) -> None:
    channel = CHANNELS[name]
    parts = (len(channel.parts),) if channel.parts else ()
    if seconds.ndim != 1:
        raise Refusal(f"{name}_t", f"expected shape (T,), found {seconds.shape}")
    if values.ndim != 2 + len(parts) or values.shape[2:] != parts:
        raise Refusal(name, f"expected shape {channel.shape}, found {values.shape}")
    if len(values) != len(seconds):
        raise Refusal(name, f"found {len(values)} samples and {len(seconds)} times, expected as many")
    if values.size == 0:
        raise Refusal(name, f"expected samples of some {channel.items}, found none: shape {values.shape}")


def _check_finite(name: str, values: np.ndarray, seconds: np.ndarray) -> None:
    for array, what in ((seconds, "time"), (values.reshape(len(values), -1), "value")):
        bad = np.argwhere(~np.isfinite(array))
        if len(bad):
            problem = f"expected finite numbers, found the {what} {array[tuple(bad[0])]}"
            raise Refusal(name, problem, int(bad[0][0]))


def _check_increasing(name: str, seconds: np.ndarray) -> None:
    late = np.flatnonzero(seconds[1:] <= seconds[:-1])
    if len(late):
        before, time = seconds[late[0] : late[0] + 2].tolist()
        problem = f"expected a time after {before} s, that of the sample before, found {time} s"
        raise Refusal(name, problem, int(late[0]) + 1)


def _unit_quaternions(pose: np.ndarray) -> np.ndarray:
    with np.errstate(over="ignore"):
        norm = np.linalg.norm(pose[..., 3:], axis=-1)
    off = np.argwhere(np.abs(norm - 1) > UNIT_TOLERANCE)
    if len(off):
        row, item = off[0].tolist()
        problem = f"expected a quaternion qw qx qy qz of norm 1 within {UNIT_TOLERANCE}"
        raise Refusal("pose", f"{problem}, found {norm[row, item]:.6g} of object {item}", row)
    norm = np.where(np.abs(norm - 1) <= ROUNDING, 1.0, norm)
    return np.concatenate([pose[..., :3], pose[..., 3:] / norm[..., None]], axis=-1)
