"""Meshes as OBJ files beside a model."""

from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO

import numpy as np

from ..errors import InputError
from ..files import check_writable, replacing
from ..scene import Object
from ..shape import Mesh


def mesh_name(path: Path, name: str) -> str:
    """The name of the mesh file of an object, beside the model at `path`."""
    return f"{path.stem}_{name}.obj"


@contextmanager
def replacing_with_meshes(path: Path, objects: Iterable[tuple[str, Object]]) -> Iterator[IO[str]]:
    """Open the model at `path` to be written, with the meshes of `objects` beside it: all of them, or none.

    **Raises:** `InputError` where a file cannot be written, or is one that the scene is made of.
    """
    meshes = {name: thing.shape for name, thing in objects if isinstance(thing.shape, Mesh)}
    targets = {name: path.with_name(mesh_name(path, name)) for name in meshes}
    for target in (path, *targets.values()):
        for mesh in meshes.values():
            if mesh.file is not None and check_writable(target) == Path(mesh.file):
                raise InputError(f"{target}: is a mesh of the scene; allowed: a model with another name")
    with ExitStack() as files:
        model = files.enter_context(replacing(path))  # the first to be opened is the last to be put in place
        for name, mesh in meshes.items():
            files.enter_context(replacing(targets[name])).write(_text(mesh))
        yield model


def _text(mesh: Mesh) -> str:
    scale = np.asarray(mesh.scale, np.float64)
    vertices = scale * np.asarray(mesh.vertices, np.float64)
    points = "".join(f"v {x!r} {y!r} {z!r}\n" for x, y, z in vertices.tolist())
    corners = np.asarray(mesh.triangles) + 1
    return points + "".join(f"f {a} {b} {c}\n" for a, b, c in corners.tolist())
