"""Tops: a free one about its middle axis, and a heavy one that spins on a finger."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy.integrate import quad
from scipy.spatial.transform import Rotation
from scipy.special import ellipj, ellipkinc

from ...body import Body
from ...scene import Object, Scene, World
from ...shape import Box
from ...surface import Surface
from ._case import Case, G, Gradient, Mujoco, turned, turned_mujoco
from ._springs import Held, Place, slope, solve

INERTIA, SPIN, SECONDS = np.array([1e-4, 2e-4, 3e-4]), np.array([0.5, 6.0, 0.3]), 2.0


def free_truth(inertia=INERTIA, spin=SPIN, seconds: float = SECONDS) -> np.ndarray:
    """The matrix of a free body after `seconds` s from the identity, for I1 < I2 < I3 and L^2 > 2 E I2.

    The spin is Jacobi's elliptic functions of time; the angle about the angular momentum is a quadrature (Landau and
    Lifshitz, Mechanics, section 37).
    """
    a, b, c = inertia
    twice_energy, square = np.sum(inertia * spin**2), np.sum((inertia * spin) ** 2)
    size, high, low = np.sqrt(square), twice_energy * c - square, square - twice_energy * a
    amplitudes = np.sqrt([high / (a * (c - a)), high / (b * (c - b)), low / (c * (c - a))])
    rate = np.sqrt((c - b) * low / (a * b * c))
    modulus = (b - a) * high / ((c - b) * low)
    phase = ellipkinc(np.arctan2(spin[1] / amplitudes[1], spin[0] / amplitudes[0]), modulus)

    def momentum(t):
        sn, cn, dn, _ = ellipj(phase + rate * t, modulus)
        return inertia * amplitudes * np.array([cn, sn, dn])

    def precession(t):
        x, y, _ = momentum(t)
        return size * (x**2 / a + y**2 / b) / (x**2 + y**2)

    def tilt(t):
        x, y, z = momentum(t)
        return Rotation.from_euler("ZXZ", [0, np.arccos(z / size), np.arctan2(x, y)])

    pieces = np.linspace(0, seconds, 41)
    angle = sum(
        quad(precession, i, j, epsabs=1e-13, epsrel=1e-13)[0]
        for i, j in zip(pieces[:-1], pieces[1:], strict=True)
    )
    return (tilt(0).inv() * Rotation.from_euler("Z", angle) * tilt(seconds)).as_matrix()


def _free_per_inertia() -> np.ndarray:
    """The derivative in the least moment of inertia."""

    def turned_by(least):
        free = Held(
            1.0,
            np.array([least, *INERTIA[1:]]),
            np.zeros((1, 3)),
            0.0,
            lambda t: np.zeros((1, 3)),
            np.zeros(3),
        )
        return solve(
            free, Place(np.zeros(3), np.eye(3), np.zeros(3), SPIN), SECONDS
        ).matrix.ravel() / np.sqrt(2)

    return slope(turned_by, INERTIA[0])


def _body(scene: Scene) -> Body:
    body = scene.object["top"].body
    assert body is not None
    return body


def _spun(name, spin):
    return lambda state: eqx.tree_at(
        lambda s: s.motion[name].spin, state, jnp.asarray(spin, state.motion[name].velocity.dtype)
    )


TOP = Case(
    name="top",
    title="free top with J = 1:2:3, spun about its middle axis for 2 s",
    unit="rad",
    seconds=SECONDS,
    scene=lambda integrator: Scene(
        {"top": Object(Box((0.06,) * 3), body=Body(0.2, inertia=INERTIA))},
        world=World(gyroscopic=True),
        integrator=integrator,
    ),
    start=_spun("top", SPIN),
    measure=lambda state: turned(state.motion["top"]),
    truth=lambda: turned_mujoco(free_truth()),
    known="closed form, Jacobi's elliptic functions",
    gain=float(np.linalg.norm(SPIN) * SECONDS),
    smooth=True,
    gradient=Gradient(
        "object.top.body.inertia[0]",
        lambda scene: _body(scene).inertia,
        _free_per_inertia,
        along=(1, 0, 0),
    ),
    mujoco=Mujoco(
        """<mujoco><option gravity="0 0 0"/><worldbody><body><freejoint/>
        <inertial pos="0 0 0" mass="0.2" diaginertia="1e-4 2e-4 3e-4"/></body></worldbody></mujoco>""",
        start=lambda model, data: data.qvel.__setitem__(slice(3, 6), SPIN),
        read=lambda model, data: turned_mujoco(data.xmat[1]),
    ),
)


MASS, HEAVY, HALF, STIFFNESS, FAST = 0.1, np.array([8e-5, 8e-5, 4e-5]), 0.03, 5000.0, 150.0
SPUN = 0.5  # s
TILT = Rotation.from_euler("x", 20, degrees=True)
_DEPTH = MASS * G / STIFFNESS
_FINGER = TILT.apply([0, 0, -HALF + _DEPTH])


def _heavy(mass) -> np.ndarray:
    """The heavy top's matrix at the end."""
    held = Held(
        mass,
        HEAVY,
        np.array([[0, 0, -HALF]]),
        STIFFNESS,
        lambda t: _FINGER[None],
        np.array([0, 0, -G]),
    )
    start = Place(np.zeros(3), TILT.as_matrix(), np.zeros(3), TILT.apply([0, 0, FAST]))
    return solve(held, start, SPUN).matrix.ravel() / np.sqrt(2)


def _heavy_start(model, data) -> None:
    data.qpos[3:7] = TILT.as_quat(scalar_first=True)
    data.qvel[5] = FAST


HEAVY_TOP = Case(
    name="heavy_top",
    title="heavy top that spins on a fingertip",
    unit="rad",
    seconds=SPUN,
    scene=lambda integrator: Scene(
        {
            "top": Object(
                Box((2 * HALF,) * 3),
                Surface(STIFFNESS, mu=10.0),
                Body(MASS, inertia=HEAVY),
                orientation=TILT.as_quat(scalar_first=True),
            )
        },
        world=World(gravity=(0, 0, -G), gyroscopic=True),
        integrator=integrator,
    ),
    start=_spun("top", TILT.apply([0, 0, FAST])),
    hip=lambda t: jnp.asarray(_FINGER, t.dtype)[None],
    measure=lambda state: turned(state.motion["top"]),
    truth=lambda: _heavy(MASS),
    known="independent equations, SciPy's DOP853 at 1e-12",
    gain=FAST * SPUN,
    smooth=True,
    gradient=Gradient("object.top.body.mass", lambda scene: _body(scene).mass, lambda: slope(_heavy, MASS)),
    mujoco=Mujoco(
        f"""<mujoco><option gravity="0 0 {-G}"/><worldbody>
        <site name="finger" pos="{_FINGER[0]} {_FINGER[1]} {_FINGER[2]}"/>
        <body><freejoint/><inertial pos="0 0 0" mass="{MASS}" diaginertia="8e-5 8e-5 4e-5"/>
        <site name="tip" pos="0 0 {-HALF}"/></body></worldbody>
        <tendon><spatial stiffness="{STIFFNESS}" springlength="0"><site site="finger"/><site site="tip"/></spatial>
        </tendon></mujoco>""",
        start=_heavy_start,
        read=lambda model, data: turned_mujoco(data.xmat[1]),
    ),
)
