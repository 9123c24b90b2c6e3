"""The convex polytope."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from .._memory import give_back
from .._validate import as_float, is_traced
from ..errors import InputError
from ._topology import area_normals, pieces
from .mesh import CONTACT_POINTS, Mesh

_ALLOWED = "allowed: at least four points in m that do not all lie in one plane"
# By so much the unit normals of two triangles of one flat face may differ: more than single precision rounds.
_FLAT = 1e-5


class Convex(Mesh):
    """The convex hull of points. Its flat faces, named by their numbers, can have a mu of their own.

    **Arguments:** `points` (P, 3), m, times `scale`; those inside the hull are left out of `vertices`. `file`
    and `contact_points` as for `Mesh`.

    **Raises:** `InputError` where the points have no hull with a volume, or are traced: a hull is not differentiated,
    but its `vertices` and its `scale` are.
    """

    facets: Float[Array, "T"]
    count: int = eqx.field(static=True)

    def __init__(
        self,
        points: Any,
        scale: Any = 1.0,
        file: str | None = None,
        contact_points: Any = CONTACT_POINTS,
    ):
        points = as_float(points)
        if is_traced(points):
            raise InputError("points are traced; allowed: known numbers (see Convex.moved)")
        used, triangles, facets = _hull(points)
        give_back()
        super().__init__(points[used], triangles, scale, False, file, contact_points)
        self.facets = jnp.asarray(facets, self.vertices.dtype)
        self.count = int(facets.max()) + 1

    @property
    def faces(self) -> tuple[str, ...]:
        """The numbers of the flat faces."""
        return tuple(map(str, range(self.count)))

    def face_normals(self) -> Float[Array, "n 3"]:
        """The outward normal of each flat face, in the order of `faces`."""
        first = np.unique(np.asarray(self.facets), return_index=True)[1]
        a, b, c = (self.vertices[self.triangles[first, i]] for i in range(3))
        normals = jnp.cross(b - a, c - a)
        return normals / jnp.linalg.norm(normals, axis=1, keepdims=True)

    @property
    def is_hollow(self) -> bool:
        """A hull is not."""
        return False

    def _face(self, triangle: Int[Array, "*n"]) -> Int[Array, "*n"]:
        return self.facets[triangle].astype(jnp.int32)

    @property
    def _has_corners(self) -> bool:
        """A convex shape has no concave corners."""
        return False


def _hull(points: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The points on the hull, its triangles counter-clockwise seen from outside, and the flat face of each."""
    from scipy.spatial import ConvexHull, QhullError  # here, since it takes a while to load

    points = np.asarray(points, np.float64) if hasattr(points, "dtype") else np.empty(())
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < 4 or not np.isfinite(points).all():
        raise InputError(f"points are no rows of three finite numbers; {_ALLOWED}")
    try:
        hull = ConvexHull(points)
    except QhullError:
        raise InputError(f"points have no hull with a volume; {_ALLOWED}") from None
    used, triangles = np.unique(hull.simplices, return_inverse=True)
    triangles = triangles.astype(np.int32).reshape(-1, 3)
    outer = points[used]
    for piece in pieces(len(triangles)):
        own = triangles[piece]
        turned = np.sum(area_normals(outer, own) * hull.equations[piece, :3], axis=1) < 0
        own[turned] = own[turned][:, ::-1]
    return used, triangles, _flat_faces(hull.equations[:, :3], hull.neighbors)


def _flat_faces(normals: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
    """A number for each triangle, the same for neighbours in one plane."""
    apart = [np.linalg.norm(normals[p, None] - normals[neighbours[p]], axis=2) for p in pieces(len(normals))]
    same = np.concatenate(apart) < _FLAT
    label = np.arange(len(normals))
    while True:
        least = np.minimum(label, np.where(same, label[neighbours], len(label)).min(axis=1))
        if np.array_equal(least, label):
            return np.unique(label, return_inverse=True)[1]
        label = least
