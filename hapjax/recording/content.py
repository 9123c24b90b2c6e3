"""What a reader of a file format hands over, and how much of a file it may unpack."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import InputError
from .finding import Finding

# A file's numbers, at 8 bytes each, may be 4 times its size and 2 MiB more: real recordings shrink to half at best. With
# what reading and cleaning take beside, that stays below 20 times.
UNPACKED_RATIO, UNPACKED_MARGIN = 4, 2 * 2**20
# Messages shrink more, and are read one by one, chunk by chunk.
MESSAGES_RATIO, CHUNK_RATIO = 8, 12


@dataclass(frozen=True)
class Content:
    """The arrays of a file by name, what a row of a channel is called in it, and what was found while reading."""

    arrays: dict[str, np.ndarray]
    place: Callable[[str, int], str] = lambda channel, row: f"row {row}"
    findings: tuple[Finding, ...] = ()


def check_unpacked(path: Path, size: int, unpacked: int, ratio: int = UNPACKED_RATIO) -> None:
    """Refuse, before it is done, to unpack a file of `size` bytes to far more. **Raises:** `InputError`."""
    most = ratio * size + UNPACKED_MARGIN
    if unpacked > most:
        problem = f"expected {size} bytes to unpack to at most {most}, found {unpacked}"
        raise InputError(f"{path}: {problem}; save it uncompressed")
