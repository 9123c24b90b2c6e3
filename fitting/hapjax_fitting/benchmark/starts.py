"""How often a fit finds the best numbers from far away, and whether it says so where it does not."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from hapjax.progress import Advance

from ..fit import fit
from ..parameters import free_parameters, values_of, with_values
from ..problem import NOTICEABLE
from .cases import CASES

FACTOR = 10.0


def from_afar(
    name: str, fits: int, seed: int = 0, advance: Advance = lambda doing, steps: None
) -> dict[str, Any]:
    """Fit so many recordings of a case, each from a first start a factor 10 off in every number, up or down at random.

    The best loss is that of a fit which starts at the truth. `at_best`: how many ended there, but for what chance makes of
    it; `said`: how many of the others are reported as not converged; `hidden`: how many of them as a success.
    """
    case = CASES[name]
    truth = case.truth()
    parameters = free_parameters(truth, case.free)
    values = np.asarray(values_of(truth, parameters))
    at_best = said = 0
    for draw in range(seed, seed + fits):
        recording = case.recorded(draw)
        off = FACTOR ** np.random.default_rng(draw).choice([-1.0, 1.0], len(values))
        start = with_values(truth, parameters, jnp.asarray(values * off))
        found = fit(start, recording, case.free, noise=case.noise, seed=draw)
        best = fit(truth, recording, case.free, noise=case.noise, starts=1)
        reached = found.loss <= best.loss + NOTICEABLE / 2
        at_best += reached
        said += not reached and not found.converged
        advance(name, 1.0)
    return {"case": name, "fits": fits, "at_best": at_best, "said": said, "hidden": fits - at_best - said}
