"""The triangles of an STL file, of numbers or of text; colours and what it says of normals are not looked at."""

from array import array
from typing import IO

import numpy as np

from ._lines import lines_of
from .errors import InputError

_HEAD = 84  # bytes, of which the last four are the number of triangles
_TRIANGLE = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("about", "<u2")])


def triangles_of(file: IO[bytes], most: int) -> tuple[np.ndarray, np.ndarray]:
    """The vertices (3 T, 3), each triangle's own, and the triangles (T, 3).

    **Raises:** `InputError` for a triangle of text that has not three vertices, for more than `most` triangles, and for
    long lines; another `ValueError` for what is no number.
    """
    size = file.seek(0, 2)
    file.seek(0)
    head = file.read(_HEAD)
    count = int.from_bytes(head[-4:], "little")
    if len(head) == _HEAD and size == _HEAD + count * _TRIANGLE.itemsize:
        points = np.frombuffer(file.read(), _TRIANGLE)["corners"].reshape(-1, 3)
    else:
        file.seek(0)
        points = np.frombuffer(_vertices(file), np.float64).reshape(-1, 3)
    if len(points) > 3 * most:
        raise InputError(f"has {len(points) // 3} triangles; allowed: at most {most} in a file of its size")
    return points, np.arange(len(points), dtype=np.int32).reshape(-1, 3)


def _vertices(file: IO[bytes]) -> array:
    """The numbers of all vertices of a file of text."""
    numbers, begun = array("d"), 0
    for line, text in lines_of(file):
        words = text.lower().split()
        if words[:1] == [b"vertex"]:
            if len(words) != 4:
                raise InputError(f"line {line} has a vertex of {len(words) - 1} numbers; allowed: three")
            numbers.extend(map(float, words[1:]))
        elif words[:1] in ([b"facet"], [b"endfacet"]):
            if len(numbers) not in (begun, begun + 9):
                number = (len(numbers) - begun) // 3
                raise InputError(f"line {line} ends a triangle of {number} vertices; allowed: three")
            begun = len(numbers)
    if len(numbers) != begun:
        raise InputError("ends within a triangle; allowed: a whole file")
    return numbers
