"""The Falcon's kinematics as a servo loop needs them: one position at a time, in plain numbers.

A compiled function is handed over to a thread of JAX's, and that costs a loop on a busy machine more than the arithmetic.
What `kinematics` says is the reference: tests hold the two together.
"""

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .kinematics import (
    ARM,
    AT_ZERO,
    CENTRE,
    COUNT,
    ENDS,
    LEGS,
    OFFSET,
    RADIUS,
    ROD,
    SIDE,
    SIDE_OF_BASE,
    arm_angle,
)

_LEGS = [(math.cos(leg), math.sin(leg)) for leg in LEGS.tolist()]
_STEPS = 10
_CLOSE = 1e-13  # m
_MISS = 1e-9  # rad

Triple = tuple[float, float, float]


class Stance(NamedTuple):
    """Where the grip is, and how the arms' torques act on it there.

    `position` (3,) m in the device's frame, `jacobian` (3, 3) rad/m of the arms' angles by it, and `inverse` of that, m/rad.
    """

    position: Float[np.ndarray, "3"]
    jacobian: Float[np.ndarray, "3 3"]
    inverse: Float[np.ndarray, "3 3"]

    def torques(self, force: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """The arms' torques, N m, that push the grip with `force`, N: J^-T F."""
        return force @ self.inverse

    def force(self, torques: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """The force on the grip, N, of the arms' `torques`, N m: J^T T."""
        return torques @ self.jacobian


def stance_of(counts: Iterable[float | int], near: Iterable[float | int] | None = None) -> Stance | None:
    """The stance for what the three encoders count, whole numbers or not; `None` where no position of the grip has them.

    Newton's method on the rods' lengths, from `near` (m, the device's frame) if given, and from the workspace's middle:
    from there it finds every position.
    """
    angles = [AT_ZERO + COUNT * float(count) for count in counts]
    stance = None if near is None else _found(angles, near)
    return stance or _found(angles, CENTRE.tolist())


def _found(angles: Sequence[float], near: Iterable[float | int]) -> Stance | None:
    knees = [(ARM * math.cos(angle), ARM * math.sin(angle)) for angle in angles]
    x, y, z = map(float, near)
    try:
        for _ in range(_STEPS):
            legs = [_rod(leg, knee, x, y, z) for leg, knee in zip(_LEGS, knees, strict=True)]
            inverse = _inverted([slope for _, slope, _ in legs])
            (a, _, _), (b, _, _), (c, _, _) = legs
            move = [row[0] * a + row[1] * b + row[2] * c for row in inverse]
            x, y, z = x - move[0], y - move[1], z - move[2]
            if max(map(abs, move)) < _CLOSE:
                break
        # The rods' lengths do not tell a knee that points outwards from one that points inwards; the angles do.
        found = [_arm(leg, x, y, z) for leg in _LEGS]
    except (ZeroDivisionError, ValueError, OverflowError):  # nowhere: the angles of a leg that does not reach
        return None
    if not max(abs(a - b) for a, b in zip(found, angles, strict=True)) < _MISS:
        return None
    # With the rod's length g(p, theta) = 0: d theta / dp = -(dg / dp) / (dg / d theta).
    turns = [turn for _, _, turn in legs]
    jacobian = [[-part / turn for part in slope] for (_, slope, _), turn in zip(legs, turns, strict=True)]
    back = [[-part * turn for part, turn in zip(row, turns, strict=True)] for row in inverse]
    return Stance(np.array((x, y, z)), np.array(jacobian), np.array(back))


def counts_at(position: Iterable[float | int]) -> Float[np.ndarray, "3"]:
    """What the encoders are at, in counts and not rounded, with the grip at `position` (m, the device's frame).

    **Raises:** `ValueError` where the grip cannot be.
    """
    x, y, z = map(float, position)
    return np.array([(_arm(leg, x, y, z) - AT_ZERO) / COUNT for leg in _LEGS])


def _in_frame(leg: tuple[float, float], x: float, y: float) -> tuple[float, float]:
    """Where a leg's end on the platform is: outwards and sideways, in the leg's frame."""
    cos, sin = leg
    return x * cos + y * sin - RADIUS + OFFSET, y * cos - x * sin - SIDE_OF_BASE + SIDE


def _arm(leg: tuple[float, float], x: float, y: float, z: float) -> float:
    return arm_angle(math, *_in_frame(leg, x, y), z)


def _rod(leg: tuple[float, float], knee: tuple[float, float], x: float, y: float, z: float):
    """By how much a leg's rod would have to be longer, m; the slope of that by the position, and by the arm's angle."""
    outwards, sideways = _in_frame(leg, x, y)
    u, w = outwards - knee[0], z - knee[1]
    across = math.hypot(u, w)
    length = math.hypot(across - ENDS, sideways)
    by_u = (across - ENDS) / (length * across) * u
    by_w = (across - ENDS) / (length * across) * w
    by_sideways = sideways / length
    cos, sin = leg
    slope = (by_u * cos - by_sideways * sin, by_u * sin + by_sideways * cos, by_w)
    return length - ROD, slope, by_u * knee[1] - by_w * knee[0]


def _inverted(rows: Sequence[Triple]) -> list[Triple]:
    """The inverse of a matrix of three rows, by Cramer's rule."""
    (a, b, c), (d, e, f), (g, h, i) = rows
    first, second, third = e * i - f * h, f * g - d * i, d * h - e * g
    size = 1 / (a * first + b * second + c * third)
    return [
        (first * size, (c * h - b * i) * size, (b * f - c * e) * size),
        (second * size, (a * i - c * g) * size, (c * d - a * f) * size),
        (third * size, (b * g - a * h) * size, (a * e - b * d) * size),
    ]
