"""The error of a user's own scene against run time, and the cheapest integrator and substeps within a given error."""

import dataclasses
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from .. import body as rigid
from .. import rotation
from ..body import Body
from ..errors import InputError, within
from ..recording import Recording
from ..scene import Scene, cast
from ..simulate import State
from ._sweep import Sweep, curve_of_substeps, extrapolated
from .cases import Case, Order

SUBSTEPS = (1, 2, 4, 8, 16, 32, 64)
SECONDS, RAY = (
    1.0,
    2000,
)  # s of the operator's motion; points of a ray at which a finger looks for the surface
LIFT, GAP = 0.01, 0.005  # m

_NONSMOOTH = Order(1, "touches that begin or slip are of first order, where forces are smooth it is 2")


def sweep_at(rate: float) -> Sweep:
    """One point for each number of substeps at `rate` (Hz)."""
    return Sweep([1 / (rate * n) for n in SUBSTEPS], (), 0, 4_000_000)


def scene_case(scene: Scene, hips: np.ndarray, gimbals: np.ndarray | None, rate: float) -> Case:
    """The case of a scene whose fingers are at `hips` (T, F, 3) m, `rate` a second, straight between.

    It is run as a servo loop and `hapjax simulate` run it: a step for each of `hips` from the second on.

    **Raises:** `InputError` for a scene in which nothing moves.
    """
    if not scene.moving():
        raise InputError("no object has a body, so nothing moves; allowed for this: at least one that has")
    steps = len(hips) - 1 - (len(hips) - 1) % 2
    times = np.arange(len(hips)) / rate

    def along(path: np.ndarray) -> Callable[[Any], Any]:
        flat = path.reshape(len(path), -1)

        def place(t):
            each = jax.vmap(lambda column: jnp.interp(t, jnp.asarray(times, t.dtype), column))
            return each(jnp.asarray(flat.T, t.dtype)).reshape(path.shape[1:])

        return place

    return Case(
        name="scene",
        title="the scene, and its fingers' motion",
        unit="m",
        seconds=steps / rate,
        scene=lambda integrator: dataclasses.replace(scene, integrator=integrator),
        hip=along(hips),
        gimbal=None if gimbals is None else along(gimbals),
        measure=lambda state: _points(scene, state),
        known="extrapolated; places of the objects and, by their radius of gyration, their turns",
        orders={"lie_midpoint": _NONSMOOTH},
        mujoco="a scene file has no MuJoCo model",
        ticks=steps,
    )


def motion_of(
    scene: Scene, file: Path | None, fingers: int, rate: float
) -> tuple[np.ndarray, np.ndarray | None]:
    """The fingers' path (T, F, 3) m and gimbals (T, F) rad at `rate` (Hz): recorded, or a virtual operator's."""
    turned = scene.torsion is not None and scene.torsion.needs_gimbal
    if file is None:
        hips = operator(scene, fingers, rate)
        return hips, np.zeros(hips.shape[:2]) if turned else None
    recording = Recording.load(file)
    with within(f"{file}: "):
        hips = np.asarray(recording.hip_every(1 / rate))
        if len(hips) < 3:
            raise InputError(f"hip lasts {len(hips) - 1} steps at {rate:g} Hz; allowed: 2 or more")
        assert recording.hip_t is not None
        times = recording.hip_t[0] + np.arange(len(hips)) / rate
        return hips, np.asarray(recording.gimbal_at(times)) if turned else None


def operator(scene: Scene, fingers: int, rate: float) -> np.ndarray:
    """A virtual operator's motion for 1 s, (T, F, 3) m: fingers from both sides in x grip the first object that they
    feel and that moves, with 1.5 times the force that holds it, and lift it by 10 mm. One finger alone presses from
    above, and strokes.

    **Raises:** `InputError` where there is no such object, or fingers do not find its surface.
    """
    name = next((n for n in scene.touchable() if scene.object[n].body is not None), None)
    if name is None:
        raise InputError(
            "no object with a body has a surface for fingers; allowed for this: one that has, or --hip"
        )
    thing = scene.object[name]
    surface, body = thing.surface, thing.body
    assert surface is not None and body is not None
    t = np.arange(2 * int(SECONDS * rate / 2) + 1) / rate
    weight = float(body.mass) * 9.81
    mu = float(np.min(np.asarray(surface.mu if surface.mu_static is None else surface.mu_static)))
    mu *= 1.0 if surface.finger_mu is None else float(np.min(np.asarray(surface.finger_mu)))
    sides = [-1.0 if i % 2 == 0 else 1.0 for i in range(fingers)]
    paths = []
    for i, side in enumerate(sides):
        if fingers == 1:
            spot, inward, force = (
                spot_of(scene, name, np.array([0, 0, 1.0]), np.zeros(3)),
                -np.eye(3)[2],
                weight / 2,
            )
        else:
            row = [j for j in range(fingers) if sides[j] == side]
            across = np.array([0, 0.5 * ((row.index(i) + 0.5) / len(row) - 0.5) * _width(scene, name), 0])
            spot, inward = spot_of(scene, name, np.array([side, 0, 0]), across), np.array([-side, 0, 0])
            force = 0.75 * weight / max(mu, 0.1) / len(row)
        depth = np.interp(t, [0.0, 0.2], [-GAP, force / float(surface.stiffness)])
        along = np.eye(3)[0] if fingers == 1 else np.eye(3)[2]
        lift = LIFT * np.interp(t, [0.3, 0.7], [0.0, 1.0])
        paths.append(spot + depth[:, None] * inward + lift[:, None] * along)
    return np.stack(paths, axis=1)


@dataclasses.dataclass(frozen=True)
class Choice:
    """An integrator with substeps: `error` m at the end; `step_us` of a whole step in a compiled loop."""

    integrator: str
    substeps: int
    error: float
    step_us: float


def choices(case: dict[str, Any], rate: float) -> list[Choice]:
    """What each integrator with each number of substeps errs and costs at `rate` (Hz), the cheapest first."""
    found = []
    for name, curve in case["curves"].items():
        for p in curve["points"]:
            error = np.inf if p["error"] is None else p["error"]
            found.append(Choice(name, _substeps(p["dt"], rate), error, p["run"] / rate * 1e6))
    return sorted(found, key=lambda c: c.step_us)


def errors(
    scene: Scene,
    hip: Path | None,
    fingers: int,
    integrators: Sequence[str],
    rate: float,
    advance: Callable[[str, float], Any] = lambda doing, steps: None,
) -> tuple[dict[tuple[str, int], float], float]:
    """The error (m) at the end by integrator and number of substeps at `rate` (Hz), and to what the truth is known.

    The fingers follow the recording `hip`, or are a virtual operator's. Needs 64-bit numbers on.

    **Raises:** `InputError` for a scene or a motion that cannot be, or whose truth is not known to 1 mm.
    """
    scene = cast(scene, jnp.float64)
    case, sweep = scene_case(scene, *motion_of(scene, hip, fingers, rate), rate), sweep_at(rate)
    advance("error: truth", 0.0)
    truth, floor = extrapolated(case, sweep)
    found = {}
    for name in integrators:
        advance(f"error: {name}", 0.0)
        for p in curve_of_substeps(case, name, truth, sweep)[0]:
            found[name, _substeps(p.dt, rate)] = p.error
    return found, floor


def unsure(floor: float, error: float) -> str:
    """What is to be said where the truth is known to `floor` m alone, and less than that is asked for."""
    return f" The truth is known to {floor:.0e} m, so errors below that say nothing." if floor > error else ""


def advice(found: Sequence[Choice], error: float, rate: float, floor: float) -> str:
    """The recommendation in one sentence."""
    good = next((c for c in found if c.error <= error), None)
    if good is not None:
        return (
            f"Cheapest within {error:g} m at {rate:g} Hz: {good.integrator} with substeps = {good.substeps}, "
            f"{good.error:.1e} m off at the end, {good.step_us:.1f} us a step.{unsure(floor, error)}"
        )
    best = min(found, key=lambda c: c.error)
    return (
        f"None stays within {error:g} m at {rate:g} Hz; the closest is {best.integrator} with substeps = "
        f"{best.substeps}, {best.error:.1e} m off at the end, {best.step_us:.1f} us a step.{unsure(floor, error)}"
    )


def _substeps(dt: float, rate: float) -> int:
    return round(1 / (dt * rate))


def _points(scene: Scene, state: State):
    """Of each moving object its place, and three points of its body a radius of gyration away, less the place."""
    parts = []
    for name, motion in state.motion.items():
        parts.append(motion.position)
        body = scene.object[name].body
        assert body is not None
        if body.rotation:
            matrix = rotation.to_matrix(motion.orientation)
            parts.append((_gyration(scene, name, body) * matrix).ravel())
    return jnp.concatenate(parts)


def _gyration(scene: Scene, name: str, body: Body):
    inertia = rigid.inertia_of(body, scene.object[name].shape)
    trace = jnp.sum(inertia) if inertia.ndim == 1 else jnp.trace(inertia)
    return jnp.sqrt(trace / (3 * body.mass))


def spot_of(scene: Scene, name: str, side: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Where a ray from `side` towards the object's origin, moved by `across` (m), meets its surface; m, world frame."""
    thing = scene.object[name]
    matrix, place = rotation.to_matrix(rotation.normalise(thing.orientation)), np.asarray(thing.position)

    def first_inside(from_: float, to: float) -> tuple[float, float]:
        """Between which two of RAY points of the ray (m from the origin) the surface lies."""
        ways = np.linspace(from_, to, RAY)
        local = rotation.turn_back(matrix, jnp.asarray(across + ways[:, None] * side, matrix.dtype))
        inside = np.asarray(jax.vmap(lambda p: thing.shape.closest(p).depth)(local)) > 0
        if not inside.any():
            raise InputError(
                f"fingers do not find object.{name}; allowed with --hip: a recording of their motion"
            )
        first = max(int(np.argmax(inside)), 1)
        return float(ways[first - 1]), float(ways[first])

    return place + across + first_inside(*first_inside(1.0, 0.0))[1] * side


def _width(scene: Scene, name: str) -> float:
    """How wide (m) the object is in y."""
    ends = [spot_of(scene, name, np.array([0, side, 0]), np.zeros(3))[1] for side in (1.0, -1.0)]
    return float(ends[0] - ends[1])
