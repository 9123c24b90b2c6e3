"""Transforms between a parameter and the unconstrained number that the solver sees."""

from abc import abstractmethod
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from hapjax import InputError


@runtime_checkable
class Transform(Protocol):
    """A smooth one-to-one map from the real line to the values that a parameter may have."""

    @abstractmethod
    def value(self, free: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """The parameter's value."""

    @abstractmethod
    def free(self, value: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """The unconstrained number of a value."""

    @abstractmethod
    def check(self, name: str, value: float) -> None:
        """Refuse a starting value that the transform cannot reach."""

    @property
    @abstractmethod
    def widest(self) -> float:
        """The standard error of the unconstrained number above which a parameter counts as not identified."""


@dataclass(frozen=True)
class Identity:
    """Any real number; `widest`, where its unit has a size beyond which it is not known at all."""

    widest: float = float("inf")

    def value(self, free: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """The number itself."""
        return free

    def free(self, value: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """The number itself."""
        return value

    def check(self, name: str, value: float) -> None:
        """Every number will do."""


@dataclass(frozen=True)
class Log:
    """Numbers above 0, through their logarithm. A standard error of 1 is a factor of 7 either way at 95 %."""

    widest = 1.0

    def value(self, free: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """exp(free)."""
        return jnp.exp(free)

    def free(self, value: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """log(value)."""
        return jnp.log(value)

    def check(self, name: str, value: float) -> None:
        """Only numbers above 0 have a logarithm."""
        if not value > 0:
            raise InputError(f"{name} starts at {value:g}; allowed for a free parameter: above 0")


@dataclass(frozen=True)
class Logit:
    """Numbers between `low` and `high`, both excluded, through the logit of their place in between."""

    low: float
    high: float
    widest = 1.0

    def value(self, free: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """low + (high - low) / (1 + exp(-free))."""
        return self.low + (self.high - self.low) * jax.nn.sigmoid(free)

    def free(self, value: Float[Array, "*n"]) -> Float[Array, "*n"]:
        """log((value - low) / (high - value))."""
        return jnp.log((value - self.low) / (self.high - value))

    def check(self, name: str, value: float) -> None:
        """Only numbers between the bounds have a logit."""
        if not self.low < value < self.high:
            raise InputError(
                f"{name} starts at {value:g}; allowed: between its bounds {self.low:g} and {self.high:g}"
            )
