"""Whether a search found the best numbers: what its starts say by where they ended."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Array, Float

from .problem import NOTICEABLE
from .shooting import ALONE, EXPLAINED


def variance_of(losses: Float[Array, " S"], measured: int) -> float:
    """That of the residuals where they are least."""
    return 2 * float(np.min(losses)) / measured


def alike(losses: Float[Array, " S"], variance: float) -> int:
    """How many starts ended at the least loss but for chance, where the residuals have this variance.

    Residuals that err alike say less of the numbers than as many that do not. But two ends at which the same recording has
    other residuals are two.
    """
    least = float(np.min(losses))
    return int(np.sum(np.asarray(losses) <= least + NOTICEABLE * variance / 2))


def gone_astray(losses: Float[Array, " S"], measured: int) -> bool:
    """Whether no start explains so many measured numbers, and fewer than half, or than two, ended at one loss."""
    variance = variance_of(losses, measured)
    few = alike(losses, variance) < max(2, len(losses) / 2)
    return len(losses) > 1 and variance >= EXPLAINED**2 and few


def why_not(
    tolerant: bool, size: float, near: int, starts: int, moving: bool = False, flat: Sequence[str] = ()
) -> str | None:
    """Why a fit does not count as converged; `None`: it does.

    A solver's tolerances are no evidence of the best fit: the model explains the recordings, or several starts, and no
    small share of them, ended at the same loss; but not where a number that is `flat` has no influence. Something that is
    `moving` may bounce to many places, at each of which a few starts end. Where others were tried and ended elsewhere,
    a start that is alone has to explain the recordings to the noise.
    """
    if not tolerant:
        return "the solver reached max_steps before it met its tolerances"
    enough = max(2, min(3, starts), starts / 2) if moving else max(2, starts / 4)
    if size >= (ALONE if starts > 1 else EXPLAINED) and near < enough:
        return (
            f"the residuals are {size:.1f} times the noise, and {near} of {starts} starts ended at this loss"
        )
    if size >= EXPLAINED and flat:
        return f"the residuals are {size:.1f} times the noise, and {', '.join(flat)} has no influence there"
    return None
