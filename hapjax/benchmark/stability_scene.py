"""A user's own scene: its objects are nudged, its stiffness and time step scaled; which integrator is the cheapest."""

import dataclasses
from collections import OrderedDict
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from ..errors import InputError
from ..integrate import METHODS
from ..scene import Scene, cast, dtype_of
from ..simulate import init
from . import stability_press as touch
from ._timing import SCAN_STEPS, compiled, step_us
from .error_scene import SUBSTEPS
from .stability_cells import AWAY, BASE, BLOWN_UP, RINGING, SECONDS, SETTLED, Numbers, Start, programs
from .stability_loop import passive_stiffness
from .stability_maps import DTYPES, Map, decades

NUDGE, TURN = 0.1, 1.0  # m/s down and rad/s about a horizontal axis, of every object at the start
WORSE = (SETTLED, RINGING, BLOWN_UP)


class Choice(NamedTuple):
    """An integrator with substeps: `step_us` of a step of the scene, in its fingers, in a compiled loop; `margin`, by
    which factor its contacts could be stiffer. Below 1 the scene does not settle as it is; 0: nor with any softer contacts
    tried.
    `pressed`: the worse verdict, of float64's and float32's, on its objects between two fingers; empty: none is felt.
    `error`: m, by how much a motion's end is off; `None`: not measured."""

    integrator: str
    substeps: int
    step_us: float
    margin: float
    pressed: str = ""
    error: float | None = None

    @property
    def settles(self) -> bool:
        """Whether it settles by itself, and between fingers."""
        return self.margin >= 1 and self.pressed in ("", SETTLED)

    def serves(self, error: float) -> bool:
        """Whether it settles, and is within `error` (m) where that was measured."""
        return self.settles and (self.error is None or self.error <= error)


class Wall(NamedTuple):
    """A surface that fingers feel, N/m, and what damping a device has to have of its own, N s/m, by Colgate's bound."""

    name: str
    stiffness: float
    damping: float
    damping_one_late: float


def scaled_map(scene: Scene) -> Map:
    """The map of a scene: a factor of all contacts' stiffness, against time steps from 0.1 to 20 times its own.

    **Raises:** `InputError` where an object that moves has nothing to come to rest on, or there is no gravity.
    """
    if scene.world.gravity is None or not np.any(np.asarray(scene.world.gravity)):
        raise InputError(
            "world.gravity is none, so nothing comes to rest; allowed for this: a scene with gravity"
        )
    held = {name for pair in scene.contact.values() for name in pair.between}
    for name in scene.moving():
        if name not in held:
            raise InputError(
                f"object.{name} has a body and no contact, so it falls for ever; allowed for this: a contact that names it"
            )
    return Map(
        "stiffness_factor", "stiffness of the contacts, times", "", decades(-2, 4), partial(_scaled, scene)
    )


def felt_alike(scene: Scene) -> Scene:
    """The scene as the finger with the smallest mu feels it: the maps and presses have fingers of their own."""
    objects = OrderedDict(scene.object)
    for name in scene.touchable():
        surface = objects[name].surface
        assert surface is not None
        if surface.finger_mu is not None:
            surface = surface.of_finger(jnp.min(surface.finger_mu))
            objects[name] = dataclasses.replace(objects[name], surface=surface)
    return dataclasses.replace(scene, object=objects)


def recommend(
    scene: Scene,
    one: Map,
    integrators: Sequence[str],
    rate: float,
    fingers: int,
    advance: Callable[[str, float], Any] = lambda doing, steps: None,
    errors: Mapping[tuple[str, int], float] | None = None,
    within: float = np.inf,
) -> list[Choice]:
    """Each integrator with substeps at `rate` (Hz), up to as many as it takes; the cheapest first; needs 64-bit numbers on.

    With `errors` (m, by integrator and substeps) as many as it takes to settle and to be `within` (m) the truth; beyond
    the first number that settles only those are tried that are.

    `one` is the scene's map. The scene settles where it does in float64 and in float32, with its own stiffness and with all
    softer ones of the map, and where two fingers press each object that they feel. N substeps cost N times a step without.
    """
    choices = []
    rest = touch.rested(cast(scene, jnp.float64)) if touch.touched(scene) else None
    for method in integrators:
        cost = _step_us(scene, rest, method, fingers, rate)
        presses = [] if rest is None else [touch.press(rest, method, dtype) for dtype in DTYPES]
        settled = False
        for n in SUBSTEPS:
            error, margin = None if errors is None else errors.get((method, n), np.inf), np.inf
            if settled and error is not None and error > within:
                continue
            for dtype in DTYPES:
                advance(f"{method}, {dtype}, {n} substeps", 0.0)
                found = programs(one.build, method, dtype).run(
                    [BASE | {one.parameter: value} for value in one.values], 1 / (rate * n)
                )
                margin = min(margin, _margin(one.values, found.verdict))
                advance(f"{method}, {dtype}, {n} substeps", SECONDS * rate * n)
            pressed = max((press(1 / (rate * n)) for press in presses), key=WORSE.index, default="")
            choices.append(Choice(method, n, cost * n, margin, pressed, error))
            settled = settled or choices[-1].settles
            if choices[-1].serves(within):
                break
    return sorted(choices, key=lambda choice: choice.step_us)


def recommend_work(integrators: Sequence[str], rate: float) -> float:
    """The most steps that `recommend` tells `advance` of."""
    return len(integrators) * len(DTYPES) * SECONDS * rate * sum(SUBSTEPS)


def cheapest(choices: Sequence[Choice], within: float = np.inf) -> Choice | None:
    """The first that settles, and is `within` so many m of the truth; `None`: none does."""
    return next((choice for choice in choices if choice.serves(within)), None)


def walls(scene: Scene, rate: float) -> list[Wall]:
    """The surfaces that fingers feel, with Colgate's bound at `rate` (Hz), for positions in time and one sample late."""
    found = []
    for name in scene.touchable():
        surface = scene.object[name].surface
        assert surface is not None
        stiffness = float(surface.stiffness)
        needs = [stiffness / passive_stiffness(1.0, rate, late) for late in (0, 1)]
        found.append(Wall(f"object.{name}.surface", stiffness, *needs))
    return found


def _margin(factors: Sequence[float], verdict: Sequence[str]) -> float:
    """The largest factor up to which all settle, 0 where the first does not."""
    good = [v == SETTLED for v in verdict]
    stop = good.index(False) if False in good else len(good)
    return factors[stop - 1] if stop else 0.0


def _scaled(scene: Scene, method: str, numbers: Numbers) -> Start:
    """The scene with an integrator and stiffer contacts, its objects nudged."""
    factor = numbers["stiffness_factor"]
    scene = cast(dataclasses.replace(scene, integrator=METHODS[method](dt=scene.integrator.dt)), factor.dtype)

    def stiffer(pair):
        own = pair.tangential_stiffness
        tangential = None if own is None else factor * own
        return dataclasses.replace(pair, stiffness=factor * pair.stiffness, tangential_stiffness=tangential)

    contact = OrderedDict((name, stiffer(pair)) for name, pair in scene.contact.items())
    scene = dataclasses.replace(scene, contact=contact)
    gimbal = jnp.zeros(1, factor.dtype) if scene.torsion is not None and scene.torsion.needs_gimbal else None
    state = init(scene, jnp.full((1, 3), AWAY, factor.dtype), gimbal)
    gravity = scene.world.gravity
    assert gravity is not None
    down = gravity / jnp.sqrt(jnp.sum(gravity**2))
    across = jnp.cross(down, jnp.roll(down, 1) + jnp.asarray([0.3, 0.1, 0.2], factor.dtype))
    spin = TURN * across / jnp.sqrt(jnp.sum(across**2))
    for name, motion in state.motion.items():
        state = eqx.tree_at(lambda s, n=name: s.motion[n].velocity, state, NUDGE * down)
        if motion.spin is not None:
            state = eqx.tree_at(lambda s, n=name: s.motion[n].spin, state, spin)
    return scene, state


def _step_us(scene: Scene, rest: Scene | None, method: str, fingers: int, rate: float) -> float:
    """us of a step without substeps in a compiled loop, the scene at `rest` in its fingers; `None`: they feel nothing."""
    felt = dataclasses.replace(scene if rest is None else rest, integrator=METHODS[method](dt=1 / rate))
    # An integrator that looks ahead takes up to twice as long where fingers touch.
    hips = np.full((fingers, 3), AWAY) if rest is None else touch.path(rest, fingers, SCAN_STEPS)
    gimbal = np.zeros(fingers) if scene.torsion is not None and scene.torsion.needs_gimbal else None
    loop, _ = compiled(cast(felt, dtype_of(scene)), hips, gimbal)
    return step_us([loop], runs=3)[0]
