"""A cube put down on a corner, which tips over an edge onto a face, and lies there."""

import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from ... import rotation
from ...body import Body
from ...contact import Contact
from ...exchange.softness import mujoco_solref
from ...scene import Object, Scene, World
from ...shape import Box, Plane
from ._case import HOLDS, Case, G, Mujoco, Order

MASS, HALF, MU, STIFFNESS, DAMPING, SECONDS = 0.2, 0.03, 0.5, 2000.0, 10.0, 0.5
TILT = Rotation.from_euler("xyz", [30, 25, 0], degrees=True)
_LOWEST = float(
    -np.min(TILT.apply(HALF * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]))[:, 2])
)


def _scene(integrator) -> Scene:
    return Scene(
        {
            "cube": Object(
                Box((2 * HALF,) * 3),
                None,
                Body(MASS),
                (0, 0, _LOWEST),
                TILT.as_quat(scalar_first=True),
            ),
            "floor": Object(Plane()),
        },
        {"cube_on_floor": Contact(STIFFNESS, mu=MU, damping=DAMPING, between=("cube", "floor"))},
        world=World(gravity=(0, 0, -G), gyroscopic=True),
        integrator=integrator,
    )


TIP = Case(
    name="tip",
    title="cube tipped from a corner onto a face",
    unit="m",
    seconds=SECONDS,
    scene=_scene,
    measure=lambda state: state.motion["cube"].position,
    known="extrapolated",
    lands=True,
    mujoco="its impacts lose energy by another law, and where the cube comes to lie depends on that; tip_rest runs there",
    orders={
        "lie_midpoint": Order(
            1, "a touch begins with the first step that finds it, at the place where that finds it"
        )
    },
)

# How it lies: the same whatever law its impacts lose energy by --------------------------------------------------

LATER, IMPEDANCE, LOSS = 1.5, 0.5, 100.0  # s; MuJoCo's impedance and damping, 1/s
# Its stiffness is one over a mass, as in the case of the ball at rest, here that of a corner.
_SOLREF = mujoco_solref(STIFFNESS, 1 / MASS, LOSS, IMPEDANCE)
_TURN = " ".join(str(x) for x in TILT.as_quat(scalar_first=True))


def _lies(state):
    """Height of the centre, and how far along the vertical the centres of three faces are from it (m)."""
    motion = state.motion["cube"]
    return jnp.concatenate([motion.position[2:], HALF * rotation.to_matrix(motion.orientation)[2]])


TIP_REST = Case(
    name="tip_rest",
    title="cube tipped from a corner: how deep and how flat it lies on its face",
    unit="m",
    seconds=LATER,
    scene=_scene,
    measure=_lies,
    truth=lambda: np.array([HALF - MASS * G / (4 * STIFFNESS), 0, 0, HALF]),
    known="closed form, flat on four corners that yield by m g / 4 k",
    mujoco=Mujoco(
        f"""<mujoco><option gravity="0 0 {-G}" cone="elliptic" impratio="10"/><default>
        <geom solref="{_SOLREF[0]} {_SOLREF[1]}" solimp="{IMPEDANCE} {IMPEDANCE} 1 0.5 1"
        friction="{MU} 0.005 0.0001"/></default><worldbody><geom type="plane" size="9 9 1"/>
        <body pos="0 0 {_LOWEST}" quat="{_TURN}"><freejoint/>
        <geom type="box" size="{HALF} {HALF} {HALF}" mass="{MASS}"/></body></worldbody></mujoco>""",
        read=lambda model, data: np.concatenate([data.qpos[2:3], HALF * data.xmat[1].reshape(3, 3)[2]]),
    ),
    orders=HOLDS,
)
