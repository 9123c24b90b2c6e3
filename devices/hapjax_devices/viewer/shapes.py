"""Shapes as triangles to be drawn."""

import numpy as np
import trimesh
from trimesh import creation

from hapjax.shape import Box, Capsule, Cylinder, Mesh, Plane, Shape, Sphere

PLANE = 0.6  # m, edge length of the part of a plane that is drawn


def triangles(shape: Shape) -> tuple[np.ndarray, np.ndarray, bool]:
    """The vertices (V, 3), m, and the triangles (T, 3) of a shape in its own frame, and whether its sides are flat."""
    match shape:
        case Plane():
            half = PLANE / 2
            corners = np.array([[-half, -half, 0], [half, -half, 0], [half, half, 0], [-half, half, 0]])
            return corners, np.array([[0, 1, 2], [0, 2, 3]]), True
        case Mesh():
            return np.asarray(shape.vertices * shape.scale), np.asarray(shape.triangles), not shape.shaded
    solid, flat = _solid(shape)
    return np.asarray(solid.vertices), np.asarray(solid.faces), flat


def _solid(shape: Shape) -> tuple[trimesh.Trimesh, bool]:
    match shape:
        case Box():
            return creation.box(np.asarray(shape.size)), True
        case Sphere():
            return creation.icosphere(4, float(shape.radius)), False
        case Cylinder():
            solid = creation.cylinder(float(shape.radius), float(shape.length), sections=64)
            solid.unmerge_vertices()  # or light would flow round its rims
            return solid, True
        case Capsule():
            solid = creation.capsule(float(shape.length), float(shape.radius), count=[32, 32])
            solid.vertices -= solid.bounds.mean(axis=0)  # whatever end it was made from
            return solid, False
    raise TypeError(f"a {type(shape).__name__.lower()} cannot be drawn")
