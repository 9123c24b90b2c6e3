"""Checks of the numbers a user gives, each refusing in one sentence."""

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array

from .errors import InputError


def as_float(value: Any) -> Any:
    """A number, list or array as a strongly typed floating JAX array.

    What is no number passes as it is, for the field's check to refuse.
    """
    if value is None:
        return None
    dtype = getattr(value, "dtype", None)
    if dtype is not None and jnp.issubdtype(dtype, jnp.floating):
        # A NumPy float64 is a float32 where JAX has 64-bit numbers off; asking for more would warn.
        return jnp.asarray(value, jax.dtypes.canonicalize_dtype(dtype))
    with suppress(OverflowError, ValueError):  # integers beyond all floats, lists beyond all dimensions
        if _is_numeric(value):
            return jnp.asarray(value, jnp.result_type(float))
    return value


def _is_numeric(value: Any) -> bool:
    if isinstance(value, (bool, str)):
        return False
    if isinstance(value, (list, tuple)):
        return all(_is_numeric(v) for v in value) and len({np.shape(v) for v in value}) <= 1
    return isinstance(value, (int, float, np.number, np.ndarray, jax.Array))


def flag(field: str) -> Callable[[Any], bool]:
    """A converter that lets nothing but true and false pass."""

    def convert(value: Any) -> bool:
        if not isinstance(value, bool):
            raise InputError(f"{field} is {value!r}; allowed: true or false")
        return value

    return convert


def count(field: str, high: int) -> Callable[[Any], int]:
    """A converter that lets nothing but whole numbers from 1 to `high` pass."""

    def convert(value: Any) -> int:
        if not isinstance(value, int) or isinstance(value, bool) or not 1 <= value <= high:
            raise InputError(f"{field} is {value!r}; allowed: a whole number from 1 to {high}")
        return value

    return convert


def is_traced(value: Any) -> bool:
    """Whether the value is known only when the traced function runs, so that its range cannot be checked."""
    return isinstance(value, Tracer)


def check_number(
    field: str,
    value: Any,
    allowed: str,
    *,
    shape: tuple[int, ...] = (),
    other: tuple[int, ...] | None = None,
    low: float = -np.inf,
    high: float = np.inf,
    open_low: bool = False,
) -> None:
    """Refuse `value` unless it has the shape (or the `other` one), is finite and in the range.

    Of a traced value only the shape is known. `allowed` is the range in words; `open_low` excludes `low` itself.
    """
    shapes = (shape,) if other is None else (shape, other)
    if not isinstance(value, (Array, np.ndarray)) or value.shape not in shapes:
        raise InputError(f"{field} is {_show(value)}, which is not {_describe(shapes)}; allowed: {allowed}")
    if is_traced(value):
        return
    number = np.asarray(value)
    below = number <= low if open_low else number < low
    if not np.all(np.isfinite(number)) or np.any(below) or np.any(number > high):
        raise InputError(f"{field} is {_show(value)}; allowed: {allowed}")


def check_positive(field: str, value: Any, *, shape: tuple = (), unit: str) -> None:
    """Refuse `value` unless every number in it is finite and above 0."""
    check_number(field, value, f"above 0 {unit}".strip(), shape=shape, low=0.0, open_low=True)


def check_not_negative(field: str, value: Any, *, shape: tuple = (), unit: str) -> None:
    """Refuse `value` unless every number in it is finite and 0 or above."""
    check_number(field, value, " ".join(f"0 {unit} or above".split()), shape=shape, low=0.0)


def _describe(shapes: tuple[tuple[int, ...], ...]) -> str:
    words = {
        (): "one number",
        (0,): "one number",
        (3,): "three numbers",
        (4,): "four numbers",
        (3, 3): "a 3x3 matrix",
    }
    return " or ".join(words[s] if s in words else f"{s[0]} numbers" for s in shapes)


def _show(value: Any) -> str:
    if isinstance(value, (jax.Array, np.ndarray)) and not is_traced(value):
        return str(np.asarray(value).tolist())
    return repr(value)[:80]
