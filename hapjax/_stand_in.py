"""A function that is computed in another way where it is only computed, and that on a CPU."""

from collections.abc import Callable, Sequence
from typing import Any

import jax
from jax.extend.core import ClosedJaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir

Flat = Callable[..., list[Any]]  # of arrays one by one


def stand_in(f: Callable[..., Any], quick: Callable[..., Any], *arguments: Any) -> Any:
    """`f` of some pytrees of arrays, for which `quick` stands in on a CPU, where it is neither differentiated nor mapped.

    Both have the same results but for rounding, and close over no other arrays. A gradient, or what `vmap` makes, is that
    of `f`.
    """
    leaves, structure = jax.tree.flatten(arguments)
    closed, shape = jax.make_jaxpr(f, return_shape=True)(*arguments)

    def flat(*leaves):
        return jax.tree.leaves(quick(*jax.tree.unflatten(structure, leaves)))

    return jax.tree.unflatten(jax.tree.structure(shape), _stand_in.bind(*leaves, f=closed, quick=flat))


def _plainly(*leaves: Any, f: ClosedJaxpr, quick: Flat) -> list[Any]:
    return jaxpr_as_fun(f)(*leaves)


def _quickly(*leaves: Any, f: ClosedJaxpr, quick: Flat) -> list[Any]:
    return quick(*leaves)


def _shapes(*_: Any, f: ClosedJaxpr, quick: Flat) -> list[Any]:
    return f.out_avals


def _pushed(
    primals: Sequence[Any], tangents: Sequence[Any], *, f: ClosedJaxpr, quick: Flat
) -> tuple[Sequence[Any], list[Any]]:
    """Forward mode, in those arguments that move."""
    moving = [i for i, tangent in enumerate(tangents) if not isinstance(tangent, ad.Zero)]

    def of_some(*some):
        leaves = list(primals)
        for i, leaf in zip(moving, some, strict=True):
            leaves[i] = leaf
        return jaxpr_as_fun(f)(*leaves)

    found, rates = jax.jvp(of_some, [primals[i] for i in moving], [tangents[i] for i in moving])
    still = [rate.dtype == jax.dtypes.float0 for rate in rates]
    return found, [
        ad.Zero(jax.typeof(x).to_tangent_aval()) if is_still else rate
        for x, rate, is_still in zip(found, rates, still, strict=True)
    ]


def _mapped(
    leaves: Sequence[Any], axes: Sequence[Any], *, f: ClosedJaxpr, quick: Flat
) -> tuple[list[Any], list[int]]:
    found = jax.vmap(jaxpr_as_fun(f), in_axes=tuple(axes))(*leaves)
    return found, [0] * len(found)


_stand_in = Primitive("stand_in")
_stand_in.multiple_results = True
_stand_in.def_impl(_plainly)
_stand_in.def_abstract_eval(_shapes)
ad.primitive_jvps[_stand_in] = _pushed
batching.primitive_batchers[_stand_in] = _mapped
mlir.register_lowering(_stand_in, mlir.lower_fun(_plainly, multiple_results=True))
mlir.register_lowering(_stand_in, mlir.lower_fun(_quickly, multiple_results=True), platform="cpu")
