"""hapjax's spring and loss of a contact, in the terms of others."""

import math
from typing import Any

import numpy as np

from ..scene import World
from ..surface import Surface

IMPEDANCE = 0.001
"""How much of MuJoCo's contact is a rigid constraint. The less, the more it is a spring with a damper, as hapjax's.

A slip at the speed v presses more by mu v d / (2 step A), see `friction_damping`: with 0.01, a box that slides at 1 m/s is
lifted off.
"""
LEAST_DAMPING = 0.5
"""s/m, of a contact of MuJoCo: with less, what is put down hops for seconds, and slips each time that it is light."""
_LEAST_IMPEDANCE = 1e-4  # MuJoCo's own
_BOUNCE = 0.1  # m/s, of a thing that is put down


def mujoco_solref(stiffness: float, mobility: float, damping: float, impedance: float) -> tuple[float, float]:
    """The `solref` with which a contact point of MuJoCo yields at rest by force / stiffness.

    With the impedance d at any depth, MuJoCo's force at rest is K r / ((1 - d) A), r the depth and A the sum of what is
    moved by a unit of force, 1 / mass, of both bodies (MuJoCo's documentation, Computation, Constraint model). So
    K = (1 - d) k A.

    **Arguments:** `stiffness` k in N/m; `mobility` A in 1/kg; `damping`, MuJoCo's B, in 1/s, 0 or above; `impedance` d,
    between 0 and 1, to be written as both `dmin` and `dmax`.
    """
    return -(1 - impedance) * stiffness * mobility, -damping


def friction_damping(impedance: float, step: float) -> float:
    """The damping (1/s) that `solreffriction` needs for friction to halve what slips in each time `step` (s).

    Friction of MuJoCo is a damper up to the limit of its cone: it slows a slip by the rate B / d, d the impedance. The step
    after it that is still stable is 2 / rate. B = d / (2 step).
    """
    return impedance / (2 * step)


def geom_impedance(damping: float, step: float) -> float:
    """The impedance d by which friction has the damping B (1/s) of the normal direction: d = 2 B step.

    A geom, unlike a pair, gives both directions the same. See `friction_damping`.
    """
    return max(2 * damping * step, _LEAST_IMPEDANCE)


def linear_damping(surface: Surface, mobility: float, world: World, least: float = 0.0) -> float:
    """The damping B (1/s) by which a contact point with a linear damper, of the force B r' / A, loses about as much.

    Hunt and Crossley's loss is k c r r', so that B = c w^2 r with w^2 = k A. The depth r is what one point sinks in under
    the whole weight, g / w^2, and on top 4 / (3 pi) of v / w, how deep a bounce at v = 0.1 m/s goes: a linear damper loses
    the share pi B / w of the energy, Hunt and Crossley's 4/3 c v, as long as both are small. B = c (g + 4 v w / (3 pi)).

    **Arguments:** `mobility` A in 1/kg; `least`: the c (s/m) that is taken where the surface's is lower, or none.
    """
    damping = max(least, 0.0 if surface.damping is None else float(surface.damping))
    gravity = 0.0 if world.gravity is None else float(np.linalg.norm(np.asarray(world.gravity)))
    swing = math.sqrt(float(surface.stiffness) * mobility)
    return damping * (gravity + 4 / (3 * math.pi) * _BOUNCE * swing)


def one_mu(surface: Surface) -> float:
    """The mu of breaking away, as one number: the mean where each face has its own."""
    mu: Any = surface.mu if surface.mu_static is None else surface.mu_static
    return float(np.mean(np.asarray(mu, np.float64)))
