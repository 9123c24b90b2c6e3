"""Searches that take each point another time: one after another where many points are on a CPU, else all at once."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap

_FEW = 8  # the fingers of two hands: together they wait for the slowest, which is cheaper than to take turns


def one_by_one(search: Callable[..., Any]) -> Callable[..., Any]:
    """A `search(tables, wanted, *numbers)` of one point, which under `vmap` is not made where it is not `wanted`.

    Loops of many points in step with each other all go on until the last one ends, and each reads tables at many places
    at once. Taken in turn a point costs what its own search does, and the program has the same size for any number of
    points. So is one alone, since `vmap` would make a choice of ways a choice of what all of them found.
    What is returned of points that are not wanted has no meaning. Nothing is differentiated: the caller has stopped
    all gradients.
    """

    @custom_vmap
    def single(tables, wanted, numbers):
        return search(tables, wanted, *numbers)

    @single.def_vmap
    def _(size, batched, tables, wanted, numbers):
        return _batch(single, many, size, batched, tables, wanted, numbers)

    def together(tables, wanted, numbers):
        return jax.vmap(lambda w, n: search(tables, w, *n))(wanted, numbers)

    def in_turn(tables, wanted, numbers):
        order = jnp.nonzero(wanted, size=wanted.size)[0]
        blank = jax.eval_shape(together, tables, wanted, numbers)

        def one(i, found):
            now = order[i]
            own = jax.tree.map(lambda x: lax.dynamic_index_in_dim(x, now, keepdims=False), numbers)
            answer = search(tables, jnp.ones((), bool), *own)
            return jax.tree.map(
                lambda all, new: lax.dynamic_update_index_in_dim(all, new, now, 0), found, answer
            )

        nothing = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), blank)
        return lax.fori_loop(0, jnp.sum(wanted), one, nothing)

    @custom_vmap
    def many(tables, wanted, numbers):
        if 1 < wanted.size <= _FEW:
            return together(tables, wanted, numbers)
        return lax.platform_dependent(tables, wanted, numbers, cpu=in_turn, default=together)

    @many.def_vmap
    def _(size, batched, tables, wanted, numbers):
        def flat(tables, wanted, numbers):
            rows = jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), (wanted, numbers))
            return jax.tree.map(lambda x: x.reshape(*wanted.shape, *x.shape[1:]), many(tables, *rows))

        return _batch(many, flat, size, batched, tables, wanted, numbers)

    return lambda tables, wanted, *numbers: single(tables, wanted, numbers)


def _batch(one, more, size, batched, tables, wanted, numbers):
    """`more` for all with the same tables; else `one` for each."""
    if any(jax.tree.leaves(batched[0])):
        axes = jax.tree.map(lambda is_batched: 0 if is_batched else None, tuple(batched))
        found = jax.vmap(one.fun, in_axes=axes)(tables, wanted, numbers)
    else:
        wanted, numbers = jax.tree.map(
            lambda x, is_batched: x if is_batched else jnp.broadcast_to(x, (size, *x.shape)),
            (wanted, numbers),
            tuple(batched[1:]),
        )
        found = more(tables, wanted, numbers)
    return found, jax.tree.map(lambda _: True, found)
