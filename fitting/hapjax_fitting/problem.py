"""The least-squares problem of a fit: its residuals and the loss."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from hapjax import Recording, Scene

from .lengths import alike
from .noise import spread_of
from .observation import PERFECT, Noise, Observation, Samples, observation_of, residuals
from .parameters import Parameter, moves_surface, report, reported, stems_of, values_of, with_values
from .priors import Priors
from .robust import rooted, spreads, unrooted
from .sensors import Sensors, Setup
from .sharding import each, gathered
from .solve import with_loss
from .spells import spells_of
from .start import Starts

# Twice a difference in loss is chi-squared with one degree of freedom, which exceeds this once in a hundred.
NOTICEABLE = 6.635
_LANES = 384  # rollouts side by side, those of derivatives among them
# Residuals, in the order in which a group's stand in one vector.
KEYS = ("force", "position", "angle")


class Problem(eqx.Module):
    """What the residuals need besides the free numbers. Recordings of about equal sizes are stacked, to run
    side by side."""

    scene: Scene
    groups: tuple[Observation, ...]
    noise: Noise
    parameters: tuple[Parameter, ...] = eqx.field(static=True)
    sensors: Sensors = eqx.field(default_factory=Sensors)
    priors: Priors | None = None
    starts: Starts = eqx.field(default_factory=dict)
    loss: str = eqx.field(static=True, default="squares")

    @property
    def apart(self) -> bool:
        """Whether some numbers are of one recording each."""
        return any(p.place is not None for p in self.parameters)

    @property
    def reported(self) -> tuple[Parameter, ...]:
        """The parameters as results name them."""
        return reported(self.parameters)

    def report(self, free: Float[Array, " p"]) -> Float[Array, " p"]:
        """The unconstrained numbers of the reported parameters."""
        return report(self.parameters, free)

    def by_reported(self, free: Float[Array, " p"]) -> Float[np.ndarray, "p p"] | None:
        """The derivative of the free numbers by the reported ones (the delta method); `None`: they are the same."""
        if self.reported == self.parameters:
            return None
        return np.linalg.inv(np.asarray(jax.jacfwd(self.report)(free)))

    def scene_at(self, free: Float[Array, " p"], place: Int[Array, ""] | int = 0) -> Scene:
        """The scene with the free numbers put in, and with those of one recording."""
        return self.setup_at(free, place).scene

    def setup_at(self, free: Float[Array, " p"], place: Int[Array, ""] | int = 0) -> Setup:
        """The scene and the sensors with the free numbers put in, and with those of one recording."""
        setup = self._given(place)
        if not self.apart:
            values = [p.transform.value(x) for p, x in zip(self.parameters, free, strict=True)]
            return with_values(setup, self.parameters, jnp.stack(values))
        shown = tuple(self.parameters[i[0]] for i in self.stems())
        return with_values(setup, shown, jnp.stack([self._value(i, free, place) for i in self.stems()]))

    def _value(
        self, stem: Sequence[int], free: Float[Array, " p"], place: Int[Array, ""] | int
    ) -> Float[Array, ""]:
        """One recording's value of a number of which it has its own, or which all share."""
        which = place if len(stem) > 1 else 0
        first, *others = (self.parameters[i].transform for i in stem)
        if all(other == first for other in others):  # a few operations, however many recordings there are
            return first.value(free[jnp.asarray(stem)[which]])
        return jnp.stack([self.parameters[i].transform.value(free[i]) for i in stem])[which]

    def own(self, place: Int[Array, ""] | int) -> Int[Array, " q"] | None:
        """Which of the free numbers one recording depends on; `None`: on all."""
        if not self.apart:
            return None
        of_each = [jnp.asarray(i)[place] if len(i) > 1 else jnp.asarray(i[0]) for i in self.stems()]
        return jnp.stack(of_each)

    def stems(self) -> list[list[int]]:
        """The places of the free numbers, those of one path of all recordings together."""
        return stems_of(self.parameters)

    def _given(self, place: Int[Array, ""] | int) -> Setup:
        """Scene, sensors and one recording's starts as they were before the fit."""
        return Setup(self.scene, self.sensors, jax.tree.map(lambda x: x[place], self.starts))

    def known(self) -> int:
        """Of how many numbers something is known beforehand."""
        return 0 if self.priors is None else len(self.priors.places)

    def weighing(self, variance: float) -> "Problem":
        """The problem for data whose whitened residuals have this variance, over which its loss is minus the logarithm of
        the posterior density: priors count as much more as the data's loss is too large."""
        if self.priors is None:
            return self
        scale = jnp.full_like(self.priors.scale, np.sqrt(variance))
        return replace(self, priors=replace(self.priors, scale=scale))

    @property
    def weighed(self) -> float:
        """The variance of whitened residuals that it is `weighing`."""
        return 1.0 if self.priors is None else float(self.priors.scale) ** 2

    def fitted(self) -> int:
        """How many of the free numbers were fitted to the recordings alone."""
        return max(0, len(self.parameters) - self.known())

    def measured(self) -> int:
        """How many numbers were measured: a pose is seven, of which six are free."""
        return numbers_in(self.groups)

    def start(self) -> Float[Array, " p"]:
        """The free numbers of the scene as it was given."""
        values = [values_of(self._given(p.place or 0), (p,))[0] for p in self.parameters]
        return jnp.stack([p.transform.free(v) for p, v in zip(self.parameters, values, strict=True)])


def numbers_in(observations: Collection[Observation]) -> int:
    """How many numbers were measured in them: a pose is seven, of which six are free."""
    return sum(observation.numbers() for observation in observations)


def grouped(
    scene: Scene,
    recordings: Sequence[Recording],
    channels: tuple[str, ...],
    names: Sequence[str],
    parameters: tuple[Parameter, ...],
    sensors: Sensors = PERFECT,
) -> tuple[Observation, ...]:
    """Observations of about equal sizes stacked along a first axis. **Raises:** `InputError` as
    `observation_of`."""
    laid = [observation_of(scene, r, channels, name) for r, name in zip(recordings, names, strict=True)]
    return side_by_side(scene, laid, parameters, sensors)


def side_by_side(
    scene: Scene, laid: Sequence[Observation], parameters: tuple[Parameter, ...], sensors: Sensors = PERFECT
) -> tuple[Observation, ...]:
    """As `grouped`, of recordings that are laid on the scene's time grid already."""
    placed = [replace(o, place=jnp.asarray(place, jnp.int32)) for place, o in enumerate(laid)]
    stacked = (jax.tree.map(lambda *x: jnp.stack(x), *group) for group in alike(placed))
    if scene.moving() or any(moves_surface(p) for p in parameters):
        return tuple(stacked)
    return tuple(
        group
        if group.gimbals is not None
        else replace(group, spells=spells_of(scene, sensors.turned(group.hips)))
        for group in stacked
    )


def stacked_residuals(free: Float[Array, " p"], problem: Problem) -> Float[Array, " n"]:
    """All whitened residuals in one vector, half the square of which is the loss; those of priors come last."""
    found = [rooted(r.ravel(), problem.loss) for _, r in by_channel(free, problem)]
    if problem.priors is not None:
        found.append(problem.priors.residuals(problem.reported, problem.report(free)))
    return jnp.concatenate(found)


def by_channel(free: Float[Array, " p"], problem: Problem) -> list[tuple[str, Float[Array, "_ _ _"]]]:
    """Whitened residuals of each group's channels: of R recordings, N samples of m numbers."""
    shared = free, replace(problem, groups=(), priors=None)
    found = []
    for group in problem.groups:
        found_in = each(residuals_of, shared, group, group.layout, at_once(group))  # which sorts its keys
        found += [(key, found_in[key]) for key in KEYS if key in found_in]
    return found


def at_once(group: Observation, directions: int = 1) -> int | None:
    """How many recordings are best run side by side: on a CPU so many that what a step works on stays in the cache."""
    if jax.default_backend() != "cpu":
        return None
    rollouts = 1 if group.spells is None else group.spells.shape[-2]
    return max(1, _LANES // (rollouts * directions))


def residuals_of(
    shared: tuple[Float[Array, " p"], Problem], observation: Observation
) -> dict[str, Float[Array, "N m"]]:
    """Whitened residuals of one recording, at the free numbers and of the problem that all share."""
    free, problem = shared
    setup = problem.setup_at(free, observation.place)
    return residuals(setup.scene, observation, problem.noise, setup.sensor, setup.start)


def channels_of(stacked: Float[Any, " n"], problem: Problem) -> list[tuple[str, Float[np.ndarray, "_ _ _"]]]:
    """The residuals in one vector, taken apart again: of recordings of one length each, without those of priors."""
    found = []
    for key, group, samples, piece in pieces_of(unrooted(np.asarray(stacked), problem.loss), problem):
        times = piece.shape[1]
        taken = None if samples.taken is None else gathered(samples.taken)[: group.count]
        lengths = [times] if taken is None else np.unique(taken).tolist()
        found += [(key, piece[(slice(None) if taken is None else taken == n), :n]) for n in lengths]
    return found


def losses_of(stacked: Float[Any, " n"], problem: Problem) -> Float[np.ndarray, " R"]:
    """The part that each recording has in the loss."""
    found = np.zeros(1 + max(int(group.places.max()) for group in problem.groups))
    for _, group, _, piece in pieces_of(np.asarray(stacked, np.float64), problem):
        found[group.places] += 0.5 * np.sum(piece**2, axis=(1, 2))
    return found


def pieces_of(
    stacked: Float[np.ndarray, " n"], problem: Problem
) -> Iterator[tuple[str, Observation, Samples, Float[np.ndarray, "R N m"]]]:
    """Of each channel of each group: name, group, what was measured, and its part of numbers that stand as residuals do."""
    begin = 0
    for group in problem.groups:
        for key, samples in zip(KEYS, (group.force, group.pose, group.pose), strict=True):
            if samples is None:
                continue
            times, things = samples.value.shape[1:3]
            size = group.count * times * things * 3
            yield key, group, samples, stacked[begin : begin + size].reshape(group.count, times, things * 3)
            begin += size


def loss_at(free: Float[Array, " p"], problem: Problem) -> Float[Array, ""]:
    """Half the sum of the squared whitened residuals."""
    return with_loss(stacked_residuals, free, problem)[0]


def residuals_at(free: Float[Array, " p"], problem: Problem) -> np.ndarray:
    """`stacked_residuals`, by the program that `loss_at` compiled."""
    return gathered(with_loss(stacked_residuals, free, problem)[1])


def spread_at(
    problem: Problem, residuals: Float[np.ndarray, " n"], noise: Mapping[str, float] | None
) -> tuple[dict[str, float], Float[np.ndarray, " m"], float]:
    """Of each channel the root mean square of its residuals; of each residual what variance it stands for in the
    covariance; and what variance they stand for in the loss, on average."""
    channels = channels_of(residuals, problem)
    size, variance = spread_of(channels, noise, problem.fitted())
    typical = float(np.mean(variance))
    if problem.loss != "squares":
        typical, variance = spreads(channels, noise, problem.loss)
    return size, variance, typical
