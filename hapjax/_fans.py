"""Polygons as triangles: fans about their first corner."""

from array import array
from collections.abc import Sequence

import numpy as np

from .errors import InputError


class Fans:
    """The triangles of polygons that come one after another, at `most` so many.

    Its methods raise `InputError` for a polygon of fewer than three corners, for more triangles, and for corners that
    are no vertices.
    """

    def __init__(self, most: int):
        self._corners, self._most = array("i"), most

    def add(self, polygon: Sequence[int]) -> None:
        """One more, by the numbers of its vertices."""
        self._expect(1, len(polygon))
        first = polygon[0]
        for i in range(2, len(polygon)):
            self._corners.extend((first, polygon[i - 1], polygon[i]))

    def add_all(self, polygons: np.ndarray) -> None:
        """More of the same number of corners, (n, k)."""
        self._expect(*polygons.shape)
        if polygons.min() < 0 or polygons.max() >= 2**31:
            raise InputError(f"has a triangle of vertex {polygons.max()}; allowed: from 0 to {2**31 - 1}")
        polygons = polygons.astype(np.int32)
        first = np.broadcast_to(polygons[:, :1], (len(polygons), polygons.shape[1] - 2))
        self._corners.frombytes(np.stack([first, polygons[:, 1:-1], polygons[:, 2:]], axis=2).tobytes())

    def triangles(self, count: int) -> np.ndarray:
        """All triangles (T, 3), whose corners are among so many vertices."""
        found = np.frombuffer(self._corners, np.int32).reshape(-1, 3)
        if found.size and not 0 <= found.min() <= found.max() < count:
            wrong = found.max() if found.max() >= count else found.min()
            raise InputError(
                f"has a triangle of vertex {wrong}, counted from 0; allowed: from 0 to {count - 1}"
            )
        return found

    def _expect(self, polygons: int, corners: int) -> None:
        if corners < 3:
            raise InputError(f"has a face of {corners} corners; allowed: at least three")
        number = len(self._corners) // 3 + polygons * (corners - 2)
        if number > self._most:
            raise InputError(
                f"has {number} triangles or more; allowed: at most {self._most} in a file of its size"
            )
