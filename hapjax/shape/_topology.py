"""Which triangle of a mesh lies beside which, found once when the mesh is built; in NumPy."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .._memory import empty, give_back

LARGEST = 2**24  # a float32 counts so far
PIECE = 2**12  # triangles that are looked at together: all at once take 20 times the room of a mesh
SPARE = 16  # numbers behind the end of a list of which several are read at a time


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


def topology(
    vertices: np.ndarray, triangles: np.ndarray, across: np.ndarray, normals: Float[Array, "V 3"]
) -> Topology:
    """The neighbours of checked triangles.

    **Arguments:** `across` (T, 3): see `across_of`; `normals`: of the vertices, whose type all numbers have.
    """
    dtype, corner = normals.dtype, triangles.ravel()
    fan_start = np.zeros(len(vertices) + 1, np.int64)
    np.cumsum(np.bincount(corner, minlength=len(vertices)), out=fan_start[1:])
    order = np.argsort(corner, kind="stable")
    order //= 3
    fan = empty((len(order) + SPARE,), dtype)
    fan[: len(order)], fan[len(order) :] = order, 0
    del order
    give_back()
    patches = empty((len(triangles), 5, 3), dtype)
    for piece in pieces(len(triangles)):
        patches[piece, :3] = vertices[triangles[piece]]
    patches[:, 3], patches[:, 4] = across, triangles
    patches, fan_start, fan = (jnp.asarray(part, dtype) for part in (patches, fan_start, fan))
    return Topology(patches, fan_start, fan, normals)


def across_of(triangles: np.ndarray, count: int) -> np.ndarray:
    """The triangle across each edge (T, 3), of a closed surface of so many vertices."""
    key = np.empty(triangles.shape, np.int64)
    for piece in pieces(len(triangles)):
        key[piece] = edge_keys(triangles[piece], count)
    key = key.ravel()
    order = np.argsort(key)
    order //= 3
    owner = order.astype(np.int32)
    del order
    key.sort()
    across = np.empty(triangles.shape, np.int32)
    for piece in pieces(len(triangles)):
        across[piece] = owner[np.searchsorted(key, edge_keys(triangles[piece], count, back=True))]
    return across


def vertex_normals(vertices: Any, triangles: Any) -> Any:
    """Baerentzen and Aanaes 2005: the sum of the normals about a vertex, each times its triangle's angle there.

    In NumPy of NumPy's arrays; of JAX's, with their derivatives.
    """
    if isinstance(vertices, jax.Array):
        corner = triangles.reshape(-1)
        total = jnp.zeros_like(vertices).at[corner].add(_weighted(vertices, triangles, jnp))
        first = unit_normals(vertices, triangles)[
            jnp.zeros(len(vertices), int).at[corner].set(jnp.arange(len(corner)) // 3)
        ]
        return _units(total, first, jnp)
    total, of = np.zeros_like(vertices), np.zeros(len(vertices), np.int32)
    for piece in pieces(len(triangles)):
        corner = triangles[piece].reshape(-1)
        np.add.at(total, corner, _weighted(vertices, triangles[piece], np))
        of[corner] = piece.start + np.arange(len(corner)) // 3
    for piece in pieces(len(vertices)):
        total[piece] = _units(total[piece], unit_normals(vertices, triangles[of[piece]]), np)
    return total


def _weighted(vertices: Any, triangles: Any, xp: Any) -> Any:
    """The normal of each triangle three times, each times the angle at a corner (3 T, 3)."""
    normals, each = unit_normals(vertices, triangles), []
    for i in range(3):
        a, b, c = (vertices[triangles[:, (i + j) % 3]] for j in range(3))
        sine = xp.linalg.norm(xp.cross(b - a, c - a), axis=1)
        angle = xp.arctan2(sine, xp.sum((b - a) * (c - a), axis=1))
        each.append(angle[:, None] * normals)
    return xp.stack(each, axis=1).reshape(-1, 3)


def _units(total: Any, first: Any, xp: Any) -> Any:
    """The directions of sums of normals; the `first` ones where these cancel."""
    square = xp.sum(total * total, axis=1, keepdims=True)
    thin = square < 1e-18
    return xp.where(thin, first, total / xp.sqrt(xp.where(thin, 1, square)))


def unit_normals(vertices: Any, triangles: Any) -> Any:
    """The outward normals (T, 3)."""
    normals = area_normals(vertices, triangles)
    xp = jnp if isinstance(normals, jax.Array) else np
    return normals / xp.linalg.norm(normals, axis=1, keepdims=True)


def area_normals(vertices: Any, triangles: Any) -> Any:
    """The outward normals (T, 3), each as long as twice the area of its triangle."""
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    return (jnp if isinstance(vertices, jax.Array) else np).cross(b - a, c - a)


def edge_keys(triangles: np.ndarray, count: int, back: bool = False) -> np.ndarray:
    """A number for each directed edge of triangles of so many vertices; `back`: that of the other direction."""
    start, end = triangles.astype(np.int64), np.roll(triangles, -1, axis=1).astype(np.int64)
    return end * count + start if back else start * count + end


def pieces(count: int) -> list[slice]:
    """So many rows, `PIECE` at a time."""
    return [slice(i, min(i + PIECE, count)) for i in range(0, count, PIECE)]
