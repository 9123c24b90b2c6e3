"""Residuals of which neighbours err alike: said, because intervals depend on it."""

from collections.abc import Collection, Sequence

import numpy as np
from jaxtyping import Float

from hapjax import Finding

from .noise import correlation_time, lost
from .robust import slope

_LEAST, _CHANCE = (
    2.0,
    15.0,
)  # a correlation time beyond 2, and beyond 1 + 15 / sqrt(N): of white noise one in a thousand
_SIZE = 0.5  # noises: smaller residuals are rounding
_PART = 0.1  # of a recording: a drift that lasts so long is hardly a noise


def correlated(
    channels: Sequence[tuple[str, Float[np.ndarray, "_ _ _"]]], given: Collection[str], loss: str
) -> list[Finding]:
    """What is said of channels whose whitened residuals err alike over many samples, and what intervals make of it.

    **Arguments:** `channels`, as those of `channels_of`; `given`, the channels whose noise was given; `loss`, of the fit.
    """
    found = []
    for key in dict.fromkeys(name for name, _ in channels):
        parts = [np.where(lost(r)[..., None], 0, r) for name, r in channels if name == key]
        length, square = max(r.shape[1] for r in parts), sum(float(np.sum(r**2)) for r in parts)
        time = correlation_time([slope(r, loss) for r in parts])
        small = square < _SIZE**2 * sum(r.size for r in parts)
        if small or time < max(_LEAST, 1 + _CHANCE / np.sqrt(length)):
            continue
        sentence = f"residuals of {key} err alike over about {time:.0f} of {length} successive samples"
        if key in given:
            sentence += ", which intervals that follow from the noise as it was given do not account for"
        else:
            wider = f"{np.sqrt(time):.1f} times as wide as for white noise"
            sentence += f": they count as so many times fewer, and intervals are {wider}"
        if time > _PART * length:
            sentence += "; that is a good part of the recording: a sensor drifts or the model errs, and "
            sentence += "intervals may be too narrow"
        done = "only reported" if key in given else "intervals widened"
        found.append(Finding("force" if key == "force" else "pose", "correlated residuals", sentence, done))
    return found
