"""An independent program for a body that fingers hold without slip and without loss.

Each finger is then a spring of no length between a point in space and a point of the body's surface. Written with SciPy
alone, on other variables than hapjax's (angular momentum in space in place of the spin). Its numbers may be complex, for
`slope`.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from scipy.integrate import solve_ivp


class Held(NamedTuple):
    """A body on springs: kg, kg m^2 (principal), (n, 3) m of the body, N/m, and `fingers(t)` (n, 3) m in space.

    `share` of the springs' torque about `axis` counts, and `loss` (N m s/rad) acts about it.
    """

    mass: Any
    inertia: np.ndarray
    anchors: np.ndarray
    stiffness: Any
    fingers: Callable[[float], np.ndarray]
    gravity: np.ndarray
    axis: np.ndarray | None = None
    share: float = 1.0
    loss: Any = 0.0


class Place(NamedTuple):
    """Where a body is and how it moves: m, matrix, m/s, rad/s in space."""

    position: np.ndarray
    matrix: np.ndarray
    velocity: np.ndarray
    spin: np.ndarray


def solve(held: Held, start: Place, seconds: float, begin: float = 0.0) -> Place:
    """The place after `seconds` s, to about 1e-11 of its size (DOP853)."""
    momentum = start.matrix @ (held.inertia * (start.matrix.T @ start.spin))
    y = np.concatenate([start.position, _quaternion(start.matrix), start.velocity, momentum])
    y = y + 0 * (held.mass + held.stiffness + held.loss + held.inertia[0] + held.gravity[2])
    ended = solve_ivp(
        lambda t, y: _rate(held, t, y),
        (begin, begin + seconds),
        y,
        method="DOP853",
        rtol=1e-12,
        atol=1e-14,
    ).y[:, -1]
    matrix = _matrix(ended[3:7])
    return Place(ended[:3], matrix, ended[7:10], matrix @ ((matrix.T @ ended[10:]) / held.inertia))


def slope(value: Callable[[Any], np.ndarray], at: float) -> np.ndarray:
    """The derivative of `value` by a complex step, which takes no difference (Squire and Trapp 1998)."""
    step = 1e-30
    return np.imag(value(at + 1j * step)) / step


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """As `np.cross`, which takes most of the time."""
    (x, y, z), (u, v, w) = a.T, b.T
    return np.stack([y * w - z * v, z * u - x * w, x * v - y * u], axis=-1)


def _quaternion(matrix: np.ndarray) -> np.ndarray:
    """Of a turn by less than half a turn, its scalar last."""
    scalar = np.sqrt(1 + np.trace(matrix)) / 2
    turned = [matrix[2, 1] - matrix[1, 2], matrix[0, 2] - matrix[2, 0], matrix[1, 0] - matrix[0, 1]]
    return np.array([*(part / (4 * scalar) for part in turned), scalar])


def _matrix(q: np.ndarray) -> np.ndarray:
    """Of a quaternion, its scalar last."""
    x, y, z, w = q / np.sqrt(q @ q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def _rate(held: Held, t: float, y: np.ndarray) -> np.ndarray:
    position, q, velocity, momentum = y[:3], y[3:7], y[7:10], y[10:]
    matrix = _matrix(q)
    spin = matrix @ ((matrix.T @ momentum) / held.inertia)
    arms = held.anchors @ matrix.T
    forces = held.stiffness * (held.fingers(t) - position - arms)
    torque = _cross(arms, forces).sum(axis=0)
    if held.axis is not None:
        torque = torque - ((1 - held.share) * torque @ held.axis + held.loss * spin @ held.axis) * held.axis
    turning = 0.5 * np.array([*(q[3] * spin + _cross(spin, q[:3])), -spin @ q[:3]])
    return np.concatenate([velocity, turning, held.gravity + forces.sum(axis=0) / held.mass, torque])
