"""Residuals beyond the noise: said, whatever the search came to, as numbers then err by more than their intervals."""

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from hapjax import Finding

from .noise import lost
from .problem import Problem, pieces_of
from .robust import unrooted
from .sharding import gathered

_BEYOND = 2.0  # noises, and
_RIGHT = 1e-3  # of what was measured: where noise was estimated, it may be next to nothing
_MEDIAN = 0.6745  # of the size of Gaussian noise, over its standard deviation
_UNITS = {"force": "N", "position": "m", "angle": "rad"}


@dataclass(frozen=True)
class _Part:
    """What one recording's residuals in a channel are, in noises: all together, and along the worst axis of a thing; and
    by how much what was measured changes."""

    key: str
    place: int
    size: float
    change: float
    worst: float
    column: int


def misfit(
    residuals: Float[np.ndarray, " n"], problem: Problem, names: Sequence[str], given: Collection[str]
) -> list[Finding]:
    """What is said of channels that the model as fitted does not explain: of which recording most, and along what.

    **Arguments:** `residuals`, as `stacked_residuals` has them; `names`, of the problem's recordings; `given`, the channels
    whose noise was given.
    """
    parts, found = list(_parts(residuals, problem)), []
    for key in dict.fromkeys(part.key for part in parts):
        all_of = [part for part in parts if part.key == key]
        least = 0.0 if key in given else _RIGHT / float(getattr(problem.noise, key))
        beyond = [part for part in all_of if part.size > max(_BEYOND, least * part.change)]
        if not beyond:
            continue
        most = max(beyond, key=lambda part: part.size)
        several = len(all_of) > 1
        where = f", in {len(beyond)} of {len(all_of)} recordings beyond {_BEYOND:g} times" if several else ""
        noise = f"{float(getattr(problem.noise, key)):.3g} {_UNITS[key]}"
        sentence = (
            f"residuals of {key} are {most.size:.3g} times the noise, {noise} as it was "
            f"{'given' if key in given else 'estimated'}{where}; most {_along(most, problem)}, {most.worst:.3g} times: "
            f"{'' if key in given else 'unless noise errs alike, '}the model as fitted does not explain what was recorded, "
            "and numbers may err by more than their intervals"
        )
        channel = "force" if key == "force" else "pose"
        recording = names[most.place] if several else ""
        found.append(Finding(channel, "misfit", sentence, count=len(beyond), recording=recording))
    return found


def _parts(residuals: Float[np.ndarray, " n"], problem: Problem) -> Iterator[_Part]:
    for key, group, samples, piece in pieces_of(unrooted(np.asarray(residuals), problem.loss), problem):
        kept = ~lost(piece)
        if samples.taken is not None:
            kept &= np.arange(piece.shape[1]) < gathered(samples.taken)[: group.count, None]
        value = gathered(samples.value)[: group.count, ..., :3]
        change = np.ptp(value, axis=1).max(axis=(1, 2)) if key != "angle" else np.ones(group.count)
        for row, place in enumerate(group.places.tolist()):
            own = piece[row, kept[row]]
            if len(own):
                along = np.array([_size(column, problem.loss) for column in own.T])
                column = int(along.argmax())
                yield _Part(
                    key, place, _size(own, problem.loss), float(change[row]), float(along[column]), column
                )


def _size(residuals: Float[np.ndarray, "*n"], loss: str) -> float:
    """How large residuals are; where some are taken for outliers, the others."""
    if loss == "squares":
        return float(np.sqrt(np.mean(residuals**2)))
    return float(np.median(np.abs(residuals))) / _MEDIAN


def _along(part: _Part, problem: Problem) -> str:
    thing, axis = divmod(part.column, 3)
    owner = f"finger {thing}" if part.key == "force" else problem.scene.moving()[thing]
    return f"{'about' if part.key == 'angle' else 'along'} {'xyz'[axis]} of {owner}"
