"""What a fit returns, and its forms for programs."""

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import jax.numpy as jnp
import numpy as np

from hapjax import Finding, Recording, Scene
from hapjax.files import finite, write_json

from .possible import possible
from .problem import Problem
from .sensors import Sensors
from .start import Start
from .uncertainty import correlation


@dataclass(frozen=True)
class Estimate:
    """One parameter in its own unit.

    Where it is not `identified`, there is no estimate and no standard error, and `reason` says why;
    `interval95` then holds a lower bound where the data give one (a mu is at least the largest |f_t| / f_n
    seen), else `None`.
    """

    estimate: float | None
    standard_error: float | None
    interval95: tuple[float | None, float | None]
    identified: bool
    interval99: tuple[float, float] | None = None
    reason: str | None = None


@dataclass(frozen=True)
class FitResult:
    """The outcome of a fit.

    `parameters` by path; `scene` and `sensors` with the best values, those of the first recording where
    each has its own; `loss`, half the sum of squared whitened residuals; `residual_rms` in N (`force`), m (`pose`) and
    rad (`angle`); `converged`: whether the solver met its tolerances, and the residuals are below 1.2 times the noise
    (twice, of a start that was alone) or as many starts ended at the best loss as `success.why_not` asks, else `reason`
    says what is missing; `starts`, of which
    `starts_at_best` ended at the best loss; `noise`, the
    standard deviations that the residuals were divided by: `force` N, `position` m, `angle` rad; `trace`:
    each start's loss by step; `lost`, how many samples of a recording, by its name, were dropped because the model left the
    range of sense: the fit is that of the others, and `recordings` holds those that have some; `findings`, what is odd about
    the recordings; `interrupted`: Ctrl-C ended the search, and these are the best numbers so far; `measured`, how many
    numbers of each channel were compared; `identifiability`, which combinations of the numbers the recordings
    fix, in sentences; `adjusted`, where the scene differs from the estimates, as those can not be: sentences.
    For what goes on from here: `problem`, what was solved; `free` (p,), the transformed numbers at the best; `estimated`
    (p,), the same with the estimates of those that gradients do not see; `information`
    (p, p) of them, J'V^-1 J, Fisher's for the variances V that the residuals turned out to have; `variance`, their mean;
    `widened` (p,), by how many times the standard errors are above those of Gauss-Newton, as noise that was estimated turned
    out to be uneven, or sensors to read in steps.
    """

    parameters: Mapping[str, Estimate]
    scene: Scene
    loss: float
    residual_rms: Mapping[str, float]
    noise: Mapping[str, float]
    converged: bool
    starts: int
    starts_at_best: int
    wall_s: float
    covariance: np.ndarray
    singular_values: np.ndarray
    trace: Mapping[int, Mapping[int, float]]
    recordings: tuple[Recording, ...]
    names: tuple[str, ...]
    lost: Mapping[str, int] = field(default_factory=dict)
    reason: str | None = None
    findings: tuple[Finding, ...] = ()
    interrupted: bool = False
    sensors: Sensors = field(default_factory=Sensors)
    problem: Problem = field(repr=False, compare=False, kw_only=True)
    free: np.ndarray = field(repr=False, compare=False, kw_only=True)
    estimated: np.ndarray = field(repr=False, compare=False, kw_only=True)
    information: np.ndarray = field(repr=False, compare=False, kw_only=True)
    widened: np.ndarray = field(repr=False, compare=False, kw_only=True)
    variance: float = 1.0
    measured: Mapping[str, int] = field(default_factory=dict)
    identifiability: tuple[str, ...] = ()
    adjusted: tuple[str, ...] = ()

    def scene_of(self, name: str) -> Scene:
        """The scene with the best values for one of the recordings, by its name."""
        return possible(self.problem.scene_at(jnp.asarray(self.estimated), self.names.index(name)))[0]

    def sensors_of(self, name: str) -> Sensors:
        """The sensors with the best values for one of the recordings, by its name."""
        if not any(p.path.startswith("sensor.") and p.place is not None for p in self.problem.parameters):
            return self.sensors  # of all alike
        return self.problem.setup_at(jnp.asarray(self.estimated), self.names.index(name)).sensor

    def starts_of(self, name: str) -> dict[str, Start]:
        """How one of the recordings begins, by its name: of each object whose start is free, the best values."""
        return self.problem.setup_at(jnp.asarray(self.estimated), self.names.index(name)).start

    @property
    def correlation(self) -> np.ndarray:
        """Correlations of the parameters, as the solver sees them, in the order of `parameters`."""
        return correlation(self.covariance)

    def to_dict(self) -> dict[str, Any]:
        """The figures, ready for JSON, which has no infinity: `None` stands for what is not finite."""
        figures = {
            "parameters": {
                name: {
                    "estimate": p.estimate,
                    "standard_error": p.standard_error,
                    "interval95": list(p.interval95),
                    "identified": p.identified,
                    "reason": p.reason,
                }
                for name, p in self.parameters.items()
            },
            "loss": self.loss,
            "residual_rms": dict(self.residual_rms),
            "converged": self.converged,
            "reason": self.reason,
            "starts": self.starts,
            "starts_at_best": self.starts_at_best,
            "wall_s": self.wall_s,
            "lost": dict(self.lost),
            "identifiability": list(self.identifiability),
            "adjusted": list(self.adjusted),
            "findings": [asdict(finding) for finding in self.findings],
        }
        return finite(figures)

    def save_json(self, path: str | os.PathLike, beside: Mapping[str, Any] | None = None) -> None:
        """Write the figures as JSON, whole or not at all; `beside`, other figures under keys of their own."""
        write_json(path, self.to_dict() | dict(beside or {}))
