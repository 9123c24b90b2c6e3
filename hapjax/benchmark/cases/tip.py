"""A cube put down on a corner, which tips over an edge onto a face."""

import numpy as np
from scipy.spatial.transform import Rotation

from ... import rotation
from ...body import Body
from ...contact import Contact
from ...scene import Object, Scene, World
from ...shape import Box, Plane
from ._case import Case, G, Mujoco, Order

MASS, HALF, MU, STIFFNESS, DAMPING, SECONDS = 0.2, 0.03, 0.5, 2000.0, 10.0, 1.4
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


def _lean(state):
    """How far (rad) the cube's lower face is from level."""
    matrix = rotation.to_matrix(state.motion["cube"].orientation)
    return matrix[2, :2]


def _start(model, data) -> None:
    data.qpos[2] = _LOWEST
    data.qpos[3:7] = TILT.as_quat(scalar_first=True)


TIP = Case(
    name="tip",
    title="cube tipped from a corner onto a face",
    unit="m",
    seconds=SECONDS,
    scene=_scene,
    measure=lambda state: state.motion["cube"].position,
    law_measure=_lean,
    law=lambda: np.zeros(2),
    known="extrapolated; law: the face lies level (rad)",
    mujoco=Mujoco(
        f"""<mujoco><option gravity="0 0 {-G}" cone="elliptic" impratio="10"/>
        <default><geom solref="1e-5 1" friction="{MU} 0.005 0.0001"/></default><worldbody>
        <geom type="plane" size="9 9 1"/><body><freejoint/>
        <geom type="box" size="{HALF} {HALF} {HALF}" mass="{MASS}"/></body></worldbody></mujoco>""",
        start=_start,
        read=lambda model, data: data.xmat[1].reshape(3, 3)[2, :2].copy(),
    ),
    orders={
        "lie_midpoint": Order(
            1, "a touch begins with the first step that finds it, at the place where that finds it"
        )
    },
)
