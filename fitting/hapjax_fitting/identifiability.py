"""Which combinations of the free numbers the data fix, and which not, in words."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float

from .parameters import Parameter
from .result import Estimate
from .transform import Log

# A number without a logarithm has no natural unit: it is lost where so many times as uncertain as with all others known.
_HOPELESS = 1e4
_PART = 0.01  # of a direction that is lost, from which on a number has a part in it
_EQUAL = 0.1  # exponents that differ by less count as equal


def identifiability(
    information: Float[np.ndarray, "p p"],
    parameters: Sequence[Parameter],
    estimates: Mapping[str, Estimate],
    seen: Bool[np.ndarray, " p"],
    seconds: float,
) -> tuple[str, ...]:
    """What the data fix, a sentence for each group of numbers that they do not tell apart.

    A direction in the space of the transformed numbers is lost where the standard error along it is above 1 (of
    logarithms, a factor of 7 either way at 95 %), or its eigenvalue of the information is 0 to rounding. Along (1, -1)
    of two logarithms the product stays, along (1, 1) the ratio: those are then what the data fix.

    **Arguments:** `information` of the transformed numbers; `seen` (p,): `False` for numbers that the Jacobian says
    nothing of, such as a mu where nothing slips; `seconds` that were recorded.
    """
    names = [p.name for p in parameters]
    fixed = [name for name in names if estimates[name].identified]
    if len(fixed) == len(names):
        return ("The data fix each of the free numbers on its own.",)
    sentences = [f"The data fix {_listed(fixed)}."] if fixed else []
    open_, tied = np.flatnonzero(seen & ~np.isin(names, fixed)), set()
    size = np.sqrt(np.diag(information).astype(np.float64))
    size = np.where(size > 0, size, 1.0)
    lost = _lost(information, size, parameters)
    for group in _groups(lost, open_):
        words = _combination(group, lost, size, parameters)
        if words is not None:
            tied.update(group)
            sentences.append(f"In these {seconds:.3g} s they fix {words}.")
    for i, name in enumerate(names):
        if name not in fixed and i not in tied:
            sentences.append(f"They do not fix {name}: {estimates[name].reason}.")
    return tuple(sentences)


def _lost(
    information: Float[np.ndarray, "p p"], size: Float[np.ndarray, " p"], parameters: Sequence[Parameter]
) -> Float[np.ndarray, "p p"]:
    """The projection on the directions that the data do not fix, in numbers of which each alone has the information 1."""
    widest = np.array([p.transform.widest for p in parameters])
    unit = np.where(np.isfinite(widest), widest, _HOPELESS / size)
    values, vectors = np.linalg.eigh(information.astype(np.float64) * np.outer(unit, unit))
    rounding = np.finfo(information.dtype).eps ** 0.75 * values[-1]
    some = vectors[:, values < max(1.0, rounding)] * (unit * size)[:, None]
    basis, _ = np.linalg.qr(some)
    return basis @ basis.T


def _groups(lost: Float[np.ndarray, "p p"], numbers: np.ndarray) -> list[list[int]]:
    """Those numbers that have a part in what is lost, together with those that they are lost with."""
    left, groups = [i for i in numbers.tolist() if lost[i, i] > _PART], []
    while left:
        group = [left.pop(0)]
        for i in group:
            near = [j for j in left if abs(lost[i, j]) > _PART]
            group += near
            left = [j for j in left if j not in near]
        groups.append(sorted(group))
    return groups


def _combination(
    group: list[int],
    lost: Float[np.ndarray, "p p"],
    size: Float[np.ndarray, " p"],
    parameters: Sequence[Parameter],
) -> str | None:
    """What the data fix of a group; `None` where it is nothing."""
    part = lost[np.ix_(group, group)]
    kept = len(group) - round(float(np.trace(part)))
    if kept < 1 or len(group) < 2:
        return None
    names = [parameters[i].name for i in group]
    if len(group) > 2:
        return f"{_listed(names)} only through {kept} combination{'s' if kept > 1 else ''}"
    first, second = np.linalg.eigh(part)[1][:, -1] / size[group]
    if all(isinstance(parameters[i].transform, Log) for i in group):
        if abs(first + second) < _EQUAL * max(abs(first), abs(second)):
            return f"{_listed(names)} only through their product"
        if abs(first - second) < _EQUAL * max(abs(first), abs(second)):
            return f"{_listed(names)} only through their ratio"
    return f"{_listed(names)} only through a combination"


def _listed(names: Sequence[str]) -> str:
    *most, last = names
    return f"{', '.join(most)} and {last}" if most else last
