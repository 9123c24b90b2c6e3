"""Rows of long tables."""

import functools

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float, Int

_FEW = 12  # more take long to compile


@jax.custom_jvp
def rows(table: Float[Array, "N *row"], index: Int[Array, "*n"]) -> Float[Array, "..."]:
    """`table[index]`, a few rows read one by one.

    XLA's CPU compiler counts a gather that is fused with others as one that reads the whole table, and spreads it over
    threads; to wake them can take longer than a step. A slice it counts as what it is.
    """
    return _read(table, index)


@functools.partial(rows.defjvp, symbolic_zeros=True)
def _(primals, tangents):
    (table, index), (moved, _) = primals, tangents
    found = rows(table, index)
    # In `defjvp` of a table that stands still nothing as long as the table may be made.
    return found, jnp.zeros_like(found) if isinstance(moved, SymbolicZero) else moved[index]


@custom_vmap
def _read(table: Float[Array, "N *row"], index: Int[Array, "*n"]) -> Float[Array, "..."]:
    if index.size > _FEW:
        return table.at[index].get(mode="clip")
    one = [lax.dynamic_index_in_dim(table, i, keepdims=False) for i in index.ravel()]
    return jnp.stack(one).reshape(*index.shape, *table.shape[1:])


@_read.def_vmap
def _(size, batched, table, index):
    if batched[0]:
        axes = (0, 0 if batched[1] else None)
        return jax.vmap(lambda t, i: t.at[i].get(mode="clip"), in_axes=axes)(table, index), True
    return _read(table, index), True


def span(table: Float[Array, "N"], first: Int[Array, ""], count: int) -> Float[Array, "{count}"]:
    """`count` numbers from the `first`-th on; as many must be left. Not differentiated."""
    return _reader(count)(table, first)


@functools.cache
def _reader(count: int):
    @custom_vmap
    def read(table, first):
        return lax.dynamic_slice_in_dim(table, first, count)

    @read.def_vmap
    def _(size, batched, table, first):
        if size <= _FEW and not batched[0]:
            return jnp.stack([lax.dynamic_slice_in_dim(table, i, count) for i in first]), True
        axes = tuple(0 if is_batched else None for is_batched in batched)
        return jax.vmap(lambda t, i: lax.dynamic_slice_in_dim(t, i, count), in_axes=axes)(table, first), True

    return read
