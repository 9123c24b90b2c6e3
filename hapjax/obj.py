"""The triangles of an OBJ file (Wavefront, Advanced Visualizer 3.0, appendix B1); nothing else of it is looked at."""

from array import array
from collections.abc import Iterator
from typing import IO

import numpy as np

from ._fans import Fans
from ._lines import LONGEST, lines_of
from .errors import InputError


def triangles_of(file: IO[bytes], most: int) -> tuple[np.ndarray, np.ndarray]:
    """The vertices (V, 3) and the triangles (T, 3), of polygons as fans.

    **Raises:** `InputError` for a vertex of fewer than three numbers, for faces as `Fans` has it, of which there may be
    `most` triangles, and for long lines; another `ValueError` or `OverflowError` for what is no number.
    """
    numbers, fans = array("d"), Fans(most)
    for line, words in _statements(file):
        if words[0] == b"v":
            if len(words) < 4:
                raise InputError(f"line {line} has a vertex of {len(words) - 1} numbers; allowed: three")
            numbers.extend(map(float, words[1:4]))
        elif words[0] == b"f":
            count = len(numbers) // 3
            corners = [int(word.split(b"/", 1)[0]) for word in words[1:]]
            # From 1 on; those below 0 count back from the last vertex so far.
            fans.add([corner - 1 if corner >= 0 else count + corner for corner in corners])
    points = np.frombuffer(numbers, np.float64).reshape(-1, 3)
    return points, fans.triangles(len(points))


def _statements(file: IO[bytes]) -> Iterator[tuple[int, list[bytes]]]:
    """The words of each line, of several where a backslash at its end joins it with the next; none of a remark."""
    words, size = [], 0
    for number, line in lines_of(file):
        line = line.split(b"#", 1)[0].rstrip()
        goes_on = line.endswith(b"\\")
        words += line[:-1].split() if goes_on else line.split()
        size += len(line)
        if size > LONGEST:
            raise InputError(
                f"line {number} goes on to more than {LONGEST} bytes; allowed: at most {LONGEST}"
            )
        if not goes_on:
            if words:
                yield number, words
            words, size = [], 0
