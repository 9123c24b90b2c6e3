"""What a step remembers and what it answers, and whether that makes sense."""

import dataclasses
from collections import OrderedDict
from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Bool, Float

from ._segments import decided
from .body import Motion
from .god_object import GodObject, Touch

SENSE = 1e12  # beyond it, in any SI unit, no scene makes sense, and the squares are near the end of float32


class State(eqx.Module):
    """Everything that a step remembers.

    `hip` (F, 3) m, world frame, is that of the last step, kept only where a velocity or substeps need it; `motion` of
    each moving object, `finger` the god-objects of all fingers on each touchable object (in its frame), `contact` those
    of each contact's points and crossing edges (in the frame of the object that they touch), all by name. Of torsion:
    `god_angle` (F,) rad, the twist of the fingers on each object that turns, under a model that remembers it; `gimbal`
    (F,) rad, that of the last step, under a model that reads gimbals.
    """

    hip: Float[Array, "F 3"] | None
    motion: dict[str, Motion]
    finger: dict[str, GodObject]
    contact: dict[str, tuple[GodObject, ...]]
    god_angle: dict[str, Float[Array, "F"]] = eqx.field(default_factory=OrderedDict)
    gimbal: Float[Array, "F"] | None = None


class Reply(eqx.Module):
    """What a step answers.

    `force` (F, 3) N on the fingers, world frame; `pose` (O, 7) x y z qw qx qy qz of the moving objects in the scene's
    order after the step, m; `touch` and `contact` say for each touchable object and each contact what each finger or
    contact point did, in the touched object's frame.

    `lost`: the step left the range of sense (a number that is not finite, or above 1e12). Then the forces are 0, and
    the objects stay where they were and stand still.
    """

    force: Float[Array, "*T F 3"]
    pose: Float[Array, "*T O 7"]
    touch: dict[str, Touch]
    contact: dict[str, Touch]
    lost: Bool[Array, "*T"]


def flat(state: State) -> tuple[Float[Array, "N"], Callable[[Array, Array | None], State]]:
    """All numbers of a state but `hip` in one vector, and what makes a state of such a vector and a `hip`.

    A loop of steps takes a fixed time for each array that it keeps, copies or chooses.
    """
    numbers, build = ravel_pytree(dataclasses.replace(state, hip=None))
    return numbers, lambda numbers, hip: dataclasses.replace(build(numbers), hip=hip)


def in_sense(before: State, after: State, reply: Reply) -> tuple[State, Reply]:
    """The state and reply after a step, or the state before it and no forces where the step was lost."""
    hip = None
    if before.hip is not None and after.hip is not None:
        # Where the fingers are goes on, or a single mad sample would make every later step a leap, too.
        hip = jnp.where(jnp.abs(after.hip) <= SENSE, after.hip, before.hip)
    (new, build), (old, _) = flat(after), flat(before)
    every = jnp.concatenate([x.ravel() for x in jax.tree.leaves((after, reply.force))])
    fine = decided(jnp.all(jnp.abs(every) <= SENSE))  # False of NaN
    state = build(jnp.where(fine, new, jnp.asarray(_standing(before), old.dtype) * old), hip)
    pose = [jnp.concatenate([m.position, m.orientation])[None] for m in before.motion.values()]
    poses = jnp.where(fine, reply.pose, jnp.concatenate(pose)) if pose else reply.pose
    touch, contact = jax.tree.map(lambda x: jnp.where(fine, x, 0), (reply.touch, reply.contact))
    return state, Reply(jnp.where(fine, reply.force, 0), poses, touch, contact, ~fine)


def _standing(state: State) -> np.ndarray:
    """By what to multiply a `flat` state so that its objects stand still: 0 at velocities, else 1."""

    def moves(path) -> bool:
        return path[0].name == "motion" and path[-1].name in ("velocity", "spin")

    leaves = jax.tree.leaves_with_path(dataclasses.replace(state, hip=None))
    return np.repeat([not moves(path) for path, _ in leaves], [x.size for _, x in leaves])
