"""Which boxes of a mesh's tree may have a place that is locally nearest to a point: by cones of their normals."""

from collections.abc import Iterator

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ._topology import PIECE, pieces, unit_normals
from ._triangle import dot

_BEND = 1e-3  # sine of the angle by which a surface bends inward at an edge: less is rounding
_SLACK = 1e-3  # of a cosine


def is_hollow(vertices: np.ndarray, triangles: np.ndarray, across: np.ndarray) -> bool:
    """Whether a ball can touch the surface in two places at once: it bends inward somewhere, or is in pieces.

    **Arguments:** `across`: see `across_of`.
    """
    for piece in pieces(len(triangles)):
        own, near = triangles[piece], triangles[across[piece].ravel()]
        edges = vertices[np.roll(own, -1, axis=1)] - vertices[own]
        beside = unit_normals(vertices, near).reshape(-1, 3, 3)
        bend = np.sum(np.cross(unit_normals(vertices, own)[:, None], beside) * edges, axis=2)
        if np.any(bend < -_BEND * np.linalg.norm(edges, axis=2)):
            return True
    from scipy.sparse import coo_matrix  # here, since it takes a while to load
    from scipy.sparse.csgraph import connected_components

    links = np.ones(across.size, bool), (np.repeat(np.arange(len(across), dtype=np.int32), 3), across.ravel())
    return connected_components(coo_matrix(links, shape=(len(across),) * 2), directed=False)[0] > 1


def fill_cones(
    cones: Float[np.ndarray, "G 4"],
    boxes: Float[np.ndarray, "G 5 3"],
    vertices: np.ndarray,
    triangles: np.ndarray,
    start: Int[np.ndarray, "G1"],
    normals: Float[np.ndarray, "V 3"],
    spread: Float[np.ndarray, "V"],
) -> None:
    """Fill in the cone about the normals at each group of triangles, and at those beside them: its axis, along the axes of
    the group's box, and the cosine of its angle. The normals at an edge or a vertex lie between those of its triangles.

    **Arguments:** `triangles` in the order of the groups, which begin at `start`; `normals`: of the vertices; `spread`:
    see `spread_of`.
    """
    for groups in some_groups(start):
        own = start[groups.start : groups.stop + 1]
        cones[groups] = _cones_about(
            vertices, triangles[own[0] : own[-1]], normals, spread, boxes[groups], own - own[0]
        )


def spread_of(vertices: np.ndarray, triangles: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """How far, as an angle, the normals of the triangles about each vertex lead away from the vertex's."""
    least = np.ones(len(vertices))
    for piece in pieces(len(triangles)):
        own = triangles[piece]
        middle = normals[own].astype(np.float64)
        cosine = np.sum(unit_normals(vertices, own)[:, None] * middle, axis=2)
        np.minimum.at(least, own.ravel(), cosine.ravel())
    return np.arccos(np.clip(least, -1, 1))


def _cones_about(
    vertices: np.ndarray,
    triangles: np.ndarray,
    normals: np.ndarray,
    spread: np.ndarray,
    boxes: np.ndarray,
    start: np.ndarray,
) -> np.ndarray:
    own = np.empty(triangles.shape)
    for piece in pieces(len(triangles)):
        own[piece] = unit_normals(vertices, triangles[piece])
    axis = np.add.reduceat(own, start[:-1])
    del own
    size = np.linalg.norm(axis, axis=1, keepdims=True)
    axis = np.where(size > 0, axis / np.where(size > 0, size, 1), [0, 0, 1])
    owner, angle = np.repeat(np.arange(len(axis)), np.diff(start)), np.empty(len(triangles))
    for piece in pieces(len(triangles)):
        middle = normals[triangles[piece]].astype(np.float64)
        off = np.sum(axis[owner[piece]][:, None] * middle, axis=2)
        angle[piece] = np.max(np.arccos(np.clip(off, -1, 1)) + spread[triangles[piece]], axis=1)
    widest = np.minimum(np.maximum.reduceat(angle, start[:-1]), np.pi)
    return np.concatenate([np.einsum("gij,gj->gi", boxes[:, :3], axis), np.cos(widest)[:, None]], axis=1)


def some_groups(start: Int[np.ndarray, "G1"]) -> Iterator[slice]:
    """Groups that begin at `start`, a few at a time; one that is empty is told by the next one, and comes with it."""
    count = len(start) - 1
    i, step = 0, max(1, count * PIECE // int(start[-1]))
    while i < count:
        end = min(i + step, count)
        while start[end] == start[end - 1]:
            end += 1
        yield slice(i, end)
        i = end


def may_face(
    boxes: Float[Array, "n 5 3"], cones: Float[Array, "n 4"], query: Float[Array, "3"]
) -> Bool[Array, "n"]:
    """Whether a normal at a place in each box may lead to `query` (Johnson and Cohen 2001: with the sphere about a box
    the ways from it to the query are a cone as well)."""
    low, high = boxes[:, 3], boxes[:, 4]
    seen = dot(boxes[:, :3], query[None, None]) - (low + high) / 2
    round, far = dot(high - low, high - low) / 4, dot(seen, seen)
    beyond = far > round
    part = jnp.where(beyond, round / jnp.where(beyond, far, 1), 1)
    cosine = cones[:, 3]
    sine = jnp.sqrt(jnp.maximum(1 - cosine**2, 0))
    limit = cosine * jnp.sqrt(1 - part) - sine * jnp.sqrt(part) - _SLACK
    facing = dot(cones[:, :3], seen) >= limit * jnp.sqrt(far)
    return ~beyond | (cosine <= 0) | facing
