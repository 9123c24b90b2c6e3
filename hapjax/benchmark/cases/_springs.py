"""An independent program for a body that fingers hold without slip and without loss.

Each finger is then a spring of no length between a point in space and a point of the body's surface. Written with SciPy
alone, on other variables than hapjax's (angular momentum in space in place of the spin).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp
from scipy.spatial.transform import Rotation


class Held(NamedTuple):
    """A body on springs: kg, kg m^2 (principal), (n, 3) m of the body, N/m, and `fingers(t)` (n, 3) m in space.

    `share` of the springs' torque about `axis` counts, and `loss` (N m s/rad) acts about it.
    """

    mass: float
    inertia: np.ndarray
    anchors: np.ndarray
    stiffness: float
    fingers: Callable[[float], np.ndarray]
    gravity: np.ndarray
    axis: np.ndarray | None = None
    share: float = 1.0
    loss: float = 0.0


class Place(NamedTuple):
    """Where a body is and how it moves: m, matrix, m/s, rad/s in space."""

    position: np.ndarray
    matrix: np.ndarray
    velocity: np.ndarray
    spin: np.ndarray


def solve(held: Held, start: Place, seconds: float, begin: float = 0.0) -> Place:
    """The place after `seconds` s, to about 1e-11 of its size (DOP853)."""
    quaternion = Rotation.from_matrix(start.matrix).as_quat()
    momentum = start.matrix @ (held.inertia * (start.matrix.T @ start.spin))
    y = np.concatenate([start.position, quaternion, start.velocity, momentum])
    ended = solve_ivp(
        lambda t, y: _rate(held, t, y),
        (begin, begin + seconds),
        y,
        method="DOP853",
        rtol=1e-12,
        atol=1e-14,
    ).y[:, -1]
    matrix = Rotation.from_quat(ended[3:7]).as_matrix()
    return Place(ended[:3], matrix, ended[7:10], matrix @ ((matrix.T @ ended[10:]) / held.inertia))


def _rate(held: Held, t: float, y: np.ndarray) -> np.ndarray:
    position, q, velocity, momentum = y[:3], y[3:7], y[7:10], y[10:]
    matrix = Rotation.from_quat(q).as_matrix()
    spin = matrix @ ((matrix.T @ momentum) / held.inertia)
    arms = held.anchors @ matrix.T
    forces = held.stiffness * (held.fingers(t) - position - arms)
    torque = np.cross(arms, forces).sum(axis=0)
    if held.axis is not None:
        torque = torque - ((1 - held.share) * torque @ held.axis + held.loss * spin @ held.axis) * held.axis
    turning = 0.5 * np.array([*(q[3] * spin + np.cross(spin, q[:3])), -spin @ q[:3]])
    return np.concatenate([velocity, turning, held.gravity + forces.sum(axis=0) / held.mass, torque])
