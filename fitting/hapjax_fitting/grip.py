"""The largest |f_t| / f_n that was seen: what mu is at least, where nothing slipped."""

from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from hapjax import Scene, init, rollout
from hapjax import safe
from jaxtyping import Array, Float

from .observation import Observation
from .parameters import Parameter


@jax.jit
def grips(scene: Scene, hips: Float[Array, "R T F 3"]):
    """Normal and tangential force (N) of every finger on every object, and of every contact point, over time."""

    def one(path):
        _, reply = rollout(scene, init(scene, path[0]), path)
        touches = {("object", n): t for n, t in reply.touch.items()} | {
            ("contact", n): t for n, t in reply.contact.items()
        }
        return {
            f"{kind}.{n}": (t.normal_force, safe.norm(t.friction_force)) for (kind, n), t in touches.items()
        }

    return jax.vmap(one)(hips)


def largest_ratio(scene: Scene, groups: Sequence[Observation], parameter: Parameter) -> float:
    """The largest ratio of tangential to normal force in the model of the recordings; 0 where nothing touches.

    Touches of less than a thousandth of the firmest one are left out: their ratio is a quotient of rounding errors.
    """
    part = ".".join(parameter.path.split(".")[:2])
    largest = 0.0
    for group in groups:
        normal, tangential = (np.asarray(x, np.float64) for x in grips(scene, group.hips)[part])
        firm = normal > 1e-3 * normal.max(initial=0)
        largest = max(largest, float(np.max(tangential[firm] / normal[firm], initial=0)))
    return largest
