"""What a fit is asked for: refused, in one sentence, where it cannot be."""

from collections.abc import Iterable, Mapping, Sequence
from numbers import Real
from typing import Any

from hapjax import InputError, Recording

from .observation import CHANNELS
from .problem import Problem
from .robust import LOSSES


def check_recordings(
    scene: Any, recordings: Sequence[Any], names: Sequence[str], channels: tuple[str, ...]
) -> None:
    """Refuse what is no recording, other names than they have, and channels that there are not."""
    for name, recording in zip(names, recordings, strict=False):
        if not isinstance(recording, Recording):
            raise InputError(f"{name} is {recording!r}; allowed: a Recording, as load_recording gives")
    if not recordings:
        raise InputError("no recording is given; allowed: at least one")
    if len(names) != len(recordings):
        raise InputError(
            f"names has {len(names)} names for {len(recordings)} recordings; allowed: one for each"
        )
    if not channels:
        raise InputError(f"observe is empty; allowed: {', '.join(CHANNELS)}")
    for channel in channels:
        if channel not in CHANNELS:
            raise InputError(f"observe names {channel!r}; allowed: {', '.join(CHANNELS)}")
    if channels == ("pose",) and not scene.moving():
        raise InputError("observe is pose, but no object in the scene moves; allowed: force")


def check_search(starts: Any, spread: Any, seed: Any, max_steps: Any, loss: Any) -> None:
    """Refuse numbers of a search that are out of range, and losses that there are not."""
    limits = (("starts", starts, 1, 10_000), ("max_steps", max_steps, 1, 100_000), ("seed", seed, 0, 2**63))
    for name, value, low, high in limits:
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise InputError(f"{name} is {value!r}; allowed: a whole number from {low} to {high}")
    if isinstance(spread, bool) or not isinstance(spread, Real) or not 1 <= float(spread) <= 1e6:
        raise InputError(f"spread is {spread!r}; allowed: 1 to 1000000")
    if loss not in LOSSES:
        raise InputError(f"loss is {loss!r}; allowed: {', '.join(LOSSES)}")


def check_names(free: Any, **given: Any) -> None:
    """Refuse free numbers that are not named, and what should say something by name and does not."""
    paths = free if isinstance(free, Iterable) else [free]
    for path in [] if callable(free) else paths:
        if not isinstance(path, str):
            raise InputError(f"free names {path!r}; allowed: paths, such as object.cube.surface.mu")
    for name, value in given.items():
        if value is not None and not isinstance(value, Mapping):
            raise InputError(f"{name} is {value!r}; allowed: a dict by names")


def check_count(problem: Problem) -> None:
    """Refuse more free numbers than measured ones."""
    measured = problem.measured()
    if measured + problem.known() <= len(problem.parameters):
        raise InputError(
            f"free has {len(problem.parameters)} numbers, and the recordings {measured} to fit them to; "
            "allowed: fewer free numbers than measured ones"
        )
