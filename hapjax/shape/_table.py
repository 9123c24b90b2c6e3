"""Rows of long tables."""

import functools

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float, Int

_FEW = 80  # of three fingers; more take long to compile


@jax.custom_jvp
def rows(table: Float[Array, "N *row"], index: Int[Array, "*n"]) -> Float[Array, "..."]:
    """`table[index]`, a few rows read one by one.

    XLA's CPU compiler counts a gather that is fused with others as one that reads the whole table, and spreads it over
    threads; to wake them takes longer than a step. A slice it counts as what it is.
    """
    flat = jax.vmap(_read, in_axes=(None, 0))(table, index.ravel()) if index.ndim else _read(table, index)
    return flat.reshape(*index.shape, *table.shape[1:])


@functools.partial(rows.defjvp, symbolic_zeros=True)
def _(primals, tangents):
    (table, index), (moved, _) = primals, tangents
    found = rows(table, index)
    # In `defjvp` of a table that stands still nothing as long as the table may be made.
    return found, jnp.zeros_like(found) if isinstance(moved, SymbolicZero) else moved[index]


@custom_vmap
def _read(table: Float[Array, "N *row"], index: Int[Array, ""]) -> Float[Array, "*row"]:
    return lax.dynamic_index_in_dim(table, index, keepdims=False)


@_read.def_vmap
def _(size, batched, table, index):
    if batched[0]:
        return jax.vmap(lambda t, i: t[i], in_axes=(0, 0 if batched[1] else None))(table, index), True
    if not 0 < size <= _FEW:
        return table[index], True
    return jnp.stack([_read(table, i) for i in index]), True
