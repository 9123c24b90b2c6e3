"""Motions that could be recorded next, about a contact that was recorded."""

from collections.abc import Callable
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np

from .grip import grips
from .result import FitResult
from .sharding import gathered

_APPROACH, _LASTS = 0.1, 1.0  # s
_ABOVE = 1e-3  # m
_SHORTEST, _LONGEST = 5e-3, 2e-2  # m, of a stroke


@dataclass(frozen=True)
class Contact:
    """What was touched, and how: `path` (T, F, 3) m up to a moment of firm touch, the `normal` (F, 3) and `depth` (F,) m of
    each finger there, a direction `along` (3,) of the surface, the `length` (m) of a stroke."""

    path: np.ndarray
    normal: np.ndarray
    depth: np.ndarray
    along: np.ndarray
    length: float
    moves: bool


Motion = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray, np.ndarray]]

# Each motion over its time from 0 to 1: strokes along and across the surface, in lengths, and what the depth is, of that
# at the moment of firm touch.
MOTIONS: dict[str, Motion] = {
    "press": lambda u: (0 * u, 0 * u, 1 + np.sin(np.pi * u) ** 2),
    "slow stroke": lambda u: (0.5 * (1 - np.cos(np.pi * u)), 0 * u, 1 + 0 * u),
    "fast stroke": lambda u: (0.5 * (1 - np.cos(8 * np.pi * u)), 0 * u, 1 + 0 * u),
    "stroke with rising load": lambda u: (0.5 * (1 - np.cos(2 * np.pi * u)), 0 * u, 0.5 + 1.5 * u),
    "circle": lambda u: (0.5 * (1 - np.cos(4 * np.pi * u)), 0.5 * np.sin(4 * np.pi * u), 1 + 0 * u),
    "tap": lambda u: (0 * u, 0 * u, 1 - 1.5 * np.sin(3 * np.pi * u) ** 2),
}


def contact_of(result: FitResult) -> Contact | None:
    """A moment of firm touch in the first recording in which something touches; `None`: there is none."""
    scene = result.scene
    for group in result.problem.groups:
        for i, path in enumerate(gathered(group.hips)[: group.count]):
            gimbals = None if group.gimbals is None else gathered(group.gimbals)[i][None]
            starts = result.problem.setup_at(jnp.asarray(result.free), int(group.places[i])).start
            found = grips(scene, jnp.asarray(path)[None], gimbals, starts)
            steps = len(path) if group.steps is None else int(gathered(group.steps)[i])
            felt = {
                name: np.asarray(g.normal_force)[0, :steps]
                for name, g in found.items()
                if g.direction is not None
            }
            if not felt or max(f.max() for f in felt.values()) <= 0:
                continue
            name = max(felt, key=lambda n: felt[n].sum())
            return _firm(result, name, path, felt[name], np.asarray(found[name].direction)[0])
    return None


def _firm(
    result: FitResult, name: str, path: np.ndarray, force: np.ndarray, direction: np.ndarray
) -> Contact:
    thing = result.scene.object[name.removeprefix("object.")]
    assert thing.surface is not None
    fingers = np.sum(force > 0, axis=1)
    among = np.flatnonzero(fingers == fingers.max())
    load = force[among].sum(axis=1)
    moment = int(among[np.argmin(np.abs(load - np.quantile(load, 0.75)))])
    depth = force[moment] / float(thing.surface.stiffness)
    first = int(np.argmax(force[moment]))
    normal = np.where(force[moment][:, None] > 0, direction[moment], 0)
    mu = thing.surface.mu if thing.surface.mu_static is None else thing.surface.mu_static
    factors = 1.0 if thing.surface.finger_mu is None else np.asarray(thing.surface.finger_mu)
    slip = float(np.max(np.asarray(mu))) * float(np.max(factors * depth))
    return Contact(
        path[: moment + 1],
        normal,
        depth,
        _along(normal[first], np.asarray(thing.position) - path[moment, first]),
        float(np.clip(5 * slip, _SHORTEST, _LONGEST)),
        thing.body is not None,
    )


def _along(normal: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """A direction in the surface: to the object's middle, so that a stroke does not leave it at once."""
    for guess in (towards, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])):
        inside = guess - (guess @ normal) * normal
        if np.linalg.norm(inside) > 1e-3 * np.linalg.norm(guess) > 0:
            return inside / np.linalg.norm(inside)
    raise AssertionError("two directions cannot both be along one normal")


def path_of(motion: Motion, contact: Contact, dt: float) -> tuple[np.ndarray, int]:
    """The fingers' path (T, F, 3) m of a motion, and the step from which on it differs from those of others.

    On a fixed object the fingers that touched come down beside each other, the others stay away; what is held is taken hold
    of as it was recorded, and then moved by all fingers together.
    """
    steps = round(_LASTS / dt)
    along, across, depth = (x[:, None, None] for x in motion(np.arange(1, steps + 1) / steps))
    touching = np.any(contact.normal != 0, axis=1)
    side = np.cross(contact.normal[np.argmax(contact.depth)], contact.along)
    stroke = contact.length * (along * contact.along + across * side)
    if not contact.moves:
        stroke = stroke * touching[:, None]
    deeper = -(depth - 1) * (contact.depth[:, None] * contact.normal)
    moved = contact.path[-1] + stroke + deeper
    if contact.moves:
        return np.concatenate([contact.path, moved]), len(contact.path)
    approach = max(round(_APPROACH / dt), 2)
    share = np.linspace(1, 0, approach, endpoint=False)[:, None, None]
    down = contact.path[-1] + share * (_ABOVE + contact.depth[:, None]) * contact.normal
    return np.concatenate([down, moved]), approach
