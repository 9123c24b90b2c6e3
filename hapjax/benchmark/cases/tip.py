"""A cube put down on a corner, which tips over an edge onto a face."""

import numpy as np
from scipy.spatial.transform import Rotation

from ...body import Body
from ...contact import Contact
from ...scene import Object, Scene, World
from ...shape import Box, Plane
from ._case import Case, G, Order

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
    mujoco="its impacts lose energy by another law, and where the cube comes to lie depends on that",
    orders={
        "lie_midpoint": Order(
            1, "a touch begins with the first step that finds it, at the place where that finds it"
        )
    },
)
