"""Meshes and convex polytopes from files, and in scene files."""

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from . import glb, obj, ply, stl
from ._memory import give_back
from .errors import InputError, within
from .shape import CONTACT_POINTS, Convex, Mesh, room_for

_READERS = {form.__name__.rpartition(".")[2]: form.triangles_of for form in (stl, obj, ply, glb)}
_LARGEST = 512 * 2**20  # bytes; some ten million triangles
_TIMES, _SPARE = 20, 2**25  # so many times its size, and so many bytes, a file may take in memory
_SMALL = 2**24  # bytes that a small mesh takes, most of it to compile what finds its volume
_LEAST = 250  # bytes that a triangle takes at least
_APART = 1e-8  # units of the file; nearer vertices are one
_ALLOWED = f"allowed: a file ending in .{', .'.join(_READERS)}"
_FIELDS = {
    Mesh: ("file", "scale", "shaded", "contact_points"),
    Convex: ("points", "file", "scale", "contact_points"),
}


def load_mesh(
    path: str | os.PathLike, scale: Any = 1.0, shaded: Any = False, contact_points: Any = CONTACT_POINTS
) -> Mesh:
    """Read a mesh from an STL, OBJ, PLY or GLB file; all parts of a GLB at their places, as one mesh.

    Nothing but this file is read: materials and textures that it names are not. Vertices in one place are merged.

    **Arguments:** `scale`: m in one unit of the file; `shaded` and `contact_points` as for `Mesh`.

    **Raises:** `InputError`, one sentence that names the file: it cannot be read, or as for `Mesh`.
    """
    with within(f"{path}: "):
        vertices, triangles = _read(Path(path))
        give_back()
        _refuse_large(Path(path).stat().st_size, vertices, triangles)
        return Mesh(vertices, triangles, scale, shaded, str(Path(path).resolve()), contact_points)


def shape_fields(kind: type[Mesh]) -> tuple[str, ...]:
    """The fields of a mesh's table in a scene file."""
    return _FIELDS[kind]


def shape_from_table(kind: type[Mesh], table: Mapping[str, Any], folder: Path | None) -> Mesh:
    """The mesh that a scene file's table describes; its file lies in the scene file's `folder`."""
    rest = {key: value for key, value in table.items() if key not in ("file", "points")}
    if kind is Convex and ("file" in table) == ("points" in table):
        given = "points and file are both given" if "file" in table else "points are missing"
        raise InputError(f"{given}; allowed: points or file")
    if "points" in table:
        return Convex(table["points"], **rest)
    if "file" not in table:
        raise InputError("file is missing; allowed: a scene that gives it")
    path = _within_folder(table["file"], folder)
    if kind is Mesh:
        with within("file "):
            return load_mesh(path, **rest)
    with within(f"file {path}: "):
        return Convex(_read(path)[0], **rest, file=str(path.resolve()))


def table_of_shape(shape: Mesh, folder: Path | None) -> dict[str, Any]:
    """The fields, other than its numbers, that a mesh has in a scene file in `folder`.

    **Raises:** `InputError` where a mesh is in no file, or in none of that folder.
    """
    if shape.file is not None and folder is not None and Path(shape.file).is_relative_to(folder.resolve()):
        table: dict[str, Any] = {"file": Path(shape.file).relative_to(folder.resolve()).as_posix()}
    elif isinstance(shape, Convex):
        table = {"points": shape.vertices}
    elif shape.file is None:
        raise InputError("file is missing: the mesh was not loaded from one; allowed: a mesh from load_mesh")
    else:
        raise InputError(f"file is {shape.file!r}; allowed: a file in the folder of the scene file")
    if shape.shaded:
        table["shaded"] = True
    if shape.contact_points != CONTACT_POINTS:
        table["contact_points"] = shape.contact_points
    return table | {"scale": shape.scale}


def _within_folder(name: Any, folder: Path | None) -> Path:
    allowed = "allowed: a relative path to a file in the folder of the scene file"
    if not isinstance(name, str) or not name or "\0" in name:
        raise InputError(f"file is {name!r}; {allowed}")
    if folder is None:
        raise InputError(f"file is {name!r}, but the scene is not from a file; {allowed}")
    path = folder / name
    inside = Path(os.path.realpath(path)).is_relative_to(folder.resolve())  # also of a link to itself
    if Path(name).is_absolute() or ".." in Path(name).parts or not inside:
        raise InputError(f"file is {name!r}; {allowed}")
    return path


def _read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """The merged vertices and the triangles of a file."""
    read = _READERS.get(path.suffix.lower()[1:])
    if read is None:
        raise InputError(f"has the ending {path.suffix.lower()!r}; {_ALLOWED}")
    try:
        size = path.stat().st_size
        if size > _LARGEST:
            raise InputError(f"has {size} bytes; allowed: a mesh of at most {_LARGEST} bytes")
        file = path.open("rb")
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror}); {_ALLOWED}") from None
    with file:
        try:
            vertices, triangles = read(file, _allowed(size) // _LEAST)
        except InputError:
            raise
        # Whatever the file has may fail anywhere in its reader.
        except Exception as error:
            reason = " ".join(f"{type(error).__name__}: {error}".split())[:200]
            raise InputError(f"is no mesh that can be read ({reason}); {_ALLOWED}") from None
    if len(triangles) == 0:
        raise InputError(f"has no triangles; {_ALLOWED}")
    return _merged(vertices, triangles)


def _allowed(size: int) -> int:
    """The bytes that a file of this size may take in memory."""
    return _TIMES * size + _SPARE


def _refuse_large(size: int, vertices: np.ndarray, triangles: np.ndarray) -> None:
    room = _SMALL + room_for(vertices, triangles)
    if room > _allowed(size):
        raise InputError(
            f"has {len(triangles)} triangles that would take {room} bytes in memory; "
            f"allowed: at most {_allowed(size)}, {_TIMES} times the size of the file and {_SPARE}"
        )


def _merged(vertices: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The triangles with their vertices in the file's order: those in one place are one, those of no triangle left out."""
    used = np.zeros(len(vertices), bool)
    used[triangles] = True
    points = vertices[used].astype(np.float64)
    cells = np.round(points.T / _APART)
    order = np.lexsort(cells).astype(np.int32)
    begins = np.zeros(len(order), bool)
    begins[:1] = True
    for cell in cells:
        along = cell[order]
        begins[1:] |= along[1:] != along[:-1]
    del cells, along
    firsts = order[begins]  # the sort is stable: of those in one place the first of the file
    rank = np.empty(len(firsts), np.int32)
    rank[np.argsort(firsts)] = np.arange(len(firsts))
    numbers = np.zeros(len(vertices), np.int32)
    numbers[np.flatnonzero(used)[order]] = rank[np.cumsum(begins) - 1]
    return points[np.sort(firsts)], numbers[triangles]
