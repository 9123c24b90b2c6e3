"""One cell of a stability map: an object is let go above a floor, and is at rest 2 s later, or not."""

from collections.abc import Callable, Mapping, Sequence
from functools import lru_cache, partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .. import body as rigid
from .. import rotation
from ..body import Body
from ..contact import Contact
from ..integrate import METHODS, SemiImplicit
from ..scene import Object, Scene, World, cast, dtype_of
from ..shape import Box, Plane
from ..simulate import State, init, step

SECONDS = 2.0  # simulated time of a cell
QUIET = 1e-4  # of m g L: below it the normal motion and the tilt count as at rest
WILD = 10.0  # times the energy at the start: above it a cell has blown up
LATEST = 1.9  # s: settled is what is quiet from then on
SETTLED, RINGING, BLOWN_UP = "settled", "ringing", "blown up"
SIDE = 0.04  # m, edge of the cube
DAMPING = 1.0  # s/m
TILT = 0.3  # rad, about a horizontal axis along no edge
BASE = {
    "stiffness": 1e4,  # N/m
    "dt": 1e-3,  # s
    "mass": 0.05,  # kg
    "mass_ratio": 1.0,  # of the upper of two cubes over the lower
    "mu": 0.5,
    "gap": 0.01,  # m, from the floor to the lowest corner; below 0 it starts inside
    "spin": 0.0,  # rad/s, about the vertical
    "inertia_ratio": 1.0,  # of the two larger principal moments over the smallest
}
Numbers = Mapping[str, Any]
Start = tuple[Scene, State]
AWAY = 1e3  # m: where the fingers are, out of reach


def dropped_cube(method: str, numbers: Numbers) -> Start:
    """A tilted cube above a floor: the scene and its state before the first step, of `numbers` as in `BASE`."""
    mass, stiffness = numbers["mass"], numbers["stiffness"]
    turn = _tilt(mass.dtype)
    lowest = jnp.min(rotation.turn(rotation.to_matrix(turn), _corners(mass.dtype))[:, 2])
    # The small one is about a horizontal axis, about which the cube then rocks.
    moments = jnp.stack([1 / numbers["inertia_ratio"], jnp.ones_like(mass), jnp.ones_like(mass)])
    body = Body(mass, inertia=mass * (SIDE**2 / 6) * moments)
    place = _up(numbers["gap"] - lowest)
    cube = Object(Box((SIDE,) * 3), body=body, position=place, orientation=turn)
    floor = Contact(stiffness, mu=numbers["mu"], damping=DAMPING, between=("cube", "floor"))
    return _begin({"cube": cube, "floor": Object(Plane())}, {"cube_on_floor": floor}, method, numbers)


def dropped_stack(method: str, numbers: Numbers) -> Start:
    """A cube on a floor and another, of three quarters its edge, dropped on it tilted.

    The mean (geometric) of their masses is `mass`, their ratio, upper over lower, `mass_ratio`.
    """
    mass, stiffness, root = numbers["mass"], numbers["stiffness"], jnp.sqrt(numbers["mass_ratio"])
    small = 0.75
    turn = _tilt(mass.dtype)
    lowest = small * jnp.min(rotation.turn(rotation.to_matrix(turn), _corners(mass.dtype))[:, 2])
    place = _up(SIDE + numbers["gap"] - lowest)
    lower = Object(Box((SIDE,) * 3), body=Body(mass / root), position=(0.0, 0.0, SIDE / 2))
    upper = Object(Box((small * SIDE,) * 3), body=Body(mass * root), position=place, orientation=turn)
    pair = partial(Contact, stiffness, mu=numbers["mu"], damping=DAMPING)
    contacts = {
        "fallen": pair(between=("upper", "floor")),  # a light cube may be knocked out from under a heavy one
        "on_floor": pair(between=("lower", "floor")),
        "on_lower": pair(between=("upper", "lower")),
    }
    objects = {"lower": lower, "upper": upper, "floor": Object(Plane())}
    return _begin(objects, contacts, method, numbers)


class Outcome(eqx.Module):
    """What became of cells: `verdict`; `quiet_after` s, from when on they were quiet; `peak`, the highest energy.

    The energy is kinetic and of height, over that of the start.
    """

    verdict: list[str]
    quiet_after: Float[np.ndarray, "n"]
    peak: Float[np.ndarray, "n"]


class Cells:
    """Cells of one structure and one integrator, compiled once for each number of them.

    **Arguments:** `build`, from an integrator's name and the numbers of one cell to its scene and state; `dtype` of the
    numbers.
    """

    def __init__(self, build: Callable[[str, Numbers], Start], method: str, dtype: str):
        self._dtype = jnp.dtype(dtype)
        self._run = jax.jit(jax.vmap(partial(_live, partial(build, method)), in_axes=(0, None, None)))

    def run(self, cells: Sequence[Numbers], dt: float) -> Outcome:
        """Simulate cells side by side for 2 s in steps of `dt` s. Each has the same names in its numbers."""
        names = cells[0].keys()
        numbers = {name: jnp.asarray([cell[name] for cell in cells], self._dtype) for name in names}
        count = round(SECONDS / dt)
        found = self._run(numbers, jnp.asarray(dt, self._dtype), jnp.asarray(count, jnp.int32))
        loud, peak, broken = (np.asarray(x) for x in found)
        quiet_after = np.minimum(loud * dt, SECONDS)
        verdict = [
            BLOWN_UP if b else SETTLED if q <= LATEST else RINGING
            for b, q in zip(broken, quiet_after, strict=True)
        ]
        return Outcome(verdict, quiet_after, peak.astype(float))


# One program for all maps of a structure.
programs = lru_cache(maxsize=32)(Cells)


def _live(build: Callable[[Numbers], Start], numbers: Numbers, dt: Float[Array, ""], count: Array):
    """Number of steps until the last that was not quiet, highest energy over the first, whether it blew up."""
    scene, state = build(numbers)
    hip = jnp.full((1, 3), AWAY, dt.dtype)
    gimbal = jnp.zeros(1, dt.dtype) if scene.torsion is not None and scene.torsion.needs_gimbal else None
    heights = {name: _height(scene, motion) for name, motion in state.motion.items()}
    first = energy(scene, state, heights) + _stored(scene, state, hip, gimbal)
    scale = first + sum(scale_of(scene, name) for name in state.motion)

    def body(i, carry):
        state, loud, peak, broken = carry
        state, reply = step(scene, state, hip, dt, gimbal)
        noise = jnp.max(jnp.stack([_noise(scene, state, name) for name in state.motion]))
        loud = jnp.where(noise < QUIET, loud, i + 1)
        now = energy(scene, state, heights)
        return state, loud, jnp.maximum(peak, now), broken | reply.lost

    start = (state, jnp.zeros((), jnp.int32), jnp.zeros_like(dt), jnp.zeros((), bool))
    state, loud, peak, broken = jax.lax.fori_loop(0, count, body, start)
    lost = energy(scene, state, None) > WILD * scale  # still falling, at the end
    return loud, peak / scale, broken | lost | (peak > WILD * scale)


def _noise(scene: Scene, state: State, name: str) -> Float[Array, ""]:
    """The larger of the energies of normal motion (along gravity) and of tilt, over m g L."""
    body, motion = scene.object[name].body, state.motion[name]
    assert body is not None
    up = _vertical(scene)
    normal = motion.velocity if up is None else jnp.sum(motion.velocity * up)[None]
    energy = 0.5 * body.mass * jnp.sum(normal**2)
    if motion.spin is not None:
        tilt = motion.spin if up is None else motion.spin - jnp.sum(motion.spin * up) * up
        energy = jnp.maximum(energy, _turning(scene, name, motion.orientation, tilt))
    return energy / scale_of(scene, name)


def energy(scene: Scene, state: State, heights: Mapping[str, Any] | None) -> Float[Array, ""]:
    """Kinetic energy, and that of height above `heights`, J."""
    total = jnp.zeros((), dtype_of(scene))
    for name, motion in state.motion.items():
        body = scene.object[name].body
        assert body is not None
        total = total + 0.5 * body.mass * jnp.sum(motion.velocity**2)
        if motion.spin is not None:
            total = total + _turning(scene, name, motion.orientation, motion.spin)
        if heights is not None:
            total = total + body.mass * (_height(scene, motion) - heights[name])
    return total


def _turning(scene: Scene, name: str, orientation, spin) -> Float[Array, ""]:
    thing = scene.object[name]
    assert thing.body is not None
    inertia = rigid.inertia_of(thing.body, thing.shape)
    local = rotation.turn_back(rotation.to_matrix(orientation), spin)
    momentum = inertia * local if inertia.ndim == 1 else jnp.sum(inertia * local[None], axis=-1)
    return 0.5 * jnp.sum(local * momentum)


def _stored(scene: Scene, state: State, hip, gimbal) -> Float[Array, ""]:
    """Energy of the springs of contacts that overlap at the start, J: 1/2 k d^2 at each point."""
    plain = eqx.tree_at(lambda s: s.integrator, scene, SemiImplicit(scene.integrator.dt))
    after, _ = step(plain, state, hip, jnp.asarray(1e-9, hip.dtype), gimbal)
    total = jnp.zeros((), hip.dtype)
    for name, gods in after.contact.items():
        depths = sum(jnp.sum(jnp.maximum(god.depth, 0) ** 2) for god in gods)
        total = total + 0.5 * scene.contact[name].stiffness * depths
    return total


def scale_of(scene: Scene, name: str) -> Float[Array, ""]:
    """m g L, J: L, m, is the edge of the uniform cube with the same trace of inertia over mass, m L^2 / 2."""
    thing = scene.object[name]
    assert thing.body is not None
    gravity = scene.world.gravity
    pull = 9.81 if gravity is None else jnp.sqrt(jnp.sum(gravity**2))
    inertia = rigid.inertia_of(thing.body, thing.shape)
    trace = jnp.sum(inertia) if inertia.ndim == 1 else jnp.trace(inertia)
    return thing.body.mass * pull * jnp.sqrt(2 * trace / thing.body.mass)


def _height(scene: Scene, motion) -> Float[Array, ""]:
    """Height over the world's origin times g, m^2/s^2."""
    gravity = scene.world.gravity
    return jnp.zeros_like(motion.position[0]) if gravity is None else -jnp.sum(gravity * motion.position)


def _vertical(scene: Scene) -> Float[Array, "3"] | None:
    gravity = scene.world.gravity
    return None if gravity is None else -gravity / jnp.sqrt(jnp.sum(gravity**2))


def _begin(objects, contacts, method: str, numbers: Numbers) -> Start:
    world = World(gravity=(0.0, 0.0, -9.81), gyroscopic=True)
    dtype = numbers["mass"].dtype
    scene = cast(Scene(objects, contacts, world=world, integrator=METHODS[method](dt=1e-3)), dtype)
    state = init(scene, jnp.full((1, 3), AWAY, dtype))
    last = scene.moving()[-1]
    return scene, eqx.tree_at(lambda s: s.motion[last].spin, state, _up(numbers["spin"]))


def _tilt(dtype) -> Float[Array, "4"]:
    axis = np.array([1.0, 2.0, 0.0]) / np.sqrt(5)
    return jnp.asarray([np.cos(TILT / 2), *(np.sin(TILT / 2) * axis)], dtype)


def _corners(dtype) -> Float[Array, "8 3"]:
    signs = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), -1).reshape(-1, 3)
    return jnp.asarray(SIDE / 2 * signs, dtype)


def _up(height: Float[Array, ""]) -> Float[Array, "3"]:
    return jnp.stack([jnp.zeros_like(height), jnp.zeros_like(height), height])
