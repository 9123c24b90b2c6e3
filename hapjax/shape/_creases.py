"""The sharp convex edges of a surface of triangles, by which it can lie across another object's."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

_SHARP = np.cos(np.radians(10.0))  # a tessellated smooth surface touches by its vertices alone


class Creases(eqx.Module):
    """Of each sharp edge the numbers of its two `vertices` and of its two `triangles`, as floats.

    `thickness` (m) is the volume over the area: half the thickness of a plate.
    """

    vertices: Float[Array, "E 2"]
    triangles: Float[Array, "E 2"]
    thickness: Float[Array, ""]


def creases_of(points: np.ndarray, faces: np.ndarray, dtype: Any) -> Creases:
    """The sharp convex edges of a closed surface whose triangles wind counter-clockwise seen from outside."""
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
    volume = np.sum(np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))) / 6
    area = np.sum(np.linalg.norm(across, axis=1)) / 2
    return Creases(
        jnp.asarray(directed[first][sharp], dtype),
        jnp.asarray(np.stack([a, b], axis=1)[sharp], dtype),
        jnp.asarray(volume / area, dtype),
    )
