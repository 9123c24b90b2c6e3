"""The residuals of a fit and their Jacobian in few rows: all that a search for least squares needs of them."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .observation import Observation
from .problem import KEYS, Problem, at_once, residuals_of
from .robust import rooted
from .sharding import each
from .solve import jacobian


def reduced(free: Float[Array, " p"], problem: Problem) -> tuple[Float[Array, "m p"], Float[Array, " m"]]:
    """The Jacobian and `stacked_residuals`, turned to few rows: p + 1 a channel, and those of priors.

    Lengths and inner products of the columns, residuals among them, are those of the whole. [r J] = Q R, and only R is
    kept: first of each recording, then of all in their order, whichever device they were on (Demmel, Grigori, Hoemmen,
    Langou 2012, Communication-optimal parallel and sequential QR and LU factorizations, section 4). With r in front, its
    turned form is its length and zeros: where nothing changes but Q, it does not either.
    """
    shared = free, replace(problem, groups=(), priors=None)
    blocks: dict[str, list[Array]] = {}
    for group in problem.groups:
        own = problem.own(0)
        side_by_side = at_once(group, 1 + len(free if own is None else own))
        found_in = each(_of_one, shared, group, group.layout, side_by_side)
        for key in [key for key in KEYS if key in found_in]:
            blocks.setdefault(key, []).append(found_in[key].reshape(-1, len(free) + 1))
    found = [_square(_triangular(jnp.concatenate(b))) for b in blocks.values()]
    if problem.priors is not None:
        known, parameters = problem.priors, problem.reported
        slopes, off = jacobian(lambda x, _: known.residuals(parameters, problem.report(x)), free, None)
        found.append(jnp.concatenate([off[:, None], slopes], axis=1))
    whole = jnp.concatenate(found)
    return whole[:, 1:], whole[:, 0]


def _of_one(
    shared: tuple[Float[Array, " p"], Problem], observation: Observation
) -> dict[str, Float[Array, "k q"]]:
    """R of each channel's [r J] of one recording, which depends on its own numbers and shared ones alone."""
    free, problem = shared
    own = problem.own(observation.place)

    def of(some, _):
        found = residuals_of((some if own is None else free.at[own].set(some), problem), observation)
        return {key: rooted(r.ravel(), problem.loss) for key, r in found.items()}

    slopes, found = jacobian(of, free if own is None else free[own], None)
    small = {k: _triangular(jnp.concatenate([r[:, None], slopes[k]], axis=1)) for k, r in found.items()}
    if own is None:
        return small
    places = jnp.concatenate([jnp.zeros(1, own.dtype), 1 + own])
    return {k: jnp.zeros((len(x), len(free) + 1), x.dtype).at[:, places].set(x) for k, x in small.items()}


def _triangular(rows: Float[Array, "n q"]) -> Float[Array, "k q"]:
    return rows if len(rows) <= rows.shape[1] else jnp.linalg.qr(rows, mode="r")


def _square(rows: Float[Array, "k q"]) -> Float[Array, "q q"]:
    return jnp.pad(rows, ((0, rows.shape[1] - len(rows)), (0, 0))) if len(rows) < rows.shape[1] else rows


def reduced_rows(
    channels: Sequence[tuple[str, Any]], of_all: Float[np.ndarray, " n"], columns: int
) -> np.ndarray:
    """A number that all residuals of a channel have alike, for the rows of `reduced` (but those of priors)."""
    ends = np.cumsum([r.size for _, r in channels])
    by_channel = {key: of_all[end - 1] for (key, _), end in zip(channels, ends, strict=True)}
    return np.repeat(list(by_channel.values()), columns + 1)
