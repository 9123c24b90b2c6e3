"""A short program that a CPU runs as one function, for calls in which what surrounds the arithmetic counts.

XLA makes a function of each piece that it fuses, some eighty in a step, which its runtime hands out one by one; and at each
call it takes and gives back memory for every reduction and every table of numbers, of 0.1 us each. A call that is marked
becomes one function, in which a reduction is as slow as it was: so those of few numbers are written out.
"""

import math
import os
import platform
from collections.abc import Callable, Sequence
from functools import partial, reduce
from importlib.metadata import version
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.experimental.xla_metadata import set_xla_metadata
from jax.extend.core import ClosedJaxpr
from jax.lax import optimization_barrier as apart
from jaxtyping import Array

from ._rounding import as_it_is, equations, evaluated, inner, rounded_apart

_FOLDS = {"reduce_sum": jnp.add, "reduce_max": jnp.maximum, "reduce_min": jnp.minimum}
_FOLDS |= {"reduce_and": jnp.logical_and, "reduce_or": jnp.logical_or}
_MOST = 128  # numbers reduced to one: of more, the code is longer than what it saves
# The jaxlib and the processor with which all this was tried: what XLA makes of a mark is no promise.
_TRIED = "0.10.2", "x86_64"
# What XLA is known to put into one function. It cannot put there loops and calls of libraries, which it makes of reductions
# of many numbers too.
_FIT = {
    *"abs neg sign add sub mul div rem max min square sqrt rsqrt cbrt integer_pow pow clamp".split(),
    *"sin cos tan asin acos atan atan2 sinh cosh tanh exp exp2 expm1 log log1p logistic erf".split(),
    *"floor ceil round eq ne lt le gt ge and or not xor is_finite select_n convert_element_type".split(),
    *"broadcast_in_dim reshape squeeze expand_dims transpose rev slice split concatenate stack".split(),
    *"pad dynamic_slice gather iota copy name stop_gradient optimization_barrier".split(),
}
_LARGE = 1000  # equations: of more, one function takes far longer to compile than its pieces
_WIDE = 1000  # numbers in an array: of more, XLA shares out the work among threads
# In flags for XLA, which may also be a file's name. A loop's functions then take minutes to compile, or more becomes calls
# of libraries.
_OTHERWISE = ("xla_backend_extra_options", "xla_cpu_experimental")


def one_function(f: Callable[[Array], Array], like: jax.ShapeDtypeStruct) -> Callable[[Array], Array] | None:
    """`f` of a vector `like` this, such that XLA compiles it for a CPU into one function; `None`: it does not.

    The vector that the function is called with ends in a 0 more, and so does what it returns. Results are those of `f`
    but for rounding, and the same bits wherever it is called from: a sum is taken in the order of its axes.
    """
    if not is_tried():
        return None
    closed = jax.make_jaxpr(f)(like)
    if len([*equations(closed.jaxpr)]) > _LARGE:
        return None
    closed = jax.make_jaxpr(partial(_written_out, closed))(like)
    if not all(_fits(equation) for equation in equations(closed.jaxpr)):
        return None

    @jax.jit
    def whole(x):
        # XLA ends the process at an argument of a marked call that nothing in it reads. There is but one, of which a
        # number is in the result.
        found = rounded_apart(closed, _together(closed.consts, x.dtype), [x[:-1]], x[-1])[0]
        return jnp.concatenate([found, x[-1:]])

    def marked(x) -> Any:
        return set_xla_metadata(whole(x), inlineable="false", xla_cpu_small_call="true")

    return marked


def is_tried(*arguments: Any) -> bool:
    """Whether it is known what becomes of a marked call, of what is made of these arguments."""
    if (version("jaxlib"), platform.machine()) != _TRIED or jax.default_backend() != "cpu":
        return False
    if jax.device_count() > 1:  # which XLA may have send each other what is inside of a call
        return False
    flags = os.environ.get("XLA_FLAGS", "")
    if flags[:1] not in ("", "-") or any(name in flags for name in _OTHERWISE):
        return False
    # Inside `shard_map`, types say over which devices numbers vary.
    return not any(jax.typeof(x).manual_axis_type.varying for x in jax.tree.leaves(arguments))


def _fits(equation: Any) -> bool:
    return equation.primitive.name in _FIT and all(x.aval.size <= _WIDE for x in equation.outvars)


def _written_out(closed: ClosedJaxpr, *arguments: Any) -> list[Any]:
    """The results of a program, with its reductions of few numbers as chains of operations on two."""

    def one(equation, inputs):
        name, found, called = equation.primitive.name, equation.params, inner(equation)
        if called is not None:
            return _written_out(called, *inputs)
        if "axes" in found and 1 <= math.prod(inputs[0].shape[axis] for axis in found["axes"]) <= _MOST:
            if name in _FOLDS:
                # Apart, or each number is found anew wherever it is used.
                return [apart(reduce(_FOLDS[name], _slices(inputs[0], found["axes"])))]
            if name == "argmax":
                return [_argmax(_slices(inputs[0], found["axes"]), found["index_dtype"])]
        return as_it_is(equation, inputs)

    return evaluated(closed, closed.consts, arguments, one)


def _slices(x: Array, axes: Sequence[Any]) -> list[Array]:
    """What is left of `x` at each place of some axes."""
    parts = [x]
    for axis in sorted(axes, reverse=True):
        parts = [
            jax.lax.index_in_dim(p, i, axis, keepdims=False) for p in parts for i in range(p.shape[axis])
        ]
    return parts


def _argmax(slices: list[Array], dtype: Any) -> Array:
    """Which number is the largest, the first of equals, or the first NaN."""
    best, place = slices[0], jnp.zeros(slices[0].shape, dtype)
    for i, one in enumerate(slices[1:], 1):
        more = (one > best) | (jnp.isnan(one) & ~jnp.isnan(best))
        best, place = jnp.where(more, one, best), jnp.where(more, jnp.asarray(i, dtype), place)
    return place


def _together(tables: Sequence[Any], dtype: Any) -> list[Any]:
    """Tables, of which those of numbers of a `dtype` are parts of one."""
    ours = [x for x in tables if x.dtype == dtype]
    if not ours:
        return [*tables]
    ends = np.cumsum([x.size for x in ours]).tolist()
    parts = iter(jnp.split(apart(jnp.concatenate([x.ravel() for x in ours])), ends[:-1]))
    return [next(parts).reshape(x.shape) if x.dtype == dtype else x for x in tables]
