"""Meshes for tests, and what NumPy alone says of them."""

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

TILT = Rotation.from_rotvec([0.3, -0.5, 0.7]).as_matrix()  # so that no plane lies along an axis


def voxels(cells, size=0.02):
    """The surface of cubes of this edge length (m), with two triangles a square."""
    cells, squares = {tuple(c) for c in cells}, []
    for cell in cells:
        for axis in range(3):
            for side in (0, 1):
                step = np.eye(3, dtype=int)[axis] * (2 * side - 1)
                if tuple(np.add(cell, step)) in cells:
                    continue
                u, v = np.eye(3, dtype=int)[[(axis + 1) % 3, (axis + 2) % 3]]
                base = np.array(cell) + side * np.eye(3, dtype=int)[axis]
                square = [base, base + u, base + u + v, base + v]
                squares.append(square if side else square[::-1])
    flat, index = np.unique(np.reshape(squares, (-1, 3)), axis=0, return_inverse=True)
    q = index.reshape(-1, 4)
    return size * flat.astype(float), np.concatenate([q[:, [0, 1, 2]], q[:, [0, 2, 3]]])


def notched():
    """A cube of 40 mm without the octant beyond (20, 20, 20) mm: three planes meet in a concave corner there."""
    return voxels([c for c in np.ndindex(2, 2, 2) if c != (1, 1, 1)])


def torus():
    mesh = trimesh.creation.torus(0.03, 0.012, major_sections=16, minor_sections=8)
    return np.asarray(mesh.vertices) @ TILT.T, np.asarray(mesh.faces)


def icosphere(subdivisions, radius):
    mesh = trimesh.creation.icosphere(subdivisions, radius)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


def distance(vertices, triangles, queries):
    """Unsigned distance (m) from each query to the surface: the nearest of all edges, and of all planes it is above."""
    found = []
    for part in np.array_split(queries, max(1, len(queries) * len(triangles) // 400_000)):
        a, b, c = (vertices[triangles[:, i]][None] - part[:, None] for i in range(3))
        normal = np.cross(b - a, c - a)
        over = np.ones(normal.shape[:2], bool)
        nearest = np.full(normal.shape[:2], np.inf)
        for p, q in ((a, b), (b, c), (c, a)):
            along = q - p
            t = np.clip(-np.sum(p * along, axis=2) / np.sum(along**2, axis=2), 0, 1)
            nearest = np.minimum(nearest, np.linalg.norm(p + t[..., None] * along, axis=2))
            over &= np.sum(np.cross(along, -p) * normal, axis=2) >= 0
        height = np.abs(np.sum(a * normal, axis=2)) / np.linalg.norm(normal, axis=2)
        found.append(np.where(over, height, nearest).min(axis=1))
    return np.concatenate(found)


def inside(vertices, triangles, queries):
    """Whether each query is inside: its winding number, by the solid angles (van Oosterom and Strackee 1983)."""
    found = []
    for part in np.array_split(queries, max(1, len(queries) * len(triangles) // 400_000)):
        a, b, c = (vertices[triangles[:, i]][None] - part[:, None] for i in range(3))
        la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
        numerator = np.sum(a * np.cross(b, c), axis=2)
        ab, bc, ca = np.sum(a * b, axis=2), np.sum(b * c, axis=2), np.sum(c * a, axis=2)
        angle = np.arctan2(numerator, la * lb * lc + ab * lc + bc * la + ca * lb)
        found.append(angle.sum(axis=1) > np.pi)
    return np.concatenate(found)


def entries(vertices, triangles, start, end):
    """For each way its first entry from outside as (triangle, part of the way); (-1, inf) where it has none."""
    a, b, c = (vertices[triangles[:, i]][None] for i in range(3))
    way = (end - start)[:, None]
    normal = np.cross(b - a, c - a)
    slope = np.sum(normal * way, axis=2)
    crosses = slope < 0
    t = np.sum(normal * (a - start[:, None]), axis=2) / np.where(crosses, slope, 1)
    point = start[:, None] + t[..., None] * way
    hit = crosses & (t >= 0) & (t < 1)
    for p, q in ((a, b), (b, c), (c, a)):
        hit &= np.sum(normal * np.cross(q - p, point - p), axis=2) >= 0
    t = np.where(hit, t, np.inf)
    first = t.argmin(axis=1)
    when = t[np.arange(len(t)), first]
    return np.where(np.isfinite(when), first, -1), when


def grooved(angle, wide=0.12, long=0.4):
    """A block with a groove along y whose walls stand at `angle` to each other; its bottom is the y axis, its top is up."""
    half = np.radians(angle) / 2
    out, top = wide / 2, min(0.03, 0.4 * wide / np.tan(half))
    x = np.array([-out, out, out, top * np.tan(half), 0, -top * np.tan(half), -out])
    z = np.array([-0.02, -0.02, top, top, 0, top, top])
    vertices = np.concatenate([np.stack([x, np.full(7, y), z], axis=1) for y in (-long / 2, long / 2)])
    cap = np.array([(0, 1, 4), (1, 2, 3), (1, 3, 4), (0, 4, 5), (0, 5, 6)])
    i = np.arange(7)
    j = (i + 1) % 7
    sides = np.concatenate([np.stack([i, j + 7, j], axis=1), np.stack([i, i + 7, j + 7], axis=1)])
    return vertices, np.concatenate([cap, cap[:, ::-1] + 7, sides])
