"""Loops whose reverse-mode gradients remember little."""

import math
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.ad_checkpoint import checkpoint_name

Carry = TypeVar("Carry")
Out = TypeVar("Out")


_DECIDED = "decided"


def decided(x: Any) -> Any:
    """Choices, of a face say, that a gradient through `computed_again` remembers: few bytes, and much work to find."""
    return checkpoint_name(x, _DECIDED)


def computed_again(
    body: Callable[[Carry, Any], tuple[Carry, Out]],
) -> Callable[[Carry, Any], tuple[Carry, Out]]:
    """The body of a loop, of which a reverse-mode gradient remembers what goes in and what was `decided`.

    The rest is sooner computed again than written down.
    """
    policy = jax.checkpoint_policies.save_only_these_names(_DECIDED)
    return jax.checkpoint(body, prevent_cse=False, policy=policy)


def scan_in_segments(
    body: Callable[[Carry, Any], tuple[Carry, Out]], start: Carry, inputs: Any
) -> tuple[Carry, Out]:
    """`jax.lax.scan`, of which a reverse-mode gradient keeps about 2 sqrt(T) of T carries.

    **Arguments:** `body`, which a gradient computes again: one that is `computed_again`.
    """
    steps = len(jax.tree.leaves(inputs)[0])
    root = math.isqrt(max(steps, 1) - 1) + 1
    # Segments that come out even need no copy of what goes in.
    size = next((n for n in range(root, 2 * root) if steps % n == 0), root)
    count = -(-steps // size)

    def one(carry, x):
        number, x = x
        after, out = body(carry, x)
        if steps == count * size:
            return after, out
        # What fills up the last segment is a repeated step that changes nothing.
        return jax.tree.map(lambda new, old: jnp.where(number < steps, new, old), after, carry), out

    def segment(carry, xs):
        return jax.lax.scan(one, carry, xs)

    def cut(x):
        full = jnp.pad(x, [(0, count * size - steps)] + [(0, 0)] * (x.ndim - 1), mode="edge")
        return full.reshape(count, size, *x.shape[1:])

    cuts = jnp.arange(count * size).reshape(count, size), jax.tree.map(cut, inputs)
    end, outs = jax.lax.scan(jax.checkpoint(segment, prevent_cse=False), start, cuts)
    return end, jax.tree.map(lambda x: x.reshape(count * size, *x.shape[2:])[:steps], outs)
