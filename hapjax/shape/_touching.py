"""The vertices by which a mesh touches other objects."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._topology import pieces

_BESIDE = 8  # chosen points about a vertex, over which it may stand out


class Touching(eqx.Module):
    """The numbers of the `vertices` that touch other objects, as floats, and how far (m) any other one stands out over
    those of them that are nearest to it: the `bulge`."""

    vertices: Float[Array, "P"]
    bulge: Float[Array, ""]


def touching_of(vertices: np.ndarray, normals: np.ndarray, most: int, dtype: Any) -> Touching:
    """At most `most` vertices that keep what the surface touches with: all, where they are no more.

    First those farthest out in evenly spread directions, half of them all, by which the solid stands on a floor; then
    each time the vertex that is farthest from all that are chosen (Gonzalez 1985).
    """
    if len(vertices) <= most:
        return Touching(jnp.arange(len(vertices), dtype=dtype), jnp.zeros((), dtype))
    from scipy.spatial import KDTree  # here, since it takes a while to load

    chosen = np.unique([np.argmax(vertices @ way) for way in _spread(most // 2)]).tolist()
    left = KDTree(vertices[chosen]).query(vertices)[0]
    while len(chosen) < most:
        chosen.append(int(np.argmax(left)))
        for piece in pieces(len(vertices)):
            apart = np.linalg.norm(vertices[piece] - vertices[chosen[-1]], axis=1)
            left[piece] = np.minimum(left[piece], apart)
    chosen = np.sort(chosen)
    tree, bulge = KDTree(vertices[chosen]), -np.inf
    for piece in pieces(len(vertices)):
        own = vertices[piece]
        near = tree.query(own, min(_BESIDE, len(chosen)))[1].reshape(len(own), -1)
        apart = own[:, None] - vertices[chosen][near]
        above = np.einsum("vni,vi->vn", apart, normals[piece].astype(np.float64))
        bulge = max(bulge, above.min(axis=1).max())
    return Touching(jnp.asarray(chosen, dtype), jnp.asarray(max(bulge, 0.0), dtype))


def _spread(count: int) -> np.ndarray:
    """Unit vectors in a spiral from pole to pole, each for the same area of the sphere."""
    i = np.arange(count)
    height, angle = 1 - (2 * i + 1) / count, i * np.pi * (3 - np.sqrt(5))
    radius = np.sqrt(1 - height**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), height], axis=1)
