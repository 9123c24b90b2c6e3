"""A disc that slides and spins between two fingertips: friction, its torque, and the share that A_crit leaves of it."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

from ...body import Body
from ...scene import Object, Scene, World
from ...shape import Cylinder
from ...surface import Surface
from ...torsion import GravityDrop
from ._case import Case, Gradient, Order

MASS, RADIUS, THICK = 0.1, 0.05, 0.02
STIFFNESS, MU, DAMPING, DEPTH = 2000.0, 0.5, 20.0, 5e-4
SHARE, LOSS, SPEED, SPIN, SECONDS = 0.5, 1e-4, 0.4, 20.0, 0.03
CRITICAL = np.pi * (MU * DEPTH) ** 2 / (1 - SHARE)
NORMAL = STIFFNESS * DEPTH
_FINGERS = np.array([[0, 0, side * (THICK / 2 - DEPTH)] for side in (1, -1)])


def _scene(integrator) -> Scene:
    return Scene(
        {"disc": Object(Cylinder(RADIUS, THICK), Surface(STIFFNESS, mu=MU, damping=DAMPING), Body(MASS))},
        torsion=GravityDrop(CRITICAL, twist_damping=LOSS),
        world=World(gyroscopic=True),
        integrator=integrator,
    )


def _start(state):
    motion = state.motion["disc"]
    dtype = motion.velocity.dtype
    return eqx.tree_at(
        lambda s: (s.motion["disc"].velocity, s.motion["disc"].spin),
        state,
        (jnp.asarray((SPEED, 0, 0), dtype), jnp.asarray((0, 0, SPIN), dtype)),
    )


def slid(stiffness: float | None = STIFFNESS, mass: float = MASS) -> np.ndarray:
    """Place (m, in the plane) and RADIUS times the turn (rad) at the end, from equations in the plane.

    With `stiffness` the friction of a finger pulls by spring and damper, and the spring's stretch is projected onto the
    friction circle; `None`: Coulomb's law, against the slip.
    """
    limit, inertia = MU * NORMAL, mass * RADIUS**2 / 2

    def friction(slip, stretch):
        """Force of the fingers on the disc (one finger's), and the rate of the stretch."""
        if stiffness is None:
            return -limit * slip / np.hypot(*slip), 0 * slip
        pull = stiffness * stretch - DAMPING * NORMAL * slip
        size, rate = np.hypot(*pull), -slip
        if stiffness * np.hypot(*stretch) >= limit and rate @ stretch > 0:
            rate = rate - (rate @ stretch) / (stretch @ stretch) * stretch
        return pull * min(1, limit / size), rate

    def rate(t, y):
        x, v, w, stretch = y[:2], y[2:4], y[5], y[6:]
        arm = -x  # the fingers stand at the origin
        # The stretch is that of the disc's material against the finger, in the disc's turning frame.
        slip = v + w * np.array([-arm[1], arm[0]])
        force, stretching = friction(slip, stretch)
        turned = w * np.array([-stretch[1], stretch[0]])
        torque = SHARE * 2 * (arm[0] * force[1] - arm[1] * force[0]) - LOSS * w
        return np.concatenate([v, 2 * force / mass, [w, torque / inertia], stretching + turned])

    start = np.array([0, 0, SPEED, 0, 0, SPIN, 0, 0])
    short = np.inf if stiffness is None else 1e-5  # s, for the moment at which the stretch reaches the circle
    ended = solve_ivp(rate, (0, SECONDS), start, "DOP853", rtol=1e-11, atol=1e-13, max_step=short).y[:, -1]
    return np.array([ended[0], ended[1], RADIUS * ended[4]])


def _slid_per_mass() -> np.ndarray:
    """The derivative in the mass, by differences of fourth order."""
    step = 3e-3 * MASS
    ends = {n: slid(mass=MASS + n * step) for n in (-2, -1, 1, 2)}
    return (8 * (ends[1] - ends[-1]) - (ends[2] - ends[-2])) / (12 * step)


def _mass(scene: Scene):
    body = scene.object["disc"].body
    assert body is not None
    return body.mass


def _measure(state):
    motion = state.motion["disc"]
    turn = 2 * jnp.arctan2(motion.orientation[3], motion.orientation[0])
    return jnp.concatenate([motion.position[:2], (RADIUS * turn)[None]])


DISC = Case(
    name="disc",
    title="disc that slides and spins between two fingertips at half of A_crit",
    unit="m",
    seconds=SECONDS,
    scene=_scene,
    start=_start,
    hip=lambda t: jnp.asarray(_FINGERS, t.dtype),
    measure=_measure,
    truth=slid,
    law=lambda: slid(None),
    known="independent equations in the plane, SciPy's DOP853; law: Coulomb's, no springs",
    gradient=Gradient("object.disc.body.mass", _mass, _slid_per_mass),
    mujoco="it has no contact area that takes a share of the torque",
    orders={
        "lie_midpoint": Order(
            1,
            "the slip turns, and dragging the god-object to the circle's edge once a step is of first order",
        )
    },
)
