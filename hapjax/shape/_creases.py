"""The sharp convex edges of a surface of triangles, by which it can lie across another object's."""

from array import array
from collections.abc import Iterator
from itertools import pairwise
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._topology import area_normals, pieces, unit_normals

_SHARP = np.cos(np.radians(10.0))  # a tessellated smooth surface touches by its vertices alone
MOST = 64
"""So many edges a mesh has at most: each may cross each of another object."""
_FINEST, _COARSEST = 1e-6, 0.05  # of the diagonal: by how much a chord may leave the edges that it stands for


class Creases(eqx.Module):
    """Of each sharp edge the numbers of its two `vertices` and of its two `triangles`, as floats.

    `thickness` (m) is the volume over the area: half the thickness of a plate.
    """

    vertices: Float[Array, "E 2"]
    triangles: Float[Array, "E 2"]
    thickness: Float[Array, ""]


def creases_of(points: np.ndarray, faces: np.ndarray, across: np.ndarray, dtype: Any) -> Creases:
    """The sharp convex edges of a closed surface whose triangles wind counter-clockwise seen from outside.

    Where they are more than `MOST`, edges that run on from each other are put together into chords, as straight as can
    be; if that does not do, the longest and sharpest are kept.

    **Arguments:** `across`: see `across_of`.
    """
    sharp = [_sharp(points, faces, across, piece) for piece in pieces(len(faces))]
    edges, beside, bend = (np.concatenate(part) for part in zip(*sharp, strict=True))
    del sharp
    order = np.lexsort((np.max(edges, axis=1), np.min(edges, axis=1)))
    edges, beside, angle = edges[order], beside[order], np.arccos(np.clip(bend[order], -1, 1))
    if len(edges) > MOST:
        edges, beside, angle = _chords(points, edges, beside, angle)
    if len(edges) > MOST:
        length = np.linalg.norm(points[edges[:, 1]] - points[edges[:, 0]], axis=1)
        kept = np.sort(np.argsort(-length * angle, kind="stable")[:MOST])
        edges, beside = edges[kept], beside[kept]
    thickness = jnp.asarray(_thickness(points, faces), dtype)
    return Creases(jnp.asarray(edges, dtype), jnp.asarray(beside, dtype), thickness)


def _sharp(
    points: np.ndarray, faces: np.ndarray, across: np.ndarray, piece: slice
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Of the sharp convex edges that have their first side in a piece: the ends, both triangles, the cosine between them.

    An edge's first side is the one that comes earlier among the sides 0 of all triangles, then the sides 1, then 2.
    """
    own, found = faces[piece], []
    for side in range(3):
        start, end, other = own[:, side], own[:, (side + 1) % 3], across[piece, side]
        there = np.argmax(faces[other] == end[:, None], axis=1)  # the same edge's place in the other triangle
        here = np.arange(piece.start, piece.stop, dtype=np.int32)
        first = (side < there) | ((side == there) & (here < other))
        start, end, there, here, other = (x[first] for x in (start, end, there, here, other))
        normal = unit_normals(points, faces[here])
        bend = np.sum(normal * unit_normals(points, faces[other]), axis=1)
        beyond = np.sum((points[faces[other, (there + 2) % 3]] - points[start]) * normal, axis=1)
        sharp = (bend < _SHARP) & (beyond < 0)
        found.append((np.stack([start, end], 1)[sharp], np.stack([here, other], 1)[sharp], bend[sharp]))
    edges, beside, bend = (np.concatenate(part) for part in zip(*found, strict=True))
    return edges, beside, bend


def _thickness(points: np.ndarray, faces: np.ndarray) -> float:
    """The volume over the area."""
    volumes, areas = np.empty((2, len(faces)))
    for piece in pieces(len(faces)):
        a, b, c = (points[faces[piece, i]] for i in range(3))
        volumes[piece] = np.einsum("ij,ij->i", a, np.cross(b, c))
        areas[piece] = np.linalg.norm(area_normals(points, faces[piece]), axis=1)
    return (np.sum(volumes) / 6) / (np.sum(areas) / 2)


def _chords(points: np.ndarray, edges: np.ndarray, beside: np.ndarray, angle: np.ndarray) -> tuple:
    """Chords of the lines that the edges make, as straight as they must be to be few: with the triangles and the angle of
    the edge in the middle of each."""
    vertices, numbers, begins = _lines(edges)
    lines = len(begins) - 1
    size = float(np.linalg.norm(np.ptp(points[edges].reshape(-1, 3), axis=0)))
    off = _FINEST * size if lines <= MOST else _COARSEST * size
    while True:
        ends, middle = array("i"), array("i")
        for line, (begin, end) in enumerate(pairwise(begins)):
            at = begin + line  # each line has a vertex more than it has edges
            alone = [(0, 1)]
            chords = (
                alone if end == begin + 1 else _straightened(points[vertices[at : at + end - begin + 1]], off)
            )
            for i, j in chords:
                ends.extend((vertices[at + i], vertices[at + j]))
                middle.append(numbers[begin + (i + j) // 2])
        if len(middle) <= MOST or off >= _COARSEST * size:
            break
        off *= 2
    middle = np.array(middle)
    return np.array(ends).reshape(-1, 2), beside[middle], angle[middle]


def _lines(edges: np.ndarray) -> tuple[array, array, array]:
    """The vertices along each line of edges, its edges, and where each line's edges begin.

    A line ends where not two edges meet, or where it began.
    """
    names, met, ends = np.unique(edges.ravel(), return_index=True, return_inverse=True)
    own = np.argsort(ends, kind="stable").astype(np.int32).data  # the ends of edges at each vertex
    count = np.bincount(ends)
    start, degree = (np.cumsum(count) - count).data, count.data
    met = np.argsort(met)
    order = np.concatenate([met[count[met] != 2], met]).data
    left = bytearray(b"\1") * len(edges)
    vertices, numbers, begins = array("i"), array("i"), array("i")
    ends, names = ends.data, names.data

    def onward(vertex: int) -> Iterator[int]:
        for place in own[start[vertex] : start[vertex] + degree[vertex]]:
            if left[place // 2]:
                yield place

    for vertex in order:
        for place in onward(vertex):
            begins.append(len(numbers))
            vertices.append(names[vertex])
            step: int | None = place
            while step is not None:
                left[step // 2] = 0
                numbers.append(step // 2)
                last = ends[step ^ 1]
                vertices.append(names[last])
                step = next(onward(last), None) if degree[last] == 2 else None
    begins.append(len(numbers))
    return vertices, numbers, begins


def _straightened(points: np.ndarray, off: float) -> list[tuple[int, int]]:
    """The ends of the chords of a line that leave it by no more than `off` (Douglas and Peucker 1973)."""
    done, to_do = [], [(0, len(points) - 1)]
    while to_do:
        i, j = to_do.pop()
        chord, seen = points[j] - points[i], points[i : j + 1] - points[i]
        square = chord @ chord
        part = np.clip(seen @ chord / square, 0, 1) if square > 0 else np.zeros(len(seen))
        apart = np.linalg.norm(seen - part[:, None] * chord, axis=1)
        k = int(np.argmax(apart))
        if apart[k] <= off or j == i + 1:
            done.append((i, j))
        else:
            to_do += [(i, i + k), (i + k, j)]
    return done
