"""How a recording was measured: what sensors add to, and take from, what happened."""

from dataclasses import fields
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hapjax import InputError, Scene, rotation

from .start import Starts

# What each number is where a sensor is perfect, and how far off starts of a fit are to be.
_NEUTRAL = {
    "force_bias": ((0.0, 0.0, 0.0), 0.2),
    "force_gain": ((1.0, 1.0, 1.0), 0.2),
    "force_delay": (0.0, 5e-3),
    "pose_delay": (0.0, 5e-3),
    "hip_rotation": ((0.0, 0.0, 0.0), 0.05),
}
_WIDEST = {"sensor.force_delay": 0.02, "sensor.pose_delay": 0.02, "sensor.hip_rotation": 0.1}


def _number(value: Any) -> Any:
    return None if value is None else jnp.asarray(value, jnp.result_type(float))


class Sensors(eqx.Module):
    """Numbers beside a scene that say how it was measured; what is `None` is perfect and costs nothing.

    **Arguments:**

    - `force_bias`: N, and `force_gain`, along the world's x, y, z: measured = gain times force + bias, of every finger.
    - `force_delay`, `pose_delay`: s, above 0 where the channel is late against HIP: its sample of time t shows what was
      at t less the delay. Beyond the ends of the path the model stays as it was there.
    - `hip_rotation`: rad, rotation vector of the frame that HIP was recorded in, about the world's origin: world = R HIP.

    **Raises:** `InputError` for numbers that are not finite or of another shape, and gains not above 0.
    """

    force_bias: Float[Array, "3"] | None = eqx.field(converter=_number, default=None)
    force_gain: Float[Array, "3"] | None = eqx.field(converter=_number, default=None)
    force_delay: Float[Array, ""] | None = eqx.field(converter=_number, default=None)
    pose_delay: Float[Array, ""] | None = eqx.field(converter=_number, default=None)
    hip_rotation: Float[Array, "3"] | None = eqx.field(converter=_number, default=None)

    def __check_init__(self):
        for field, (neutral, _) in _NEUTRAL.items():
            value, shape = getattr(self, field), np.shape(neutral)
            if value is None:
                continue
            if value.shape != shape or not np.all(np.isfinite(value)):
                kind = "three finite numbers" if shape else "one finite number"
                raise InputError(f"{field} is {np.asarray(value).tolist()}; allowed: {kind}")
        if self.force_gain is not None and not np.all(self.force_gain > 0):
            raise InputError(
                f"force_gain is {np.asarray(self.force_gain).tolist()}; allowed: three numbers above 0"
            )

    def turned(self, hips: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """Recorded positions in the world's frame, m."""
        if self.hip_rotation is None:
            return hips
        return rotation.turn(rotation.to_matrix(rotation.from_rotation_vector(self.hip_rotation)), hips)

    def shown(self, force: Float[Array, "*n F 3"]) -> Float[Array, "*n F 3"]:
        """What the force sensors show of forces, N."""
        gained = force if self.force_gain is None else force * _row(self.force_gain, force)
        return gained if self.force_bias is None else gained + _row(self.force_bias, force)

    def corrected(self, force: Float[Array, "*n F 3"]) -> Float[Array, "*n F 3"]:
        """The forces that the force sensors show, N: the inverse of `shown`."""
        level = force if self.force_bias is None else force - _row(self.force_bias, force)
        return level if self.force_gain is None else level / _row(self.force_gain, force)


def _row(value: Array, like: Array) -> Array:
    return value.reshape((1,) * (like.ndim - 1) + (3,))


class Setup(eqx.Module):
    """All that a fit may find: the scene, the sensors, whose paths begin with `sensor`, and how its objects move at the
    beginning, whose paths begin with `start`."""

    scene: Scene
    sensor: Sensors = eqx.field(default_factory=Sensors)
    start: Starts = eqx.field(default_factory=dict)


def explicit(sensors: Sensors, paths: list[str], dtype: Any) -> Sensors:
    """The sensors with the numbers that free paths name put in where they were absent.

    **Raises:** `InputError` where sensors have no such number.
    """
    values = {field.name: getattr(sensors, field.name) for field in fields(sensors)}
    for path in paths:
        first, _, name = path.partition(".")
        name = name.split("[")[0]
        if first != "sensor":
            continue
        if name not in values:
            allowed = ", ".join(f"sensor.{n}" for n in values)
            raise InputError(f"{path}: sensors have no {name or 'part without a name'}; allowed: {allowed}")
        if values[name] is None:
            values[name] = _NEUTRAL[name][0]
    found = Sensors(**values)
    return Sensors(**{n: None if v is None else jnp.asarray(v, dtype) for n, v in vars(found).items()})


def widest_of(path: str) -> float:
    """The standard error (s, rad) from which on a number counts as not identified: of a frame or a clock that is known no
    better, the recording says nothing. Of numbers that have no natural size, infinite."""
    return _WIDEST.get(path, float("inf"))


def size_of(path: str) -> float | None:
    """How far off a sensor's number is for sure, in its unit or as a logarithm; `None`: it is no sensor's."""
    first, _, name = path.partition(".")
    return _NEUTRAL[name][1] if first == "sensor" else None
