"""A rod held at one end by two fingers: swung by the hand, and dropping as far as the grip lets it."""

import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

from ...body import Body
from ...scene import Object, Scene, World
from ...shape import Box
from ...surface import Surface
from ...torsion import GravityDrop
from ._case import Case, G, Gradient, Mujoco
from ._springs import Held, Place, slope, solve

MASS, LENGTH, WIDTH, STIFFNESS, MU, DEPTH = 0.05, 0.3, 0.02, 1000.0, 1.0, 3e-3
GRASP = -0.14  # m, from the rod's middle along it
REACH, BEAT, SECONDS = 0.01, 2 * np.pi * 1.2, 0.5  # m and rad/s of the hand
SIZE = np.array([LENGTH, WIDTH, WIDTH])
INERTIA = MASS * (np.sum(SIZE**2) - SIZE**2) / 12
_HOLD = np.array([[GRASP, side * (WIDTH / 2 - DEPTH), 0.0] for side in (1, -1)])
_ANCHORS = np.array([[GRASP, side * WIDTH / 2, 0.0] for side in (1, -1)])
_FREE = Place(np.zeros(3), np.eye(3), np.zeros(3), np.zeros(3))
_DOWN = np.array([0, 0, -G])


def _rod(integrator, torsion=None) -> Scene:
    return Scene(
        {"rod": Object(Box(SIZE), Surface(STIFFNESS, mu=MU), Body(MASS))},
        torsion=torsion,
        world=World(gravity=_DOWN, gyroscopic=True),
        integrator=integrator,
    )


def _place(state):
    return state.motion["rod"].position


def _hand(t, cos):
    """How far (m) the hand has gone; it starts from rest."""
    return REACH * (1 - cos(BEAT * t))


def _swung(up=-G) -> np.ndarray:
    held = Held(
        MASS,
        INERTIA,
        _ANCHORS,
        STIFFNESS,
        lambda t: _HOLD + np.array([_hand(t, np.cos), 0, 0]),
        np.array([0, 0, up]),
    )
    return solve(held, _FREE, SECONDS).position


def _gravity(scene: Scene):
    assert scene.world.gravity is not None
    return scene.world.gravity


def _hips(t):
    return jnp.asarray(_HOLD, t.dtype) + jnp.stack([_hand(t, jnp.cos), 0 * t, 0 * t])[None]


def _path(times: np.ndarray) -> np.ndarray:
    return np.stack([_hand(times, np.cos), 0 * times, 0 * times], axis=1)


_SITES = "".join(f'<site name="f{i}" pos="{x} {y} {z}"/>' for i, (x, y, z) in enumerate(_HOLD))
_POINTS = "".join(f'<site name="g{i}" pos="{x} {y} {z}"/>' for i, (x, y, z) in enumerate(_ANCHORS))
_SPRINGS = "".join(
    f'<spatial stiffness="{STIFFNESS}" springlength="0"><site site="f{i}"/><site site="g{i}"/></spatial>'
    for i in range(2)
)

ROD = Case(
    name="rod",
    title="rod held at one end by two fingers and swung",
    unit="m",
    seconds=SECONDS,
    scene=_rod,
    hip=_hips,
    measure=_place,
    truth=_swung,
    known="independent equations, SciPy's DOP853 at 1e-12",
    smooth=True,
    # Of the swing of the rod as a whole: mass and stiffness change that of the grip's springs alone, by hundreds of radians.
    gradient=Gradient("world.gravity[2]", _gravity, lambda: slope(_swung, -G), along=(0, 0, 1)),
    mujoco=Mujoco(
        f"""<mujoco><option gravity="0 0 {-G}"/><worldbody><body mocap="true">{_SITES}</body><body><freejoint/>
        <inertial pos="0 0 0" mass="{MASS}" diaginertia="{INERTIA[0]} {INERTIA[1]} {INERTIA[2]}"/>{_POINTS}</body>
        </worldbody><tendon>{_SPRINGS}</tendon></mujoco>""",
        read=lambda model, data: data.qpos[:3].copy(),
        path=_path,
    ),
)

# The same rod, gripped softly: gravity drop ------------------------------------------------------------------

SHARE, LOSS, TIME = 0.5, 2e-4, 0.35  # of the torque about the grip's line; N m s/rad; s
CRITICAL = np.pi * (MU * DEPTH) ** 2 / (1 - SHARE)  # m^2


def _dropped(loss) -> np.ndarray:
    held = Held(
        MASS, INERTIA, _ANCHORS, STIFFNESS, lambda t: _HOLD, _DOWN, np.array([0.0, 1.0, 0.0]), SHARE, loss
    )
    return solve(held, _FREE, TIME).position


def pendulum(share: float = SHARE) -> np.ndarray:
    """The place of the rod's centre on stiff fingers: (J + s m r^2) w' = s m g r cos(angle) - b w."""
    inertia, reach = INERTIA[1] + share * MASS * GRASP**2, -GRASP

    def rate(t, y):
        return [y[1], (share * MASS * G * reach * np.cos(y[0]) - LOSS * y[1]) / inertia]

    angle = solve_ivp(rate, (0, TIME), [0, 0], method="DOP853", rtol=1e-12, atol=1e-13).y[0, -1]
    return np.array([GRASP + reach * np.cos(angle), 0, -reach * np.sin(angle)])


def _twist_damping(scene: Scene):
    assert isinstance(scene.torsion, GravityDrop)
    return scene.torsion.twist_damping


PENDULUM = Case(
    name="pendulum",
    title="gravity drop: a rod in a soft grip at half of A_crit",
    unit="m",
    seconds=TIME,
    scene=lambda integrator: _rod(integrator, GravityDrop(CRITICAL, twist_damping=LOSS)),
    hip=lambda t: jnp.asarray(_HOLD, t.dtype),
    measure=_place,
    truth=lambda: _dropped(LOSS),
    law=pendulum,
    known="independent equations, SciPy's DOP853 at 1e-12; law: a pendulum about stiff fingers",
    smooth=True,
    gradient=Gradient("torsion.twist_damping", _twist_damping, lambda: slope(_dropped, LOSS)),
    mujoco="it has no contact area that takes a share of the torque",
)
