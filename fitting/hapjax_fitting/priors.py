"""What is known of the free numbers before the recordings are looked at: Gaussian priors, as rows of the least squares."""

from collections.abc import Mapping
from numbers import Real
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hapjax import InputError

from .parameters import Parameter
from .transform import Log


class Priors(eqx.Module):
    """Of which of the free numbers (`places`) something is known: the `mean` and the `deviation` of each.

    `scale`: what they are off counts so many times, as the data's residuals are that much larger than their noise.
    """

    mean: Float[Array, " k"]
    deviation: Float[Array, " k"]
    scale: Float[Array, ""]
    places: tuple[int, ...] = eqx.field(static=True)

    def residuals(self, parameters: tuple[Parameter, ...], free: Float[Array, " p"]) -> Float[Array, " k"]:
        """How many deviations each number is off, times `scale`: the logarithm of one above 0, any other's value."""
        found = [_known(parameters[i], free[i]) for i in self.places]
        return self.scale * (jnp.stack(found) - self.mean) / self.deviation


def _known(parameter: Parameter, free: Array) -> Array:
    return free if isinstance(parameter.transform, Log) else parameter.transform.value(free)


def priors_of(
    given: Mapping[str, tuple[float, float]] | None, parameters: tuple[Parameter, ...], dtype: Any
) -> Priors | None:
    """Priors by path, each (mean, standard deviation). **Raises:** `InputError` for paths that are not free, and numbers
    that no prior has."""
    known: dict[int, tuple[float, float]] = {}
    for path, numbers in (given or {}).items():
        places = [i for i, p in enumerate(parameters) if p.answers_to(path)]
        if not places:
            names = ", ".join(p.name for p in parameters)
            raise InputError(f"priors names {path}, which is not free; allowed: {names}")
        mean, deviation = _checked(path, numbers)
        for i in places:
            if i in known:
                raise InputError(f"priors names {parameters[i].name} twice; allowed: each number once")
            known[i] = _of(parameters[i], mean), deviation
    if not known:
        return None
    means, deviations = zip(*known.values(), strict=True)
    return Priors(
        jnp.asarray(means, dtype), jnp.asarray(deviations, dtype), jnp.ones((), dtype), tuple(known)
    )


def _checked(path: str, numbers: Any) -> tuple[float, float]:
    pair = tuple(numbers) if isinstance(numbers, list | tuple) else ()
    if len(pair) != 2 or not all(isinstance(x, Real) and np.isfinite(float(x)) for x in pair) or pair[1] <= 0:
        raise InputError(
            f"the prior of {path} is {numbers!r}; allowed: (mean, standard deviation), the latter above 0"
        )
    return float(pair[0]), float(pair[1])


def _of(parameter: Parameter, mean: float) -> float:
    if isinstance(parameter.transform, Log):
        if mean <= 0:
            raise InputError(f"the prior of {parameter.name} has the mean {mean:g}; allowed: above 0")
        return float(np.log(mean))
    return mean
