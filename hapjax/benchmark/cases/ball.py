"""A ball on a floor: from slide to roll, one bounce with loss, three without, and at rest."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy.optimize import brentq

from ...body import Body
from ...contact import Contact
from ...exchange.softness import mujoco_solref
from ...scene import Object, Scene, World
from ...shape import Plane, Sphere
from ._case import HOLDS, Case, G, Gradient, Mujoco, Order


def ball(integrator, mass, radius, contact: Contact, gravity: bool, height: float, rotation=False) -> Scene:
    """A ball whose lowest point is at `height` m over a floor."""
    return Scene(
        {
            "ball": Object(Sphere(radius), None, Body(mass, rotation=rotation), (0, 0, radius + height)),
            "floor": Object(Plane()),
        },
        {"ball_on_floor": contact},
        world=World(gravity=(0, 0, -G) if gravity else None),
        integrator=integrator,
    )


def _pair(stiffness, **numbers) -> Contact:
    return Contact(stiffness, between=("ball", "floor"), **numbers)


def _thrown(velocity):
    def start(state):
        now = state.motion["ball"].velocity
        return eqx.tree_at(lambda s: s.motion["ball"].velocity, state, jnp.asarray(velocity, now.dtype))

    return start


# Slide to roll ------------------------------------------------------------------------------------------------

MU, STIFF, ROLL = 0.5, 2e5, 0.3
MASS, RADIUS = 0.2, 0.03
_SAG = MASS * G / STIFF


def _rolling(integrator, stiffness: float) -> Scene:
    pair = _pair(stiffness, mu=MU, damping=20.0)
    return ball(integrator, MASS, RADIUS, pair, True, -MASS * G / stiffness, rotation=True)


SLIDE_TO_ROLL = Case(
    name="roll",
    title="ball from slide at 1 m/s to roll at 5/7 m/s",
    unit="m",
    seconds=ROLL,
    scene=lambda integrator: _rolling(integrator, STIFF),
    rigid=lambda scene, dt: _rolling(scene.integrator, 2 / 7 * MASS / dt**2),  # dt omega = 1 along the floor
    start=_thrown((1, 0, 0)),
    measure=lambda state: state.motion["ball"].position[:2],
    truth=lambda: np.array([5 / 7 * ROLL + 2 / (49 * MU * G) - 2 / 7 * MU * _SAG, 0]),
    law=lambda: np.array([5 / 7 * ROLL + 2 / (49 * MU * G), 0]),
    known="closed form, 5v/7 from 2v/(7 mu g) on, less 2/7 mu m g / k by which the spring relaxes",
    gradient=Gradient(
        "contact.ball_on_floor.mu",
        lambda scene: scene.contact["ball_on_floor"].mu,
        lambda: np.array([-2 / (49 * MU**2 * G) - 2 / 7 * _SAG, 0]),
    ),
    mujoco=Mujoco(
        f"""<mujoco><option gravity="0 0 {-G}" cone="elliptic" impratio="10"/>
        <default><geom solref="1e-5 1" friction="{MU} 0 0"/></default><worldbody>
        <geom type="plane" size="9 9 1"/><body pos="0 0 {RADIUS}"><freejoint/>
        <geom type="sphere" size="{RADIUS}" mass="{MASS}"/></body></worldbody></mujoco>""",
        start=lambda model, data: data.qvel.__setitem__(0, 1.0),
        read=lambda model, data: data.qpos[:2].copy(),
    ),
)

# One bounce with Hunt and Crossley's loss ----------------------------------------------------------------------

LOSS, LIGHT, SPRING = 1.0, 0.05, 500.0


def rebound(loss: float, speed: float = 1.0) -> float:
    """The speed after: c v - ln(1 + c v) = -c u - ln(1 - c u) (Hunt and Crossley 1975)."""
    left = loss * speed - np.log1p(loss * speed)
    highest = min(speed, (1 - 1e-15) / loss)
    return float(brentq(lambda u: -loss * u - np.log1p(-loss * u) - left, 0, highest, xtol=1e-15))  # pyright: ignore


def rebound_per_loss(loss: float, speed: float = 1.0) -> float:
    """The derivative of `rebound` in c, from its equation."""
    after = rebound(loss, speed)
    # d/dc of the left side less the right side, over the right side's slope in the speed after.
    by_loss = speed - speed / (1 + loss * speed) + after - after / (1 - loss * after)
    return by_loss / (loss / (1 - loss * after) - loss)


# Where the loss reads the speed half a step late, 1 + c v becomes (1 + c v) (1 + c k d dt / (2 m)): a stiffer spring, on
# which the rebound does not depend.
_LATE = Order(2, "the late loss acts as a stiffer spring, and no spring changes the rebound")

RESTITUTION = Case(
    name="restitution",
    title="ball bounces with Hunt and Crossley's loss, no gravity",
    unit="m/s",
    seconds=0.06,
    scene=lambda integrator: ball(
        integrator, LIGHT, RADIUS, _pair(SPRING, mu=0.5, damping=LOSS), False, 0.01
    ),
    start=_thrown((0, 0, -1)),
    measure=lambda state: state.motion["ball"].velocity[2:],
    truth=lambda: np.array([rebound(LOSS)]),
    known="closed form, c v - ln(1 + c v) = -c u - ln(1 - c u)",
    gradient=Gradient(
        "contact.ball_on_floor.damping",
        lambda scene: scene.contact["ball_on_floor"].damping,
        lambda: np.array([rebound_per_loss(LOSS)]),
    ),
    mujoco="its contacts have no loss that grows with the depth",
    orders={name: _LATE for name in ("semi_implicit", "semi_implicit_matrix", "pivot")},
)

# Three bounces without loss ------------------------------------------------------------------------------------

DROP, BOUNCES, AIR = 0.05, 3, 0.66  # m, 1, s


def contact_time(stiffness: float) -> float:
    """How long (s) the ball stays on its spring."""
    omega = np.sqrt(stiffness / LIGHT)
    return 2 * (np.pi - np.arctan(np.sqrt(2 * G * DROP) * omega / G)) / omega


def _since(stiffness: float) -> float:
    """s since the last of the bounces ended."""
    speed = np.sqrt(2 * G * DROP)
    return AIR - speed / G - (BOUNCES - 1) * 2 * speed / G - BOUNCES * contact_time(stiffness)


def bounced() -> np.ndarray:
    """Height (m) of the ball's lowest point at the end."""
    t = _since(SPRING)
    return np.array([np.sqrt(2 * G * DROP) * t - G * t**2 / 2])


def bounced_per_stiffness() -> np.ndarray:
    """Its derivative in the stiffness."""
    omega, speed = np.sqrt(SPRING / LIGHT), np.sqrt(2 * G * DROP)
    slope = speed / G / (1 + (speed * omega / G) ** 2)  # of arctan, in omega
    by_omega = -2 * slope / omega - contact_time(SPRING) / omega
    by_stiffness = by_omega * omega / (2 * SPRING)
    return np.array([-(speed - G * _since(SPRING)) * BOUNCES * by_stiffness])


BOUNCE = Case(
    name="bounces",
    title="ball after its third bounce: time of the n-th bounce",
    unit="m",
    seconds=AIR,
    scene=lambda integrator: ball(integrator, LIGHT, RADIUS, _pair(SPRING, mu=0.5), True, DROP),
    measure=lambda state: state.motion["ball"].position[2:] - RADIUS,
    truth=bounced,
    known="closed form, parabolas and half waves",
    gradient=Gradient(
        "contact.ball_on_floor.stiffness",
        lambda scene: scene.contact["ball_on_floor"].stiffness,
        bounced_per_stiffness,
    ),
    mujoco=Mujoco(
        f"""<mujoco><option gravity="0 0 {-G}"/><worldbody><body><joint name="z" type="slide" axis="0 0 1"/>
        <geom type="sphere" size="{RADIUS}" mass="{LIGHT}" contype="0" conaffinity="0"/></body></worldbody>
        <tendon><fixed stiffness="{SPRING}" springlength="0 9"><joint joint="z" coef="1"/></fixed></tendon></mujoco>""",
        start=lambda model, data: data.qpos.__setitem__(0, DROP),
        read=lambda model, data: data.qpos[:1].copy(),
    ),
)

# At rest -------------------------------------------------------------------------------------------------------

YIELDING, IMPEDANCE = 2000.0, 0.5
_SOLREF = mujoco_solref(YIELDING, 1 / MASS, 100.0, IMPEDANCE)

SINK = Case(
    name="sink",
    title="ball at rest: static penetration m g / k",
    unit="m",
    seconds=0.5,
    scene=lambda integrator: ball(integrator, MASS, RADIUS, _pair(YIELDING, mu=0.5, damping=20.0), True, 0.0),
    measure=lambda state: RADIUS - state.motion["ball"].position[2:],
    truth=lambda: np.array([MASS * G / YIELDING]),
    known="closed form, m g / k",
    gradient=Gradient(
        "contact.ball_on_floor.stiffness",
        lambda scene: scene.contact["ball_on_floor"].stiffness,
        lambda: np.array([-MASS * G / YIELDING**2]),
    ),
    mujoco=Mujoco(
        # At rest MuJoCo's depth is (1 - impedance) g / stiffness, its stiffness being one over a mass.
        f"""<mujoco><option gravity="0 0 {-G}"/><default>
        <geom solref="{_SOLREF[0]} {_SOLREF[1]}" solimp="{IMPEDANCE} {IMPEDANCE} 1 0.5 1"/>
        </default><worldbody><geom type="plane" size="9 9 1"/><body pos="0 0 {RADIUS}">
        <joint type="slide" axis="0 0 1"/><geom type="sphere" size="{RADIUS}" mass="{MASS}"/></body></worldbody></mujoco>""",
        read=lambda model, data: -data.qpos[:1],
    ),
    orders=HOLDS,
)
