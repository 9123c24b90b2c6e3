"""The sharp convex edges of a surface of triangles, by which it can lie across another object's."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

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


def creases_of(points: np.ndarray, faces: np.ndarray, dtype: Any) -> Creases:
    """The sharp convex edges of a closed surface whose triangles wind counter-clockwise seen from outside.

    Where they are more than `MOST`, edges that run on from each other are put together into chords, as straight as can
    be; if that does not do, the longest and sharpest are kept.
    """
    corners = points[faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals = across / np.linalg.norm(across, axis=1, keepdims=True)
    directed = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    owner = np.tile(np.arange(len(faces)), 3)
    opposite = np.concatenate([faces[:, 2], faces[:, 0], faces[:, 1]])
    order = np.lexsort((np.max(directed, axis=1), np.min(directed, axis=1)))
    first, second = order[0::2], order[1::2]  # closed: each edge belongs to two triangles
    a, b = owner[first], owner[second]
    bend = np.sum(normals[a] * normals[b], axis=1)
    beyond = np.sum((points[opposite[second]] - points[directed[first, 0]]) * normals[a], axis=1)
    sharp = (bend < _SHARP) & (beyond < 0)
    edges, beside = directed[first][sharp], np.stack([a, b], axis=1)[sharp]
    angle = np.arccos(np.clip(bend[sharp], -1, 1))
    if len(edges) > MOST:
        edges, beside, angle = _chords(points, edges, beside, angle)
    if len(edges) > MOST:
        length = np.linalg.norm(points[edges[:, 1]] - points[edges[:, 0]], axis=1)
        kept = np.sort(np.argsort(-length * angle, kind="stable")[:MOST])
        edges, beside = edges[kept], beside[kept]
    volume = np.sum(np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) / 6
    area = np.sum(np.linalg.norm(across, axis=1)) / 2
    return Creases(jnp.asarray(edges, dtype), jnp.asarray(beside, dtype), jnp.asarray(volume / area, dtype))


def _chords(points: np.ndarray, edges: np.ndarray, beside: np.ndarray, angle: np.ndarray) -> tuple:
    """Chords of the lines that the edges make, as straight as they must be to be few: with the triangles and the angle of
    the edge in the middle of each."""
    lines = _lines(edges)
    size = float(np.linalg.norm(np.ptp(points[edges].reshape(-1, 3), axis=0)))
    off = _FINEST * size if len(lines) <= MOST else _COARSEST * size
    while True:
        chords = [(line, i, j) for line in lines for i, j in _straightened(points[line[0]], off)]
        if len(chords) <= MOST or off >= _COARSEST * size:
            break
        off *= 2
    ends = np.array([(vertices[i], vertices[j]) for (vertices, _), i, j in chords])
    middle = np.array([numbers[(i + j) // 2] for (_, numbers), i, j in chords])
    return ends, beside[middle], angle[middle]


def _lines(edges: np.ndarray) -> list[tuple[list[int], list[int]]]:
    """The vertices and the edges along each line of edges, which ends where not two of them meet, or where it began."""
    at: dict[int, list[tuple[int, int]]] = {}
    for number, (a, b) in enumerate(edges.tolist()):
        at.setdefault(a, []).append((number, b))
        at.setdefault(b, []).append((number, a))
    left, lines = set(range(len(edges))), []
    ends = [vertex for vertex, own in at.items() if len(own) != 2]
    for vertex in [*ends, *at]:
        for number, other in at[vertex]:
            if number not in left:
                continue
            line = [vertex, other], [number]
            left.remove(number)
            while len(at[line[0][-1]]) == 2:
                onward = [step for step in at[line[0][-1]] if step[0] in left]
                if not onward:
                    break
                left.remove(onward[0][0])
                line[1].append(onward[0][0])
                line[0].append(onward[0][1])
            lines.append(line)
    return lines


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
