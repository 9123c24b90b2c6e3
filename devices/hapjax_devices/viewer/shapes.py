"""Shapes as triangles to be drawn."""

from typing import Any

import numpy as np
import trimesh
from trimesh import creation
from trimesh.exchange.gltf import export_glb
from trimesh.visual import TextureVisuals
from trimesh.visual.material import PBRMaterial

from hapjax import Object
from hapjax.shape import Box, Capsule, Cylinder, Mesh, Shape, Sphere

CLEAR, SOLID = 0.55, 0.9  # opacities of what fingers feel, and go into, and of all else


def as_light(colours: Any) -> np.ndarray:
    """Colours as screens have them, 0 to 255, as amounts of light, to 255: glTF takes these, and so do viser's batches."""
    return np.round(255 * (np.asarray(colours) / 255) ** 2.2).astype(np.uint8)


def glb(thing: Object, colour: tuple[int, int, int]) -> bytes:
    """An object as binary glTF.

    By that format what is translucent hides nothing behind it; viser's own meshes do, as the order happens to be in which
    they are drawn.
    """
    vertices, faces, flat = triangles(thing.shape)
    opacity = SOLID if thing.surface is None else CLEAR
    material = PBRMaterial(
        baseColorFactor=[*as_light(colour) / 255, opacity],
        metallicFactor=0.0,
        roughnessFactor=1.0,
        alphaMode="BLEND",
    )
    visual = TextureVisuals(material=material)
    mesh = trimesh.Trimesh(vertices, faces, visual=visual, process=False)
    return export_glb(mesh, include_normals=not flat)


def triangles(shape: Shape) -> tuple[np.ndarray, np.ndarray, bool]:
    """The vertices (V, 3), m, and the triangles (T, 3) of a shape in its own frame, and whether its sides are flat."""
    if isinstance(shape, Mesh):
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
