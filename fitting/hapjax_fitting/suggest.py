"""Which motion to record next: the one from which the data that are there would gain most."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hapjax import InputError, Recording

from .breakaway import is_unseen
from .candidates import MOTIONS, contact_of, path_of
from .problem import Problem, by_channel, grouped
from .result import FitResult
from .section import Section
from .transform import Identity
from .whole_body import is_whole

_VAGUE = 1e3  # standard errors of a number without bounds, as known beforehand: hardly at all


@dataclass(frozen=True)
class Suggestion:
    """What each motion of one second would add.

    `gain` by motion: by how much it would raise the logarithm of the information's determinant (D-optimality), nats;
    `errors` by motion and parameter: the standard error with it, of the logarithm where the number is above 0; `now`, the
    standard errors without; `best`, the motion with the largest gain; `best_for`, by parameter the one that leaves the
    smallest error, where any makes a difference; `paths` by motion, (T, F, 3) m, at the scene's dt.
    """

    gain: Mapping[str, float]
    errors: Mapping[str, Mapping[str, float]]
    now: Mapping[str, float]
    best: str
    best_for: Mapping[str, str]
    unseen: tuple[str, ...]
    paths: Mapping[str, np.ndarray]

    def to_dict(self) -> dict[str, Any]:
        """The figures, ready for JSON, without the paths."""
        motions = {name: {"gain": self.gain[name], "errors": dict(self.errors[name])} for name in self.gain}
        return {"best": self.best, "best_for": dict(self.best_for), "now": dict(self.now), "motions": motions}

    def section(self) -> Section:
        """The table, and what to do in sentences."""
        words = [f"Record next: {self.best}, for one second."]
        for name, motion in self.best_for.items():
            factor = self.now[name] / self.errors[motion][name]
            words.append(f"For {name}: {motion} (standard error {factor:.3g} times smaller).")
        words += [
            f"{name} shows only in when something gives way, which is not counted here."
            for name in self.unseen
        ]
        words.append("The errors of numbers above 0 are those of their logarithms, about the relative ones.")
        rows = [("(as it is)", "", *(f"{error:.2g}" for error in self.now.values()))]
        rows += [
            (motion, f"{gain:.3g}", *(f"{error:.2g}" for error in self.errors[motion].values()))
            for motion, gain in sorted(self.gain.items(), key=lambda item: -item[1])
        ]
        return Section("What to record next", tuple(words), ("motion", "gain (nats)", *self.now), tuple(rows))


def suggest(result: FitResult) -> Suggestion:
    """Say which of some motions would shrink the standard errors most, by Fisher's information.

    Press, strokes slow, fast and with rising load, a circle and taps are played through the fitted scene about a contact
    that was recorded, for a second each; measured would be the same channels, as often and with the same noise.
    Information adds up: that of the recordings and that of the motion (Atkinson, Donev, Tobias 2007, Optimum Experimental
    Designs, chapter 10).
    Numbers that the recordings do not identify are taken as they were at the start, and as known to a standard deviation of
    1 in the logarithm; without that, any gain would be infinite.

    **Raises:** `InputError` where nothing touched in the recordings.
    """
    contact = contact_of(result)
    if contact is None:
        raise InputError(
            "suggest has no contact to go by: nothing touched; allowed: recordings with a contact"
        )
    problem, names = result.problem, list(result.parameters)
    identified = np.array([p.identified for p in result.parameters.values()])
    whole = np.array(
        [is_whole(p.path) for p in problem.parameters]
    )  # of which each number is of all that is reported
    free = jnp.where(jnp.asarray(identified | whole), jnp.asarray(result.free), problem.start())
    dt = float(problem.scene.integrator.dt)
    made = {name: path_of(motion, contact, dt) for name, motion in MOTIONS.items()}
    recordings = [_recording(result, path, begin, dt) for path, begin in made.values()]
    groups = grouped(
        problem.scene, recordings, _channels(result), list(made), problem.parameters, problem.sensors
    )
    groups = tuple(replace(group, place=jnp.zeros_like(group.place), spells=None) for group in groups)
    added = np.asarray(_informations(free, replace(problem, groups=groups, priors=None)), np.float64)
    vague = np.array(
        [
            _VAGUE * max(abs(float(x)), 1e-2) if isinstance(p.transform, Identity) else p.transform.widest
            for p, x in zip(problem.reported, problem.report(free), strict=True)
        ]
    )
    back = problem.by_reported(free)
    known = result.information if back is None else back.T @ result.information @ back
    added = added if back is None else back.T @ added @ back
    # What widens intervals of the recordings, uneven noise and steps of the sensors, will be there again.
    known, added = (x / np.outer(result.widened, result.widened) for x in (known, added))
    # What a number that is not identified does to the residuals where the search ended says nothing of where it is.
    before = np.where(np.outer(identified, identified), known, 0) + np.diag(1 / vague**2)
    gain = {
        name: float(np.linalg.slogdet(before + more)[1] - np.linalg.slogdet(before)[1])
        for name, more in zip(made, added / result.variance, strict=True)
    }
    errors = {
        name: dict(zip(names, _errors(before + more), strict=True))
        for name, more in zip(made, added / result.variance, strict=True)
    }
    now = dict(zip(names, _errors(before), strict=True))
    best_for = {}
    for name in names:
        motion = min(errors, key=lambda m, name=name: errors[m][name])
        if errors[motion][name] < 0.9 * now[name]:
            best_for[name] = motion
    return Suggestion(
        gain,
        errors,
        now,
        max(gain, key=lambda name: gain[name]),
        best_for,
        tuple(p.name for i, p in enumerate(problem.parameters) if is_unseen(problem, i)),
        {name: path for name, (path, _) in made.items()},
    )


def _errors(information: Float[np.ndarray, "p p"]) -> list[float]:
    return np.sqrt(np.diag(np.linalg.inv(information))).tolist()


@jax.jit
def _informations(free: Float[Array, " p"], problem: Problem) -> Float[Array, "R p p"]:
    """J'J of each recording."""

    def each(x):
        return jnp.concatenate([r.reshape(len(r), -1) for _, r in by_channel(x, problem)], axis=1)

    matrix = jax.jacfwd(each)(free)
    return jnp.einsum("rni,rnj->rij", matrix, matrix)


def _channels(result: FitResult) -> tuple[str, ...]:
    return tuple({"force": "force", "position": "pose", "angle": "pose"}[key] for key in result.measured)


def _recording(result: FitResult, path: np.ndarray, begin: int, dt: float) -> Recording:
    """The motion, with nothing measured yet, at the times at which it would be."""
    times, channels = dt * np.arange(len(path)), {}
    for channel in set(_channels(result)):
        measured = next(t for r in result.recordings if (t := getattr(r, f"{channel}_t")) is not None)
        every = max(1, round(float(np.median(np.diff(measured))) / dt))
        channels[f"{channel}_t"] = at = times[begin::every]
        channels[channel] = np.zeros((len(at), path.shape[1], 3))
        if channel == "pose":
            still = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]
            channels[channel] = np.tile(still, (len(at), len(result.scene.moving()), 1))
    if result.problem.groups[0].gimbals is not None:
        channels |= {"gimbal": np.zeros(path.shape[:2]), "gimbal_t": times}
    return Recording(hip=path, hip_t=times, **channels)
