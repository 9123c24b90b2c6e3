"""What the gradient and batch measurements share: three fingers that grip a cube on a floor, for hapjax and MuJoCo."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..body import Body
from ..contact import Contact
from ..extras import need
from ..integrate import Integrator, SemiImplicit
from ..scene import Object, Scene, World, cast, dtype_of
from ..shape import Box, Plane
from ..surface import Surface

SIDE, MASS, MU, STIFFNESS = 0.06, 0.2, 0.6, 800.0  # m, kg, 1, N/m
DT = 1e-3  # s
_SPOTS = np.array([[-1.0, 0.3, 1.0], [-1.0, -0.3, 1.0], [1.0, 0.0, 1.0]]) * SIDE / 2  # on the faces -x and +x
PRESS = np.array([2.5, 2.5, 5.0])  # N
_RADIUS = 0.01  # m, of MuJoCo's fingertips


def precision() -> jnp.dtype:
    """The widest numbers that are on."""
    return jnp.dtype(jnp.float64 if jax.config.read("jax_enable_x64") else jnp.float32)


def scene(integrator: Integrator | None = None) -> Scene:
    """A cube of 60 mm and 0.2 kg that stands on a floor."""
    surface = Surface(STIFFNESS, mu=MU, damping=1.0)
    cube = Object(Box((SIDE,) * 3), surface, Body(MASS), position=(0.0, 0.0, SIDE / 2))
    floor = Contact(5000.0, mu=0.5, damping=0.5, between=("cube", "floor"))
    parts = {"cube": cube, "floor": Object(Plane())}
    world = World(gravity=(0.0, 0.0, -9.81), gyroscopic=True)
    method = SemiImplicit(dt=DT) if integrator is None else integrator
    return cast(Scene(parts, {"cube_on_floor": floor}, world=world, integrator=method), precision())


def tilted(tilt: float) -> Float[np.ndarray, "3"]:
    """Gravity, m/s^2, on an incline of `tilt` rad that goes down along y, across the fingers' press."""
    return 9.81 * np.array([0.0, np.sin(tilt), -np.cos(tilt)])


def grip(steps: int, lift: float) -> Float[np.ndarray, "T 3 3"]:
    """Fingers that press with 5 N from both sides, and rise evenly by `lift` m in all."""
    held = _SPOTS - np.sign(_SPOTS) * [1, 0, 0] * (PRESS / STIFFNESS)[:, None]
    return held + np.linspace(0, lift, steps)[:, None, None] * np.array([0.0, 0.0, 1.0])


def raised(grip_scene: Scene, height: float) -> Scene:
    """The scene with its cube `height` m over the floor."""
    up = jnp.array([0.0, 0.0, height], dtype_of(grip_scene))
    return eqx.tree_at(lambda s: s.object["cube"].position, grip_scene, replace_fn=lambda x: x + up)


def mujoco_model(height: float, noslip: int = 0, tilt: float = 0.0) -> tuple[Any, Any]:
    """A like scene for MuJoCo, and its data: a box, `height` m over a plane, and three sphere fingers on slides.

    As it ships, but for the elliptic cone and an impratio of 10, with which held things creep less; with `noslip`
    iterations of its pass against slip; gravity turned by `tilt` rad about x, in which the fingers press.
    """
    mujoco = need("mujoco", "bench")
    model = mujoco.MjModel.from_xml_string(_mujoco_xml(height))
    model.opt.noslip_iterations = noslip
    model.opt.gravity[:] = tilted(tilt)
    data = mujoco.MjData(model)
    data.ctrl[:] = PRESS
    return model, data


def _mujoco_xml(height: float) -> str:
    out = np.sign(_SPOTS[:, 0])
    fingers = "".join(
        f'<body pos="{x + s * _RADIUS} {y} {z + height}" gravcomp="1"><joint name="j{i}" type="slide" axis="{-s} 0 0"/>'
        f'<geom type="sphere" size="{_RADIUS}" mass="0.02"/></body>'
        for i, ((x, y, z), s) in enumerate(zip(_SPOTS, out, strict=True))
    )
    motors = "".join(f'<motor joint="j{i}"/>' for i in range(len(_SPOTS)))
    half = SIDE / 2
    return f"""<mujoco><option timestep="{DT}" gravity="0 0 -9.81" cone="elliptic" impratio="10"/>
    <default><geom friction="{MU} 0.005 0.0001"/></default><worldbody>
    <geom type="plane" size="1 1 0.1"/>
    <body name="cube" pos="0 0 {half + height}"><freejoint/>
    <geom type="box" size="{half} {half} {half}" mass="{MASS}"/></body>{fingers}
    </worldbody><actuator>{motors}</actuator></mujoco>"""
