"""Where things that are drawn are and how they are turned, in NumPy: many at once, none of it in the servo's way."""

import numpy as np
from jaxtyping import Float


def matrices(quaternions: Float[np.ndarray, "*n 4"]) -> Float[np.ndarray, "*n 3 3"]:
    """The matrices of unit quaternions w x y z; NaN of NaN, which scipy refuses: so is an object that its scene has lost."""
    w, x, y, z = np.moveaxis(np.asarray(quaternions), -1, 0)
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def turned(
    pose: Float[np.ndarray, "*n 7"], directions: Float[np.ndarray, "*m 3"]
) -> Float[np.ndarray, "..."]:
    """Directions of objects' own frames in the world; `pose`: x y z qw qx qy qz of the objects."""
    return np.einsum("...ij,...j->...i", matrices(pose[..., 3:]), directions)


def placed(pose: Float[np.ndarray, "*n 7"], points: Float[np.ndarray, "*m 3"]) -> Float[np.ndarray, "..."]:
    """Points (m) of objects' own frames in the world."""
    return pose[..., :3] + turned(pose, points)


def from_z(directions: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 4"]:
    """The shortest turns w x y z of the z axis into directions of any length; none where that is 0."""
    size = np.linalg.norm(directions, axis=1, keepdims=True)
    x, y, z = np.divide(
        directions, size, out=np.tile([0.0, 0.0, 1.0], (len(directions), 1)), where=size > 0
    ).T
    # (1 + cos, z cross d), of the length 2 cos(angle / 2); straight down any half turn does.
    half = np.stack([1 + z, -y, x, np.zeros_like(z)], axis=1)
    half[1 + z < 1e-9] = [0.0, 1.0, 0.0, 0.0]
    return half / np.linalg.norm(half, axis=1, keepdims=True)


def ring(inner: float, sides: int = 64) -> tuple[np.ndarray, np.ndarray]:
    """A flat ring in the plane z = 0 of the outer radius 1 and an inner one, of 0 a disc: vertices and triangles."""
    around = np.arange(sides) * 2 * np.pi / sides
    rim = np.stack([np.cos(around), np.sin(around), np.zeros(sides)], axis=1)
    here, there = np.arange(sides), (np.arange(sides) + 1) % sides
    outer = np.stack([here, there, there + sides], axis=1)
    return np.concatenate([rim, inner * rim]), np.concatenate(
        [outer, np.stack([here, there + sides, here + sides], 1)]
    )


def rods(ends: Float[np.ndarray, "n 2 3"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where rods between two points each are: their middles (n, 3) m, the turns of the z axis into them (n, 4), and
    their lengths (n,) m."""
    way = ends[:, 1] - ends[:, 0]
    return ends.mean(axis=1), from_z(way), np.linalg.norm(way, axis=1)
