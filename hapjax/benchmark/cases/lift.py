"""A block in fingers: four at the threshold of slipping, sum mu N = m g, and three that hold it while its load grows."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ...body import Body
from ...scene import Object, Scene, World
from ...shape import Box
from ...surface import Surface
from ._case import EXACT, HOLDS, Case, G, Gradient, Mujoco
from ._springs import Held, Place, slope, solve

MASS, MU, STIFFNESS, DAMPING = 0.2, 0.6, 2000.0, 20.0
SIZE = np.array([0.06, 0.06, 0.12])
FOUR = np.array([[x, y, 0] for x in (-1, 1) for y in (-0.02, 0.02)]) * [SIZE[0] / 2, 1, 1]
SPEED, SECONDS = 0.1, 0.3  # m/s, s


def _fingers(spots: np.ndarray, depth) -> np.ndarray:
    """Fingers at `depth` m (one number or one each) inside of points of the faces +x and -x."""
    return spots - np.sign(spots) * [1, 0, 0] * np.broadcast_to(depth, len(spots))[:, None]


def _scene(integrator, surface: Surface, gravity: float = G) -> Scene:
    return Scene(
        {"block": Object(Box(SIZE), surface, Body(MASS))},
        world=World(gravity=(0, 0, -gravity), gyroscopic=True),
        integrator=integrator,
    )


def _depth(share: float) -> float:
    """The depth (m) of each of four fingers at which the weight is `share` of sum mu N."""
    return MASS * G / share / (MU * STIFFNESS * len(FOUR))


def _gripped(share: float, speed: float) -> Mujoco:
    """Fingers that are pushed with a constant force."""
    bodies = "".join(
        f'<body pos="{x + 0.01 * np.sign(x)} {y} {z}"><joint name="j{i}" type="slide" axis="{-np.sign(x)} 0 0"/>'
        '<geom type="sphere" size="0.01" mass="0.02"/></body>'
        for i, (x, y, z) in enumerate(FOUR)
    )
    motors = "".join(f'<motor joint="j{i}"/>' for i in range(len(FOUR)))

    def start(model, data):
        data.qvel[2] = -speed
        data.ctrl[:] = STIFFNESS * _depth(share)

    half = " ".join(str(x / 2) for x in SIZE)
    return Mujoco(
        f"""<mujoco><option gravity="0 0 {-G}" cone="elliptic" impratio="10"/>
        <default><geom solref="1e-5 1" friction="{MU} 0.005 0.0001"/></default><worldbody>
        <body gravcomp="0"><freejoint/><geom type="box" size="{half}" mass="{MASS}"/></body>{bodies}
        </worldbody><actuator>{motors}</actuator></mujoco>""",
        start=start,
        read=lambda model, data: data.qpos[2:3].copy() if speed else data.qvel[:3].copy(),
        holds=not speed,
    )


def _falling(state):
    now = state.motion["block"].velocity
    return eqx.tree_at(lambda s: s.motion["block"].velocity, state, jnp.asarray((0, 0, -SPEED), now.dtype))


def _hips(spots: np.ndarray, depth):
    return lambda t: jnp.asarray(_fingers(spots, depth), t.dtype)


def _surface(scene: Scene) -> Surface:
    surface = scene.object["block"].surface
    assert surface is not None
    return surface


def _mu(scene: Scene):
    return _surface(scene).mu


def _stiffness(scene: Scene):
    return _surface(scene).stiffness


SLIP = Case(
    name="lift_slip",
    title="block slips through four fingers at 1.01 of sum mu N = m g",
    unit="m",
    seconds=SECONDS,
    scene=lambda integrator: _scene(integrator, Surface(STIFFNESS, mu=MU, damping=DAMPING)),
    start=_falling,
    hip=_hips(FOUR, _depth(1.01)),
    measure=lambda state: state.motion["block"].position[2:],
    truth=lambda: np.array([-SPEED * SECONDS - (G - G / 1.01) * SECONDS**2 / 2]),
    known="closed form, a = g - sum mu N / m",
    smooth=True,
    gradient=Gradient(
        "object.block.surface.mu",
        _mu,
        lambda: np.array([G / 1.01 / MU * SECONDS**2 / 2]),
    ),
    mujoco=_gripped(1.01, SPEED),
    orders=EXACT,
)

HOLD = Case(
    name="lift_hold",
    title="block held by four fingers at 0.99 of sum mu N = m g: creep",
    unit="m/s",
    seconds=1.5,
    scene=lambda integrator: _scene(integrator, Surface(STIFFNESS, mu=MU, damping=DAMPING)),
    hip=_hips(FOUR, _depth(0.99)),
    measure=lambda state: state.motion["block"].velocity,
    truth=lambda: np.zeros(3),
    known="closed form, at rest",
    mujoco=_gripped(0.99, 0.0),
    orders=HOLDS,
)

# A step in load ---------------------------------------------------------------------------------------------

THREE = np.array([[-1, 0.02, 0], [-1, -0.02, 0], [1, 0, 0]]) * [SIZE[0] / 2, 1, 1]
PRESS = np.array([4e-3, 4e-3, 8e-3])  # m: the third finger holds against the other two
YIELDING, HEAVIER, TIME = 400.0, 1.5, 0.3  # N/m, times g from half time on, s


def _loaded(stiffness) -> np.ndarray:
    fingers = _fingers(THREE, PRESS)
    inertia = MASS * (np.sum(SIZE**2) - SIZE**2) / 12
    place = Place(np.zeros(3), np.eye(3), np.zeros(3), np.zeros(3))
    for load in (1.0, HEAVIER):
        held = Held(MASS, inertia, THREE, stiffness, lambda t: fingers, np.array([0, 0, -load * G]))
        place = solve(held, place, TIME / 2)
    return place.position


def _heavier(scene: Scene) -> Scene:
    gravity = scene.world.gravity
    assert gravity is not None
    return dataclasses.replace(
        scene, world=dataclasses.replace(scene.world, gravity=jnp.asarray(HEAVIER, gravity.dtype) * gravity)
    )


def _springs() -> str:
    pairs = list(zip(_fingers(THREE, PRESS), THREE, strict=True))
    place = "".join(f'<site name="f{i}" pos="{f[0]} {f[1]} {f[2]}"/>' for i, (f, _) in enumerate(pairs))
    own = "".join(f'<site name="g{i}" pos="{g[0]} {g[1]} {g[2]}"/>' for i, (_, g) in enumerate(pairs))
    springs = "".join(
        f'<spatial stiffness="{YIELDING}" springlength="0"><site site="f{i}"/><site site="g{i}"/></spatial>'
        for i in range(3)
    )
    half = " ".join(str(x / 2) for x in SIZE)
    return f"""<mujoco><option gravity="0 0 {-G}"/><worldbody>{place}<body><freejoint/>
    <geom type="box" size="{half}" mass="{MASS}"/>{own}</body></worldbody><tendon>{springs}</tendon></mujoco>"""


LOAD_STEP = Case(
    name="load_step",
    title="block held by three fingers, its load growing by half",
    unit="m",
    seconds=TIME,
    scene=lambda integrator: _scene(integrator, Surface(YIELDING, mu=5.0)),
    hip=_hips(THREE, PRESS),
    change=_heavier,
    measure=lambda state: state.motion["block"].position,
    truth=lambda: _loaded(YIELDING),
    known="independent equations, SciPy's DOP853 at 1e-12",
    smooth=True,
    gradient=Gradient("object.block.surface.stiffness", _stiffness, lambda: slope(_loaded, YIELDING)),
    mujoco=Mujoco(
        _springs(),
        read=lambda model, data: data.qpos[:3].copy(),
        change=lambda model: model.opt.gravity.__setitem__(2, -HEAVIER * G),
    ),
)
