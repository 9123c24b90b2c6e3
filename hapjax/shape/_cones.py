"""Which boxes of a mesh's tree may have a place that is locally nearest to a point: by cones of their normals."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ._topology import PIECE, Topology, area_normals
from ._triangle import dot

_BEND = 1e-3  # sine of the angle by which a surface bends inward at an edge: less is rounding
_SLACK = 1e-3  # of a cosine


def is_hollow(vertices: np.ndarray, triangles: np.ndarray, beside: Topology) -> bool:
    """Whether a ball can touch the surface in two places at once: it bends inward somewhere, or is in pieces."""
    normals = _normals(vertices, triangles)
    across = np.asarray(beside.patches[:, 3]).astype(np.int32)
    for i in range(0, len(triangles), PIECE):
        near, own = across[i : i + PIECE], triangles[i : i + PIECE]
        edges = vertices[np.roll(own, -1, axis=1)] - vertices[own]
        bend = np.sum(np.cross(normals[i : i + PIECE, None], normals[near]) * edges, axis=2)
        if np.any(bend < -_BEND * np.linalg.norm(edges, axis=2)):
            return True
    del normals
    from scipy.sparse import coo_matrix  # here, since it takes a while to load
    from scipy.sparse.csgraph import connected_components

    links = np.ones(across.size, bool), (np.repeat(np.arange(len(across), dtype=np.int32), 3), across.ravel())
    return connected_components(coo_matrix(links, shape=(len(across),) * 2), directed=False)[0] > 1


def cones_of(
    vertices: np.ndarray,
    triangles: np.ndarray,
    beside: Topology,
    boxes: Float[np.ndarray, "G 5 3"],
    start: Int[np.ndarray, "G"],
) -> Float[np.ndarray, "G 4"]:
    """The cone about the normals at each group of triangles, and at those beside them: its axis, along the axes of the
    group's box, and the cosine of its angle. The normals at an edge or a vertex lie between those of its triangles.

    **Arguments:** `triangles` in the order of the groups, which begin at `start`.
    """
    normals = _normals(vertices, triangles)
    middle = np.asarray(beside.vertex_normals, np.float64)
    least = np.ones(len(vertices))
    np.minimum.at(least, triangles.ravel(), np.sum(normals[:, None] * middle[triangles], axis=2).ravel())
    spread = np.arccos(np.clip(least, -1, 1))
    axis = np.add.reduceat(normals, start)
    size = np.linalg.norm(axis, axis=1, keepdims=True)
    axis = np.where(size > 0, axis / np.where(size > 0, size, 1), [0, 0, 1])
    owner = np.repeat(np.arange(len(start)), np.diff(np.append(start, len(triangles))))
    off = np.sum(axis[owner][:, None] * middle[triangles], axis=2)
    angle = np.max(np.arccos(np.clip(off, -1, 1)) + spread[triangles], axis=1)
    widest = np.minimum(np.maximum.reduceat(angle, start), np.pi)
    return np.concatenate([np.einsum("gij,gj->gi", boxes[:, :3], axis), np.cos(widest)[:, None]], axis=1)


def _normals(vertices: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    normals = area_normals(vertices, triangles)
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


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
