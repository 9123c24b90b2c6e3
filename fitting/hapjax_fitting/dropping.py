"""Samples of which the model says nothing, because it left the range of sense before them: found and left out."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from hapjax import Scene

from .noise import lost
from .observation import Observation, Samples, predicted
from .problem import Problem, channels_of, side_by_side
from .result import Estimate, FitResult

# Of which recording, of which channel, which row.
Dropped = frozenset[tuple[int, str, int]]


def without(laid: Sequence[Observation], dropped: Dropped) -> dict[int, Observation]:
    """What is left of each observation, by its place; those of which nothing is are not among them."""
    rows: dict[tuple[int, str], list[int]] = {}
    for place, channel, row in dropped:
        rows.setdefault((place, channel), []).append(row)

    def part(samples: Samples | None, place: int, channel: str) -> Samples | None:
        if samples is None or (place, channel) not in rows:
            return samples
        left = jax.tree.map(lambda x: jnp.delete(x, np.array(rows[place, channel]), axis=0), samples)
        return left if len(left.value) else None

    found = {
        i: replace(o, force=part(o.force, i, "force"), pose=part(o.pose, i, "pose"))
        for i, o in enumerate(laid)
    }
    return {i: o for i, o in found.items() if o.force is not None or o.pose is not None}


def lost_at(
    free: Float[Array, " p"],
    residuals: Float[np.ndarray, " n"],
    problem: Problem,
    scene: Scene,
    laid: Sequence[Observation],
    dropped: Dropped,
) -> Dropped:
    """Which samples, of those too that were dropped, the model is lost at, with these numbers.

    Of recordings that were dropped whole, and have no numbers in the problem any more, all still are.
    """
    if not dropped and not any(lost(r).any() for _, r in channels_of(residuals, problem)):
        return dropped
    used = list(without(laid, dropped))
    whole = side_by_side(scene, [laid[i] for i in used], problem.parameters, problem.sensors)
    found = {(place, channel, row) for place, channel, row in dropped if place not in used}
    for group, rows in zip(whole, _missing(free, replace(problem, groups=whole)), strict=True):
        places = np.asarray(group.place).tolist()
        for channel, missing in rows.items():
            found |= {(used[places[i]], channel, row) for i, row in np.argwhere(missing).tolist()}
    return frozenset(found)


@jax.jit
def _missing(free: Float[Array, " p"], problem: Problem) -> list[dict[str, Bool[Array, "R N"]]]:
    """Which samples the model says nothing of, in each group's channels."""

    def one(observation: Observation) -> dict[str, Bool[Array, " N"]]:
        setup = problem.setup_at(free, observation.place)
        said = predicted(setup.scene, observation, setup.sensor, setup.start)
        missing = {key: jnp.any(jnp.isnan(value), axis=(1, 2)) for key, value in said.items()}
        return {key: getattr(observation, key).only(of_channel) for key, of_channel in missing.items()}

    return [jax.vmap(one)(group) for group in problem.groups]


def lost_of(dropped: Dropped, names: Sequence[str]) -> dict[str, int]:
    """How many samples of each recording that has any are dropped, by its name."""
    found = Counter(names[place] for place, _, _ in dropped)
    return {name: found[name] for name in names if name in found}


def of_nothing(result: FitResult) -> FitResult:
    """The result without a figure: the model followed too few of the recordings' samples for any."""
    reason = "the model left the range of sense"
    unknown = Estimate(None, None, (None, None), False, reason=reason)
    return replace(
        result,
        parameters=dict.fromkeys(result.parameters, unknown),
        loss=float("nan"),
        residual_rms={},
        noise={},
        measured={},
        identifiability=(),
        converged=False,
        reason=f"{reason} at all samples, or at all but too few",
    )
