"""A block on a plane: slides to a stop, holds and slides on an incline, is pushed across the diagonal."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ...body import Body
from ...contact import Contact
from ...scene import Object, Scene, World
from ...shape import Box, Plane
from ._case import EXACT, HOLDS, Case, G, Gradient, Mujoco

MASS, HALF, MU, DAMPING = 0.2, 0.03, 0.5, 20.0
# With this damping and speed the pull is past the cone from the first moment on, so that the law holds exactly.


def block(integrator, stiffness: float, gravity) -> Scene:
    """A block that does not turn, on four corners of `stiffness` N/m each, at its resting depth."""
    depth = MASS * -gravity[2] / (4 * stiffness)
    thing = Object(Box((2 * HALF,) * 3), None, Body(MASS, rotation=False), (0, 0, HALF - depth))
    pair = Contact(stiffness, mu=MU, damping=DAMPING, between=("block", "floor"))
    return Scene(
        {"block": thing, "floor": Object(Plane())},
        {"block_on_floor": pair},
        world=World(gravity=gravity),
        integrator=integrator,
    )


def _mujoco(gravity, velocity, read, holds: bool = False) -> Mujoco:
    """The same block; contacts as stiff as MuJoCo allows (twice the time step) on elliptic cones."""
    x, y, z = gravity

    def start(model, data):
        data.qvel[:3] = velocity

    return Mujoco(
        f"""<mujoco><option gravity="{x} {y} {z}" cone="elliptic" impratio="10"/>
        <default><geom solref="1e-5 1" friction="{MU} 0.005 0.0001"/></default><worldbody>
        <geom type="plane" size="9 9 1"/><body pos="0 0 {HALF}">
        <joint type="slide" axis="1 0 0"/><joint type="slide" axis="0 1 0"/><joint type="slide" axis="0 0 1"/>
        <geom type="box" size="{HALF} {HALF} {HALF}" mass="{MASS}"/></body></worldbody></mujoco>""",
        start=start,
        read=read,
        holds=holds,
    )


def _pushed(velocity):
    def start(state):
        now = state.motion["block"].velocity
        return eqx.tree_at(lambda s: s.motion["block"].velocity, state, jnp.asarray(velocity, now.dtype))

    return start


def _place(state):
    return state.motion["block"].position[:2]


def _mu(scene):
    return scene.contact["block_on_floor"].mu


STIFF = 2.5e5
STOP = 1.0 / (2 * MU * G)  # m, from 1 m/s
SPRING_BACK = MASS * G / (4 * STIFF)  # times mu, m: what the tangential springs take back after the stop


def _rigid(scene: Scene, dt: float) -> Scene:
    """dt omega = 1, half of what an explicit step bears; and the resting depth that belongs to it."""
    return block(scene.integrator, MASS / (4 * dt**2), (0, 0, -G))


SLIDE = Case(
    name="slide",
    title="block slides from 1 m/s to a stop",
    unit="m",
    seconds=0.5,
    scene=lambda integrator: block(integrator, STIFF, (0, 0, -G)),
    start=_pushed((1, 0, 0)),
    measure=_place,
    truth=lambda: np.array([STOP - MU * SPRING_BACK, 0]),
    law=lambda: np.array([STOP, 0]),
    rigid=_rigid,
    known="closed form, v^2 / (2 mu g), less mu m g / k by which the springs relax",
    gradient=Gradient("contact.block_on_floor.mu", _mu, lambda: np.array([-STOP / MU - SPRING_BACK, 0])),
    mujoco=_mujoco((0, 0, -G), (1, 0, 0), lambda model, data: data.qpos[:2].copy()),
)

SOFT, SPEED, LENGTH = 5000.0, 0.1, 0.5  # N/m, m/s, s


def _incline(share: float, angle: float = 0.0) -> tuple[float, float, float]:
    """Gravity in the frame of an incline whose slope is `share` of mu, downhill at `angle` rad from x."""
    slope = np.arctan(share * MU)
    downhill = G * np.sin(slope)
    return (float(downhill * np.cos(angle)), float(downhill * np.sin(angle)), float(-G * np.cos(slope)))


def _slid(angle: float = 0.0) -> np.ndarray:
    """Where a block is that slid for LENGTH s at 1.01 of the cone: a = g (sin - mu cos)."""
    x, y, z = _incline(1.01, angle)
    distance = SPEED * LENGTH + (np.hypot(x, y) + MU * z) * LENGTH**2 / 2
    return distance * np.array([np.cos(angle), np.sin(angle)])


def _slid_per_mu(angle: float = 0.0) -> np.ndarray:
    return _incline(1.01, angle)[2] * LENGTH**2 / 2 * np.array([np.cos(angle), np.sin(angle)])


INCLINE_HOLD = Case(
    name="incline_hold",
    title="block on an incline at 0.99 of the cone: creep",
    unit="m/s",
    seconds=1.0,
    scene=lambda integrator: block(integrator, SOFT, _incline(0.99)),
    measure=lambda state: state.motion["block"].velocity[:2],
    truth=lambda: np.zeros(2),
    known="closed form, at rest",
    mujoco=_mujoco(_incline(0.99), (0, 0, 0), lambda model, data: data.qvel[:2].copy(), holds=True),
    orders=HOLDS,
)

INCLINE_SLIDE = Case(
    name="incline_slide",
    title="block slides down an incline at 1.01 of the cone",
    unit="m",
    seconds=LENGTH,
    scene=lambda integrator: block(integrator, SOFT, _incline(1.01)),
    start=_pushed((SPEED, 0, 0)),
    measure=_place,
    truth=_slid,
    known="closed form, a = g (sin - mu cos)",
    smooth=True,
    gradient=Gradient("contact.block_on_floor.mu", _mu, _slid_per_mu),
    mujoco=_mujoco(_incline(1.01), (SPEED, 0, 0), lambda model, data: data.qpos[:2].copy()),
    orders=EXACT,
)

_ACROSS = np.pi / 6
_ALONG = (SPEED * np.cos(_ACROSS), SPEED * np.sin(_ACROSS), 0.0)

DIAGONAL = Case(
    name="diagonal",
    title="block pushed at 30 degrees to its edges: isotropy of the cone",
    unit="m",
    seconds=LENGTH,
    scene=lambda integrator: block(integrator, SOFT, _incline(1.01, _ACROSS)),
    start=_pushed(_ALONG),
    measure=_place,
    truth=lambda: _slid(_ACROSS),
    known="closed form, a = g (sin - mu cos) along the push",
    smooth=True,
    gradient=Gradient("contact.block_on_floor.mu", _mu, lambda: _slid_per_mu(_ACROSS)),
    mujoco=_mujoco(_incline(1.01, _ACROSS), _ALONG, lambda model, data: data.qpos[:2].copy()),
    orders=EXACT,
)
