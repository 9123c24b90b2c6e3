"""Whether triangles are a closed surface around a solid; in NumPy, a piece of the mesh at a time."""

from collections.abc import Callable
from typing import Any

import numpy as np

from ..errors import InputError
from ._topology import LARGEST, PIECE, area_normals, edge_keys, pieces

SMALLEST_AREA = 1e-12  # m^2
_ALLOWED = "allowed: a closed surface of triangles whose corners run counter-clockwise seen from outside"


def checked(vertices: Any, triangles: Any, scale: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """The vertices (V, 3) and the triangles (T, 3) of a closed surface, as float64 and int32.

    **Raises:** `InputError` with one sentence that says what is wrong, in how many triangles, and in which first.
    """
    try:
        points, faces = np.asarray(vertices, np.float64), np.asarray(triangles)
        faces = faces if faces.dtype.kind in "iu" else np.asarray(faces, np.float64)
    except (TypeError, ValueError):
        raise InputError(f"vertices or triangles are no rows of three numbers; {_ALLOWED}") from None
    for name, rows in (("vertices", points), ("triangles", faces)):
        if rows.ndim != 2 or rows.shape[1] != 3 or len(rows) < 4:
            raise InputError(
                f"{name} have the shape {rows.shape}; allowed: at least four rows of three numbers"
            )
    if 3 * len(faces) >= LARGEST or len(points) >= LARGEST:
        raise InputError(f"triangles are {len(faces)}; allowed: at most {LARGEST // 3}")
    _refuse(_each(points, lambda row: ~np.isfinite(row)), "vertices", "have a number that is not finite")
    _refuse(
        _each(faces, lambda row: (row != np.round(row)) | (row < 0) | (row >= len(points))),
        "triangles",
        f"have a corner that is no whole number from 0 to {len(points) - 1}",
    )
    faces = faces.astype(np.int32, copy=False)
    _refuse_surface(points, faces, scale)
    return points, faces


def _each(rows: np.ndarray, bad: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    """Which rows have something bad in them."""
    return np.concatenate([bad(rows[piece]).any(axis=1) for piece in pieces(len(rows))])


def _refuse_surface(points: np.ndarray, faces: np.ndarray, scale: float) -> None:
    """Refuse triangles that are no closed surface around a solid: everything that is wrong, in one sentence."""
    found = []

    def find(bad: np.ndarray, what: str) -> None:
        if bad.any():
            found.append(
                f"{np.count_nonzero(bad)} of the triangles {what}, the first is {int(np.argmax(bad))}"
            )

    small = [_areas(points, faces[piece], scale) < SMALLEST_AREA for piece in pieces(len(faces))]
    find(np.concatenate(small), f"have an area below {SMALLEST_AREA} m^2")
    find(_again(faces), "are there twice")
    count = len(points)
    keys = _sorted_keys(faces, lambda own: edge_keys(own, count))
    find(
        _each(faces, lambda own: _number(keys, edge_keys(own, count)) > 1),
        "have an edge that another triangle has in the same direction (the winding is not consistent)",
    )
    del keys  # as large as the mesh, as are the next ones
    keys = _sorted_keys(faces, lambda own: _either_keys(own, count))
    find(
        _each(faces, lambda own: _number(keys, _either_keys(own, count)) < 2),
        "are beside a hole (the surface is not watertight)",
    )
    del keys
    if not found:
        outside = _winding_outside(points, faces)
        find(outside < -0.5, "face inward")
        find(outside > 0.5, "are within another piece (pieces overlap, or a cavity is not turned inside out)")
    if found:
        raise InputError(f"{'; '.join(found)}; {_ALLOWED}")


def _areas(points: np.ndarray, faces: np.ndarray, scale: float = 1.0) -> np.ndarray:
    return scale**2 * np.linalg.norm(area_normals(points, faces), axis=1) / 2


def _again(faces: np.ndarray) -> np.ndarray:
    """Which triangles have the corners of one before them."""
    corners = np.sort(faces, axis=1)
    order = np.lexsort(corners.T)
    again = np.zeros(len(faces), bool)
    for piece in pieces(len(faces) - 1):
        here, next = order[piece], order[piece.start + 1 : piece.stop + 1]
        again[next] = (corners[next] == corners[here]).all(axis=1)
    return again


def _either_keys(faces: np.ndarray, count: int) -> np.ndarray:
    """A number for each edge, whatever its direction."""
    return np.minimum(edge_keys(faces, count), edge_keys(faces, count, back=True))


def _sorted_keys(faces: np.ndarray, key: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    keys = np.empty(faces.shape, np.int64)
    for piece in pieces(len(faces)):
        keys[piece] = key(faces[piece])
    keys = keys.ravel()
    keys.sort()
    return keys


def _number(keys: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """How often each number is among the sorted keys."""
    return np.searchsorted(keys, wanted, "right") - np.searchsorted(keys, wanted)


def _winding_outside(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """How often the surface goes around the outer side of each triangle, told by the largest one of its connected piece.

    0 of a sound surface, also in a cavity; below 0 where the solid is on that side, above 0 within another piece.
    """
    from scipy.sparse import coo_matrix  # here, since it takes a while to load
    from scipy.sparse.csgraph import connected_components

    ends = np.repeat(faces[:, 0], 2), faces[:, 1:].ravel()
    graph = coo_matrix((np.ones(2 * len(faces), bool), ends), shape=(len(points),) * 2)
    piece = connected_components(graph, directed=False)[1][faces[:, 0]]
    del graph, ends
    size = np.concatenate([_areas(points, faces[own]) for own in pieces(len(faces))])
    found = np.zeros(len(faces), np.float32)
    for label in np.unique(piece):
        own = np.flatnonzero(piece == label)
        largest = own[np.argmax(size[own])]
        normal = area_normals(points, faces[largest : largest + 1])[0]
        step = 1e-4 * np.sqrt(2 * size[largest]) * normal / (2 * size[largest])
        eye = points[faces[largest]].mean(axis=0) + step
        found[own] = sum(_winding(points[faces[i : i + PIECE]] - eye) for i in range(0, len(faces), PIECE))
    return found


def _winding(corners: np.ndarray) -> float:
    """How often triangles (T, 3, 3) go around the origin (van Oosterom and Strackee 1983, solid angles over 4 pi)."""
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    la, lb, lc = (np.linalg.norm(x, axis=1) for x in (a, b, c))
    ab, bc, ca = (np.sum(x * y, axis=1) for x, y in ((a, b), (b, c), (c, a)))
    volume = np.sum(a * np.cross(b, c), axis=1)
    return float(np.sum(np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb)) / (2 * np.pi))


def _refuse(bad: np.ndarray, what: str, fault: str) -> None:
    if bad.any():
        first = int(np.flatnonzero(bad)[0])
        raise InputError(f"{int(bad.sum())} of the {what} {fault}, the first is {first}; {_ALLOWED}")
