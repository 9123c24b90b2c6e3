"""Text files read a line at a time, so that a long one takes no more room than a short one."""

from collections.abc import Iterator
from typing import IO

from .errors import InputError

LONGEST = 2**17  # bytes of a line: its words take up to 40 times as many


def lines_of(file: IO[bytes], first: int = 1) -> Iterator[tuple[int, bytes]]:
    """The lines of a file from where it stands, with their numbers from `first` on.

    **Raises:** `InputError` for a line of more than `LONGEST` bytes.
    """
    number = first
    while line := file.readline(LONGEST + 1):
        if len(line) > LONGEST:
            raise InputError(f"line {number} has more than {LONGEST} bytes; allowed: at most {LONGEST}")
        yield number, line
        number += 1
