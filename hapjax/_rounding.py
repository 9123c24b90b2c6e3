"""Programs that are rounded alike wherever a compiler puts them.

Where a product goes into a sum, a compiler may round both at once, or not, as the pieces of a program happen to be ordered.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from jax.extend.core import ClosedJaxpr, Jaxpr, Literal

_INNER = {"jit": "jaxpr", "custom_jvp_call": "call_jaxpr"}
# What begins with a sum, what ends in a product, and what is made of both: polynomials.
_SUMS, _PRODUCTS = {"add", "sub", "reduce_sum", "cumsum"}, {"mul", "square", "integer_pow", "div"}
_MADE = {"sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "rem"}
_MADE |= {"exp", "exp2", "expm1", "log", "log1p", "pow", "rsqrt", "cbrt", "logistic", "erf"}


def rounded_apart(closed: ClosedJaxpr, constants: Sequence[Any], arguments: Sequence[Any], zero: Any) -> list:
    """The results of a program without inner ones, in which each product that a sum may follow has `zero` taken from it.

    The compiler does not know what `zero` is, and a product rounded together with this difference is rounded as alone.
    """
    summed = _summed(closed.jaxpr)

    def one(equation, inputs):
        found = as_it_is(equation, inputs)
        product = equation.primitive.name in _PRODUCTS | _MADE and equation.outvars[0] in summed
        return [found[0] - zero] if product and found[0].dtype == zero.dtype else found

    return evaluated(closed, constants, arguments, one)


def _summed(jaxpr: Jaxpr) -> set[Any]:
    """The variables that go into a sum, as they are or moved about."""
    fixed, summed = set(jaxpr.constvars), set()

    def is_fixed(variable):
        return isinstance(variable, Literal) or variable in fixed

    for equation in jaxpr.eqns:
        if all(map(is_fixed, equation.invars)):
            fixed.update(equation.outvars)
    for equation in reversed(jaxpr.eqns):
        name = equation.primitive.name
        if name in _PRODUCTS:  # Twice a number is compiled as its sum with itself.
            goes = any(map(is_fixed, equation.invars))
        else:
            goes = name in _SUMS | _MADE or not summed.isdisjoint(equation.outvars)
        if goes:
            summed.update(v for v in equation.invars if not is_fixed(v))
    return summed


def inner(equation: Any) -> ClosedJaxpr | None:
    """The program that an equation only calls."""
    return equation.params.get(_INNER.get(equation.primitive.name, ""))


def equations(jaxpr: Jaxpr) -> Iterator[Any]:
    """All equations of a program, those of inner ones at their places."""
    for equation in jaxpr.eqns:
        called = inner(equation)
        yield from (equation,) if called is None else equations(called.jaxpr)


def evaluated(
    closed: ClosedJaxpr,
    constants: Sequence[Any],
    arguments: Sequence[Any],
    one: Callable[[Any, list[Any]], list[Any]],
) -> list[Any]:
    """The results of a program of which `one` evaluates each equation."""
    jaxpr = closed.jaxpr
    known = dict(zip([*jaxpr.constvars, *jaxpr.invars], [*constants, *arguments], strict=True))

    def read(variable):
        return variable.val if isinstance(variable, Literal) else known[variable]

    for equation in jaxpr.eqns:
        known |= dict(zip(equation.outvars, one(equation, [read(v) for v in equation.invars]), strict=True))
    return [read(v) for v in jaxpr.outvars]


def as_it_is(equation: Any, inputs: list[Any]) -> list[Any]:
    """What an equation says."""
    found = equation.primitive.bind(*inputs, **equation.params)
    return found if equation.primitive.multiple_results else [found]
