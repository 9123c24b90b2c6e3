"""The triangles of a GLB file (glTF 2.0, ISO/IEC 12113:2022), in all their places; nothing else of it is looked at."""

import json
import struct
from collections.abc import Iterator
from typing import IO, Any

import numpy as np

from .errors import InputError

_HEAD = struct.Struct("<4sIII4s")  # of the file, and of its first part
_PART = struct.Struct("<I4s")
_NUMBERS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_TRIANGLES, _STRIP, _FAN = 4, 5, 6
_JSON = 2**18  # bytes, and a quarter of the file: as objects it takes up to 40 times its room
# Bytes that may be unpacked from what is in several places, beside as many as the file has; a part counts as `_LEAST`.
_SPARE, _LEAST = 2**18, 256


def triangles_of(file: IO[bytes], most: int) -> tuple[np.ndarray, np.ndarray]:
    """The vertices (V, 3) and the triangles (T, 3) of all parts of the scene, each at its places.

    **Raises:** `InputError` for parts that lie in other files, are packed by an extension or are not within the file, and
    where those in several places take far more than its size or have more than `most` triangles; another
    `ValueError`, `LookupError`, `TypeError`, `AttributeError` or `RecursionError` for what is no GLB, and a description of
    another form.
    """
    data = file.read()
    about, binary = _parts(data)
    room, allowed, met = 0, len(data) + _SPARE, 0
    points, corners, count = [np.zeros((0, 3), np.float32)], [np.zeros((0, 3), np.int32)], 0
    for mesh, place in _placed(about):
        for primitive in _item(about, "meshes", mesh)["primitives"]:
            numbers = _numbers(about, binary, primitive["attributes"]["POSITION"], "VEC3")
            given = primitive.get("indices")
            order = (
                np.arange(len(numbers), dtype=np.int32)
                if given is None
                else _numbers(about, binary, given, "SCALAR")
            )
            room += max(numbers.nbytes + order.nbytes, _LEAST)
            if room > allowed:
                raise InputError(
                    f"has parts that take {room} bytes or more in all their places; allowed: at most {allowed}"
                )
            if order.size and not 0 <= order.min() <= order.max() < len(numbers):
                raise InputError(f"has a triangle of vertex {order.max()}; allowed: below {len(numbers)}")
            mode = primitive.get("mode", _TRIANGLES)
            met += max(len(order), len(numbers)) // (3 if mode == _TRIANGLES else 1)
            if met > most:
                raise InputError(
                    f"has {met} triangles or more; allowed: at most {most} in a file of its size"
                )
            faces = _faces(mode, order.reshape(-1).astype(np.int32)) + np.int32(count)
            points.append(numbers @ place[:3, :3].T + place[:3, 3])
            mirrored = np.linalg.det(place[:3, :3]) < 0
            corners.append(faces[:, ::-1] if mirrored else faces)
            count += len(numbers)
    return np.concatenate(points), np.concatenate(corners)


def _parts(data: bytes) -> tuple[Any, memoryview]:
    """What a file says of itself, and its numbers."""
    if len(data) < _HEAD.size:
        raise ValueError(f"{len(data)} bytes are no GLB file")
    magic, version, _, length, kind = _HEAD.unpack_from(data)
    if (magic, version, kind) != (b"glTF", 2, b"JSON") or length > len(data) - _HEAD.size:
        raise ValueError("no GLB file of glTF 2.0")
    if length > _JSON + len(data) // 4:
        raise InputError(f"has {length} bytes of JSON; allowed: at most {_JSON} and a quarter of the file")
    about = json.loads(data[_HEAD.size : _HEAD.size + length])
    rest = memoryview(data)[_HEAD.size + length :]
    if len(rest) >= _PART.size:
        length, kind = _PART.unpack_from(rest)
        if kind == b"BIN\0":
            return about, rest[_PART.size : _PART.size + length]
    return about, rest[:0]


def _placed(about: Any) -> Iterator[tuple[int, np.ndarray]]:
    """Each mesh that the scene shows, and where: a matrix (4, 4)."""
    open_ = [(node, np.eye(4)) for node in _item(about, "scenes", about.get("scene", 0))["nodes"]]
    met = {node for node, _ in open_}
    while open_:
        number, above = open_.pop()
        node = _item(about, "nodes", number)
        place = above @ _matrix(node)
        for child in node.get("children", ()):
            if child in met:
                raise InputError(f"has node {child} in two nodes; allowed: each in one")
            met.add(child)
            open_.append((child, place))
        if "mesh" in node:
            yield node["mesh"], place


def _matrix(node: Any) -> np.ndarray:
    """Where a node is in the one above it, (4, 4)."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0, 0, 0, 1))
    turned = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    place = np.eye(4)
    place[:3, :3] = turned * np.array(node.get("scale", (1, 1, 1)), np.float64)
    place[:3, 3] = node.get("translation", (0, 0, 0))
    return place


def _numbers(about: Any, binary: memoryview, number: int, kind: str) -> np.ndarray:
    """The numbers (n, 3) or (n, 1) that accessor `number` names, where they lie."""
    accessor = _item(about, "accessors", number)
    if accessor["type"] != kind:
        raise InputError(f"has {accessor['type']!r} in accessor {number}; allowed: {kind}")
    if "sparse" in accessor or "bufferView" not in accessor:
        raise InputError(f"has accessor {number} without numbers of its own; allowed: one that is not packed")
    view = _item(about, "bufferViews", accessor["bufferView"])
    if view["buffer"] != 0 or "uri" in _item(about, "buffers", 0):
        raise InputError(f"has the numbers of accessor {number} in another file; allowed: in this one")
    dtype, width = np.dtype(_NUMBERS[accessor["componentType"]]), 3 if kind == "VEC3" else 1
    count, size = accessor["count"], width * dtype.itemsize
    stride, within = view.get("byteStride", size), accessor.get("byteOffset", 0)
    start = view.get("byteOffset", 0)
    end = within + stride * (count - 1) + size
    if (
        min(count, start, within) < 0
        or stride < size
        or end > view["byteLength"]
        or start + end > len(binary)
    ):
        raise InputError(f"has the {count} numbers of accessor {number} not within it; allowed: in this file")
    found = np.ndarray((count, width), dtype, binary, start + within, (stride, dtype.itemsize))
    return found / np.float32(np.iinfo(dtype).max) if accessor.get("normalized") else found


def _faces(mode: int, order: np.ndarray) -> np.ndarray:
    """The triangles (n, 3) of vertices in this order; none of points and lines."""
    first = np.arange(max(len(order) - 2, 0), dtype=np.int32)
    if mode == _TRIANGLES:
        return order[: len(order) // 3 * 3].reshape(-1, 3)
    if mode == _STRIP:  # each second one runs the other way around
        return order[np.stack([first, first + 1 + first % 2, first + 2 - first % 2], axis=1)]
    if mode == _FAN:
        return np.stack([order[first + 1], order[first + 2], order[0 * first]], axis=1)
    return np.zeros((0, 3), np.int32)


def _item(about: Any, name: str, number: int) -> Any:
    """One of what a file lists; Python would count a negative number from the end."""
    if isinstance(number, bool) or not isinstance(number, int) or not 0 <= number < len(about[name]):
        raise InputError(
            f"has {number!r} as one of its {len(about[name])} {name}; allowed: a number below that"
        )
    return about[name][number]
