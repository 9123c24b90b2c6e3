"""What a reader of a file format hands over, and how much of a file it may unpack."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError
from .finding import Finding

# A file may unpack to 20 times its size and 64 MiB more: real recordings shrink to half at best.
UNPACKED_RATIO, UNPACKED_MARGIN = 20, 64 * 2**20


@dataclass(frozen=True)
class Content:
    """The arrays of a file by name, what a row of a channel is called in it, and what was found while reading."""

    arrays: dict[str, np.ndarray]
    place: Callable[[str, int], str] = lambda channel, row: f"row {row}"
    findings: tuple[Finding, ...] = ()


def most_unpacked(size: int) -> int:
    """How many bytes a file of `size` bytes may unpack to."""
    return UNPACKED_RATIO * size + UNPACKED_MARGIN


def check_unpacked(path: Path, size: int, unpacked: int) -> None:
    """Refuse, before it is done, to unpack a file of `size` bytes to far more. **Raises:** `InputError`."""
    if unpacked > most_unpacked(size):
        problem = f"expected {size} bytes to unpack to at most {most_unpacked(size)}, found {unpacked}"
        raise InputError(f"{path}: {problem}; save it uncompressed")
