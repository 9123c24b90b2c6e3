"""The step as a program of few arrays: what it is given, the state and the fingers go in, one array comes out.

A loop of steps, in Python or compiled, takes a fixed time for each array that it hands on, keeps or cuts.
"""

from collections.abc import Callable
from itertools import pairwise
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.extend.core import jaxpr_as_fun
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from ._one_function import one_function
from ._state import Reply, State

_SMALL = 64  # numbers: an array of more is handed over by itself

Arrays = tuple[Array, list[Array]]


class Traced:
    """A function for arguments of certain shapes and types, traced but once, and the shapes that it `found`."""

    def __init__(self, f: Callable[..., Any], *arguments: Any) -> None:
        closed, self.found = jax.make_jaxpr(f, return_shape=True)(*arguments)
        self._call, self._structure = jaxpr_as_fun(closed), jax.tree.structure(self.found)

    def __call__(self, *arguments: Any) -> Any:
        return jax.tree.unflatten(self._structure, self._call(*jax.tree.leaves(arguments)))


class FlatStep(NamedTuple):
    """A step, `call(arrays, memory, hip, gimbal)`: from the memory of the last call the next one.

    A memory has all numbers of a reply, of which the last says whether the step was lost, from `first` on those of the
    state, a 0, and perhaps others. `reply`, of rows of memories too, and `state` make of them what they are the numbers
    of; `before` makes the first one of a state. `in_one`: whether the call is compiled into one function.
    """

    call: Callable[..., Float[Array, "N"]]
    in_one: bool
    first: int
    before: Callable[[State], Array]
    reply: Callable[[Array], Reply]
    state: Callable[[Array], State]

    def rollout(
        self, given: Any, dt: Any, state: State, hips: Array, gimbals: Array | None
    ) -> tuple[State, Reply]:
        """A rollout of what is `given`; cut up at its end, not at each step."""
        arrays = handed((given, dt))[0]

        def one(memory, x):
            memory = self.call(arrays, memory, *x)
            return memory, memory[: self.first]

        memory, replies = jax.lax.scan(one, self.before(state), (hips, gimbals))
        return self.state(memory), self.reply(replies)


def flat_step(step: Traced, given: Any, state: State, hip: Any, dt: Any, gimbal: Any) -> FlatStep:
    """The flat form of a step that was traced with such arguments."""
    (vector, large), whole = handed((given, dt))
    (size, to_state), (first, to_reply) = _parts(state), _parts(step.found[1])
    known, (count, to_fingers) = vector.size, _parts((hip, gimbal))
    end = known + count + size

    def stepped(x, large):
        given, dt = whole(x[:known], large)
        hip, gimbal = to_fingers(x[known:])
        after, reply = step(given, to_state(x[known + count :]), hip, dt, gimbal)
        # The touches often have no reader, but what the compiler leaves out changes how it rounds what is left.
        return _joined((reply, after), x.dtype)

    quick = None if large else one_function(lambda x: stepped(x, []), jax.ShapeDtypeStruct((end,), hip.dtype))

    def call(arrays, memory, hip, gimbal):
        numbers, large = arrays
        x = _joined((numbers, hip, gimbal, memory[first : first + size + 1]), memory.dtype)
        return _joined((stepped(x[:end], large), x[end:]), x.dtype) if quick is None else quick(x)

    def before(state):
        return _joined((jnp.zeros(first, hip.dtype), state, jnp.zeros(1, hip.dtype)), hip.dtype)

    return FlatStep(call, quick is not None, first, before, to_reply, lambda memory: to_state(memory[first:]))


def _joined(tree: Any, dtype: Any) -> Float[Array, "N"]:
    """All numbers of a pytree."""
    return jnp.concatenate([leaf.ravel().astype(dtype) for leaf in jax.tree.leaves(tree)])


def _parts(tree: Any) -> tuple[int, Callable[[Array], Any]]:
    """How many numbers a pytree has, and what makes one of such numbers, of rows of them too, that others may follow."""
    like, structure = jax.tree.flatten(tree)
    ends = np.cumsum([0, *(x.size for x in like)]).tolist()

    def cut(rows: Array) -> Any:
        parts = [rows[..., a:b] for a, b in pairwise(ends)]
        leaves = [
            part.reshape(*rows.shape[:-1], *x.shape).astype(x.dtype)
            for part, x in zip(parts, like, strict=True)
        ]
        return jax.tree.unflatten(structure, leaves)

    return ends[-1], cut


def handed(tree: Any) -> tuple[Arrays, Callable[..., Any]]:
    """A pytree as few arrays, its small ones all in one, and what makes it of them again."""
    leaves, structure = jax.tree.flatten(tree)
    small = [leaf.size <= _SMALL for leaf in leaves]
    vector, apart = ravel_pytree([leaf for leaf, few in zip(leaves, small, strict=True) if few])
    large = [leaf for leaf, few in zip(leaves, small, strict=True) if not few]

    def whole(vector: Array, large: list[Array]) -> Any:
        parts, others = iter(apart(vector)), iter(large)
        return jax.tree.unflatten(structure, [next(parts if few else others) for few in small])

    return (vector, large), whole
