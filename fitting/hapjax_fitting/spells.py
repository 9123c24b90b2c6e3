"""Spells of contact: where nothing moves but the fingers, each is independent of the others and runs beside them."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from hapjax import Reply, Scene, init, rollout, rotation


def spells_of(scene: Scene, hips: Float[Array, "R T F 3"]) -> Int[Array, "R S L"] | None:
    """The steps of each spell in which some finger is inside some object, and of one step before; for R recordings.

    For scenes in which only fingers move. Filled up with T, which is no step. `None` where that gains little: a spell as
    long as the path is the path.
    """
    found = [_edges(np.asarray(jnp.any(_touching(scene, path), axis=1))) for path in hips]
    length = max(int((beyond - first).max(initial=1)) for first, beyond in found)
    if 2 * length > hips.shape[1]:
        return None
    steps = np.full((len(found), max(1, *(len(first) for first, _ in found)), length), hips.shape[1])
    for row, (first, beyond) in zip(steps, found, strict=True):
        each = first[:, None] + np.arange(length)
        row[: len(first)] = np.where(each < beyond[:, None], each, hips.shape[1])
    return jnp.asarray(steps, jnp.int32)


def _edges(touching: Bool[np.ndarray, " T"]) -> tuple[Int[np.ndarray, " S"], Int[np.ndarray, " S"]]:
    """The step before each spell, and that after it."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], touching, [False]]).astype(np.int8)))
    return np.maximum(edges[::2] - 1, 0), edges[1::2]


@jax.jit
def _touching(scene: Scene, hips: Float[Array, "T F 3"]) -> Bool[Array, "T F"]:
    """Which fingers are inside an object, or held by it still: what its surface is like makes no difference."""
    inside = jnp.zeros(hips.shape[:2], bool)
    for name in scene.touchable():
        thing = scene.object[name]
        matrix = rotation.to_matrix(rotation.normalise(thing.orientation))
        local = rotation.turn_back(matrix, (hips - thing.position[None, None]).reshape(-1, 3))

        def is_inside(point, shape=thing.shape):
            return shape.closest(point).depth > 0

        inside |= jax.lax.map(is_inside, local, batch_size=4096).reshape(inside.shape)
        tracks = jax.vmap(thing.shape.start)(local[: hips.shape[1]])
        if tracks is not None:

            def is_held(tracks, points, shape=thing.shape):
                tracks, near = jax.vmap(shape.follow)(tracks, points)
                return tracks, near.depth > 0

            inside |= jax.lax.scan(is_held, tracks, local.reshape(hips.shape))[1]
    return inside


def forces_in(
    scene: Scene, hips: Float[Array, "T F 3"], spells: Int[Array, "S L"]
) -> tuple[Float[Array, "T F 3"], Bool[Array, " T"]]:
    """The forces on the fingers at all steps, from the spells alone, and which steps are lost: those from a lost one on to
    the end of its spell."""

    def one(path: Float[Array, "L F 3"]) -> Reply:
        return rollout(scene, init(scene, path[0]), path)[1]

    replies = jax.vmap(one)(hips[jnp.minimum(spells, len(hips) - 1)])
    # Looked up step by step: to put them in their places costs several times as much where they have derivatives.
    places = jnp.arange(spells.size, dtype=spells.dtype).reshape(spells.shape)
    place = jnp.full(len(hips), spells.size, spells.dtype).at[spells].set(places, mode="drop")

    def at_all_steps(found):
        return found.reshape(-1, *found.shape[2:]).at[place].get(mode="fill", fill_value=0)

    return at_all_steps(replies.force), at_all_steps(jax.vmap(onwards)(replies.lost))


def onwards(lost: Bool[Array, " T"]) -> Bool[Array, " T"]:
    """All steps from the first lost one on."""
    first = jnp.where(jnp.any(lost), jnp.argmax(lost), len(lost))
    return jnp.arange(len(lost)) >= first
