"""Models of other simulators as scenes."""

import os
from pathlib import Path

import numpy as np

from ..errors import InputError, within
from ..scene import Object, Scene, World
from .from_mjcf import gravity_of_mjcf, parts_of_mjcf
from .from_urdf import parts_of_urdf
from .markup import read_xml
from .parts import Part, free_name, object_of

_MOST = 100  # an object takes some 20 kB


def load_model(path: str | os.PathLike[str], hull: bool = False) -> Scene:
    """Read the bodies of an MJCF or URDF file: shape, place, mass, centre and inertia of each.

    A body becomes an object with the frame of its shape, which is the one that collides, or else the one that is seen.
    Bodies that are fixed to each other are one. A body without a weight is fixed in space. What joints allow but a body
    to move freely is refused. Friction and softness are not read: they belong to a contact, whose other side is not in the
    file.

    **Arguments:** `hull`: each mesh is taken as its convex hull, as MuJoCo's contacts do; it need not be closed then.

    Only the file and the meshes that it names are read; these have to be in its folder or below it.

    **Raises:** `InputError`, one sentence that names the file, the body, and what is allowed.
    """
    path = Path(path)
    with within(f"{path}: "):
        root = read_xml(path)
        if root.tag == "mujoco":
            parts, gravity = parts_of_mjcf(root, path.parent, hull), gravity_of_mjcf(root)
        elif root.tag == "robot":
            parts, gravity = parts_of_urdf(root, path.stem), np.array([0.0, 0.0, -9.81])
        else:
            raise InputError(f"begins with {root.tag[:60]!r}; allowed: mujoco (MJCF) or robot (URDF)")
        return Scene(_objects(parts, path.parent, hull), world=World(gravity=gravity))


def _objects(parts: list[Part], folder: Path, hull: bool) -> dict[str, Object]:
    if len(parts) > _MOST:
        raise InputError(f"has {len(parts)} bodies; allowed: at most {_MOST}")
    objects: dict[str, Object] = {}
    for part in parts:
        with within(f"body {part.name}: "):
            objects[free_name(part.name, list(objects))] = object_of(part, folder, hull)
    return objects
