"""Which triangle of a mesh lies beside which, found once when the mesh is built; in NumPy."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..errors import InputError

SMALLEST_AREA = 1e-12  # m^2
LARGEST = 2**24  # a float32 counts so far
PIECE = 2**14  # triangles that are looked at together: all at once take 20 times the room of a mesh
SPARE = 16  # numbers behind the end of a list of which several are read at a time
_ALLOWED = "allowed: a closed surface of triangles whose corners run counter-clockwise seen from outside"


class Topology(eqx.Module):
    """Neighbours in a mesh. Whole numbers, kept as floats so that a scene has numbers of one type.

    `patches`: what a search wants to know of a triangle, in one row: its three corners (m), the triangles across the
    edges from corners 0, 1 and 2, and the numbers of its vertices. `fan`: the triangles about each vertex, one
    vertex after another; that of vertex v starts at `fan_start[v]`; some zeros follow. `vertex_normals`: Baerentzen
    and Aanaes's angle-weighted ones, units.
    """

    patches: Float[Array, "T 5 3"]
    fan_start: Float[Array, "V1"]
    fan: Float[Array, "F"]
    vertex_normals: Float[Array, "V 3"]


def checked(vertices: Any, triangles: Any, scale: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """The vertices (V, 3) and the triangles (T, 3) of a closed surface.

    **Raises:** `InputError` with one sentence that says what is wrong, in how many triangles, and in which first.
    """
    try:
        points, faces = np.asarray(vertices, np.float64), np.asarray(triangles, np.float64)
    except (TypeError, ValueError):
        raise InputError(f"vertices or triangles are no rows of three numbers; {_ALLOWED}") from None
    for name, rows in (("vertices", points), ("triangles", faces)):
        if rows.ndim != 2 or rows.shape[1] != 3 or len(rows) < 4:
            raise InputError(
                f"{name} have the shape {rows.shape}; allowed: at least four rows of three numbers"
            )
    if 3 * len(faces) >= LARGEST or len(points) >= LARGEST:
        raise InputError(f"triangles are {len(faces)}; allowed: at most {LARGEST // 3}")
    _refuse(~np.isfinite(points).all(axis=1), "vertices", "have a number that is not finite")
    bad = (faces != np.round(faces)) | (faces < 0) | (faces >= len(points))
    _refuse(
        bad.any(axis=1), "triangles", f"have a corner that is no whole number from 0 to {len(points) - 1}"
    )
    faces = faces.astype(np.int64)

    _refuse_surface(points, faces, scale)
    return points, faces


def _refuse_surface(points: np.ndarray, faces: np.ndarray, scale: float) -> None:
    """Refuse triangles that are no closed surface around a solid: everything that is wrong, in one sentence."""
    found = []

    def find(bad: Any, what: str) -> None:
        if bad.any():
            found.append(
                f"{np.count_nonzero(bad)} of the triangles {what}, the first is {int(np.argmax(bad))}"
            )

    area = np.linalg.norm(area_normals(points * scale, faces), axis=1) / 2
    find(area < SMALLEST_AREA, f"have an area below {SMALLEST_AREA} m^2")
    corners = np.sort(faces.astype(np.int32), axis=1)
    order = np.lexsort(corners.T)
    again = np.zeros(len(faces), bool)
    again[order[1:]] = (corners[order[1:]] == corners[order[:-1]]).all(axis=1)
    find(again, "are there twice")
    del corners, order
    key, back = _edge_keys(faces, len(points))
    flat = np.sort(key.ravel())
    find(
        (np.searchsorted(flat, key, "right") - np.searchsorted(flat, key) > 1).any(axis=1),
        "have an edge that another triangle has in the same direction (the winding is not consistent)",
    )
    either = np.minimum(key, back)
    ends = np.sort(either.ravel())
    alone = np.searchsorted(ends, either, "right") - np.searchsorted(ends, either) < 2
    find(alone.any(axis=1), "are beside a hole (the surface is not watertight)")
    del area, key, back, flat, either, ends, alone  # each as large as the mesh
    if not found:
        outside = _winding_outside(points, faces)
        find(outside < -0.5, "face inward")
        find(outside > 0.5, "are within another piece (pieces overlap, or a cavity is not turned inside out)")
    if found:
        raise InputError(f"{'; '.join(found)}; {_ALLOWED}")


def _winding_outside(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """How often the surface goes around the outer side of each triangle, told by the largest one of its connected piece.

    0 of a sound surface, also in a cavity; below 0 where the solid is on that side, above 0 within another piece.
    """
    from scipy.sparse import coo_matrix  # here, since it takes a while to load
    from scipy.sparse.csgraph import connected_components

    ends = np.repeat(faces[:, 0].astype(np.int32), 2), faces[:, 1:].astype(np.int32).ravel()
    graph = coo_matrix((np.ones(2 * len(faces), bool), ends), shape=(len(points),) * 2)
    piece = connected_components(graph, directed=False)[1][faces[:, 0]]
    normals = area_normals(points, faces)
    size = np.linalg.norm(normals, axis=1)
    found = np.zeros(len(faces))
    for label in np.unique(piece):
        own = np.flatnonzero(piece == label)
        largest = own[np.argmax(size[own])]
        step = 1e-4 * np.sqrt(size[largest]) * normals[largest] / size[largest]
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


def topology(vertices: np.ndarray, triangles: np.ndarray, dtype: Any) -> Topology:
    """The neighbours of checked triangles."""
    corner = triangles.ravel()
    fan = np.argsort(corner, kind="stable") // 3
    fan_start = np.concatenate([[0], np.cumsum(np.bincount(corner, minlength=len(vertices)))])
    normals = vertex_normals(vertices, triangles)
    patches = np.empty((len(triangles), 5, 3), dtype)
    patches[:, :3], patches[:, 3], patches[:, 4] = (
        vertices[triangles],
        _across(triangles, len(vertices)),
        triangles,
    )
    parts = (patches, fan_start, np.pad(fan, (0, SPARE)), normals)
    return Topology(*(jnp.asarray(part, dtype) for part in parts))


def _across(triangles: np.ndarray, count: int) -> np.ndarray:
    """The triangle across each edge (T, 3)."""
    key, back = _edge_keys(triangles, count)
    order = np.argsort(key, axis=None)
    return order[np.searchsorted(key.ravel(), back, sorter=order)] // 3


def vertex_normals(vertices: Any, triangles: Any) -> Any:
    """Baerentzen and Aanaes 2005: the sum of the normals about a vertex, each times its triangle's angle there.

    In NumPy of NumPy's arrays; of JAX's, with their derivatives.
    """
    xp = jnp if isinstance(vertices, jax.Array) else np
    normals = area_normals(vertices, triangles)
    normals = normals / xp.linalg.norm(normals, axis=1, keepdims=True)
    each = []
    for i in range(3):
        a, b, c = (vertices[triangles[:, (i + j) % 3]] for j in range(3))
        sine = xp.linalg.norm(xp.cross(b - a, c - a), axis=1)
        angle = xp.arctan2(sine, xp.sum((b - a) * (c - a), axis=1))
        each.append(angle[:, None] * normals)
    weighted, corner = xp.stack(each, axis=1).reshape(-1, 3), triangles.reshape(-1)
    if xp is jnp:
        total = jnp.zeros_like(vertices).at[corner].add(weighted)
        first = normals[jnp.zeros(len(vertices), int).at[corner].set(jnp.arange(len(corner)) // 3)]
    else:
        total, of = np.zeros_like(vertices), np.zeros(len(vertices), int)
        np.add.at(total, corner, weighted)
        of[corner] = np.arange(len(corner)) // 3
        first = normals[of]
    square = xp.sum(total * total, axis=1, keepdims=True)
    thin = square < 1e-18
    return xp.where(thin, first, total / xp.sqrt(xp.where(thin, 1, square)))


def area_normals(vertices: Any, triangles: Any) -> Any:
    """The outward normals (T, 3), each as long as twice the area of its triangle."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return (jnp if isinstance(vertices, jax.Array) else np).cross(b - a, c - a)


def _edge_keys(triangles: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """A number for each directed edge, and that of the same edge in the other direction."""
    start, end = triangles, np.roll(triangles, -1, axis=1)
    return start * count + end, end * count + start


def _refuse(bad: Any, what: str, fault: str) -> None:
    if bad.any():
        first = int(np.flatnonzero(bad)[0])
        raise InputError(f"{int(bad.sum())} of the {what} {fault}, the first is {first}; {_ALLOWED}")
