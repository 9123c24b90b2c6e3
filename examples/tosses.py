"""Tosses of a tracked cube: read from a file, and checked.

A file (NPZ, SI units) holds `state` (samples, 13) of all tosses one after the other, toss i in the rows
`offset[i]:offset[i+1]`: position, quaternion w x y z, velocity, and angular velocity in the cube's own frame; and the
numbers `rate` (Hz), `mass` (kg) and `side` (m).
"""

from dataclasses import dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from npz_arrays import arrays_of
from scipy.spatial.transform import Rotation

from hapjax import InputError

LEAST = 40  # samples of a toss: a flight, an impact, and what comes after it


@dataclass(frozen=True)
class Toss:
    """One toss: `position` (T, 3) m, `orientation` (T, 4) w x y z, `velocity` (T, 3) m/s, `spin` (T, 3) rad/s, world frame;
    samples a second, mass (kg) and edge (m) of the cube."""

    position: np.ndarray
    orientation: np.ndarray
    velocity: np.ndarray
    spin: np.ndarray
    rate: float
    mass: float
    side: float

    def lowest(self) -> np.ndarray:
        """The height (T,) m of the lowest corner of a cube with sharp edges."""
        up = Rotation.from_quat(self.orientation, scalar_first=True).as_matrix()[:, 2]
        return self.position[:, 2] - self.side / 2 * np.abs(up).sum(axis=1)

    def first_impact(self) -> int:
        """The first sample at which a corner is below z = 0; the last one if none is."""
        below = np.flatnonzero(self.lowest() < 0)
        return int(below[0]) if len(below) else len(self.position) - 1

    def touches(self, ahead: int, gravity: float) -> tuple[tuple[jax.Array, ...], jax.Array]:
        """Position, rotation vector, velocity and spin, (N, 3) each, of the last samples before a corner comes below z = 0,
        and the poses after them (N, ahead, 7).

        The recorded velocity is that of the way since the sample before; `gravity` (m/s^2) brings it up to the sample.
        """
        above = self.lowest() > 0
        first = np.flatnonzero(above[:-1] & ~above[1:])
        first = first[first + ahead < len(above)]
        turn = Rotation.from_quat(self.orientation, scalar_first=True).as_rotvec()
        velocity = self.velocity - np.array([0, 0, gravity / (2 * self.rate)])
        before = tuple(jnp.asarray(x[first]) for x in (self.position, turn, velocity, self.spin))
        poses = np.concatenate([self.position, self.orientation], axis=1)
        return before, jnp.asarray(poses[first[:, None] + np.arange(1, ahead + 1)])


def read(path: Path) -> list[Toss]:
    """The tosses of a file. **Raises:** `InputError` in one sentence where it is not such a file."""
    arrays = arrays_of(path)
    state, offset = _array(path, arrays, "state", 2), _array(path, arrays, "offset", 1)
    if state.shape[1] != 13:
        raise InputError(f"{path}, state: shape {state.shape}; expected (samples, 13)")
    rate, mass, side = (float(_array(path, arrays, name, 0)) for name in ("rate", "mass", "side"))
    for name, value in (("rate", rate), ("mass", mass), ("side", side)):
        if not value > 0:
            raise InputError(f"{path}, {name}: {value:g}; allowed: above 0")
    if offset[0] != 0 or offset[-1] != len(state) or not np.all(np.diff(offset) >= LEAST):
        raise InputError(
            f"{path}, offset: expected numbers that rise from 0 to {len(state)} by at least {LEAST}"
        )
    if not np.allclose(np.linalg.norm(state[:, 3:7], axis=1), 1, atol=1e-3):
        raise InputError(f"{path}, state: columns 3 to 6 are no unit quaternions")
    ends = offset.astype(int)
    return [_toss(state[a:b], rate, mass, side) for a, b in zip(ends[:-1], ends[1:], strict=True)]


def _toss(state: np.ndarray, rate: float, mass: float, side: float) -> Toss:
    spin = Rotation.from_quat(state[:, 3:7], scalar_first=True).apply(state[:, 10:13])
    return Toss(state[:, :3], state[:, 3:7], state[:, 7:10], spin, rate, mass, side)


def _array(path: Path, arrays: dict[str, np.ndarray], name: str, axes: int) -> np.ndarray:
    if name not in arrays:
        raise InputError(f"{path}: array {name!r} is missing")
    array = arrays[name]
    if (
        array.dtype.kind not in "iuf"
        or array.ndim != axes
        or not array.size
        or not np.all(np.isfinite(array))
    ):
        raise InputError(f"{path}, {name}: expected finite real numbers of {axes} axes, found others")
    return array.astype(np.float64)
