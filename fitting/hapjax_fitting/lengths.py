"""Recordings of about the same length, filled up to the longest of them: what is compiled once serves all."""

from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .observation import Observation, Samples

ALIKE = 1.25  # how many times as long as another one the longest may be


def alike(laid: Sequence[Observation]) -> list[list[Observation]]:
    """Observations of the same kind and of about the same length together, so that they can be stacked; in their order."""
    kinds: dict[object, list[int]] = {}
    for i, observation in enumerate(laid):
        kinds.setdefault(_kind(observation), []).append(i)
    lengths, groups = [_lengths(observation) for observation in laid], []
    for kind in kinds.values():
        left = sorted(kind, key=lambda i: lengths[i], reverse=True)
        while left:
            group = [i for i in left if _are_near(lengths[i], lengths[left[0]])]
            left = [i for i in left if i not in group]
            groups.append(sorted(group))
    return [_filled([laid[i] for i in group]) for group in sorted(groups)]


def _lengths(observation: Observation) -> tuple[int, int, int]:
    """Of the path, and of the samples of force and pose."""
    samples = (observation.force, observation.pose)
    force, pose = (0 if s is None else len(s.value) for s in samples)
    return len(observation.hips), force, pose


def _kind(observation: Observation) -> object:
    leaves, structure = jax.tree.flatten(observation)
    return structure, tuple(x.shape[1:] for x in leaves)


def _are_near(one: tuple[int, ...], other: tuple[int, ...]) -> bool:
    return all(max(pair) <= ALIKE * min(pair) for pair in zip(one, other, strict=True))


def _filled(group: list[Observation]) -> list[Observation]:
    """All as long as the longest in each respect."""
    longest = [max(lengths) for lengths in zip(*map(_lengths, group), strict=True)]
    if all(list(_lengths(o)) == longest for o in group):
        return group
    return [_to(o, *longest) for o in group]


def _to(observation: Observation, steps: int, forces: int, poses: int) -> Observation:
    gimbals = observation.gimbals
    return replace(
        observation,
        hips=_repeated(observation.hips, steps),
        gimbals=None if gimbals is None else _repeated(gimbals, steps),
        force=_with_rest(observation.force, forces),
        pose=_with_rest(observation.pose, poses),
        steps=jnp.asarray(len(observation.hips), jnp.int32),
    )


def _repeated(series: Array, length: int) -> Array:
    """The last of it to the end: fingers that stay where they are."""
    whole = np.asarray(series)
    return jnp.asarray(np.concatenate([whole, np.repeat(whole[-1:], length - len(whole), axis=0)]))


def _with_rest(samples: Samples | None, length: int) -> Samples | None:
    if samples is None:
        return None
    value, index, weight = (_repeated(x, length) for x in (samples.value, samples.index, samples.weight))
    return Samples(value, index, weight, jnp.asarray(len(samples.value), jnp.int32))
