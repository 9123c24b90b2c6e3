"""The triangles of a PLY file (Turk, The PLY polygon file format, 1994), of text or of numbers; nothing else of it."""

from array import array
from collections.abc import Iterator
from functools import lru_cache
from typing import IO, NamedTuple

import numpy as np

from ._fans import Fans
from ._lines import lines_of
from .errors import InputError

_TYPES = {
    **{name: "i1" for name in ("char", "int8")},
    **{name: "u1" for name in ("uchar", "uint8")},
    **{name: "i2" for name in ("short", "int16")},
    **{name: "u2" for name in ("ushort", "uint16")},
    **{name: "i4" for name in ("int", "int32")},
    **{name: "u4" for name in ("uint", "uint32")},
    **{name: "f4" for name in ("float", "float32")},
    **{name: "f8" for name in ("double", "float64")},
}
_WHOLE = [name for name, kind in _TYPES.items() if kind[0] != "f"]
_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_FACE = ("vertex_indices", "vertex_index")
_LINES = 1000  # of what a file says of itself
_TOGETHER = 2**14  # rows


class _Property(NamedTuple):
    """`length`: the type of how many numbers it has; "" of a single one."""

    name: str
    type: str
    length: str


class _Element(NamedTuple):
    name: str
    count: int
    properties: list[_Property]


def triangles_of(file: IO[bytes], most: int) -> tuple[np.ndarray, np.ndarray]:
    """The vertices (V, 3) and the triangles (T, 3), of polygons as fans.

    **Raises:** `InputError` for a description of another form, a file that ends early, long lines, and faces as `Fans`
    has it, of which there may be `most` triangles; another `ValueError` or `LookupError` for what is no number.
    """
    order, elements, line = _described(file)
    points, fans = array("d"), Fans(most)
    if order == "":
        _read_text(lines_of(file, line), elements, points, fans)
    else:
        _read_numbers(file.read(), elements, order, points, fans)
    found = np.frombuffer(points, np.float64).reshape(-1, 3)
    return found, fans.triangles(len(found))


def _described(file: IO[bytes]) -> tuple[str, list[_Element], int]:
    """The order of bytes ("" of text), the elements, and the number of the line after the description."""
    elements: list[_Element] = []
    order = None
    for number, line in lines_of(file):
        words = line.decode("latin-1").split()
        if number == 1 and words != ["ply"] or number > _LINES:
            break
        match words:
            case ["format", name, _] if name in _FORMATS:
                order = _FORMATS[name]
            case ["element", name, count] if count.isdigit():
                elements.append(_Element(name, int(count), []))
            case ["property", "list", length, kind, name] if elements and length in _WHOLE and kind in _TYPES:
                elements[-1].properties.append(_Property(name, _TYPES[kind], _TYPES[length]))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append(_Property(name, _TYPES[kind], ""))
            case ["end_header"] if order is not None:
                return order, elements, number + 1
            case ["ply"] | ["comment", *_] | ["obj_info", *_] | []:
                pass
            case _:
                raise InputError(
                    f"line {number} is {' '.join(words)[:80]!r}; allowed: the description of a PLY file"
                )
    raise InputError("has no description of a PLY file; allowed: one from 'ply' to 'end_header'")


def _read_text(
    lines: Iterator[tuple[int, bytes]], elements: list[_Element], points: array, fans: Fans
) -> None:
    """Add the vertices and the faces of a file of text."""
    for element in elements:
        corners = _corners(element)
        for _ in range(element.count):
            words = next((found for _, line in lines if (found := line.split())), None)
            if words is None:
                raise _early(element)
            if element.name == "vertex":
                row = dict(_words(words, element))
                points.extend(float(row[name][0]) for name in "xyz")
            elif element.name == "face":
                fans.add(list(map(int, dict(_words(words, element))[corners])))


def _words(words: list[bytes], element: _Element) -> Iterator[tuple[str, list[bytes]]]:
    """The words of each property in a row."""
    at = 0
    for part in element.properties:
        number = 1
        if part.length:
            number = int(words[at])
            at += 1
        if not at <= at + number <= len(words):
            raise InputError(f"has {len(words)} numbers in a row of {element.name!r}; allowed: as it says")
        yield part.name, words[at : at + number]
        at += number


def _read_numbers(data: bytes, elements: list[_Element], order: str, points: array, fans: Fans) -> None:
    """Add the vertices and the faces of a file of numbers."""
    at = 0
    for element in elements:
        corners = _corners(element)
        for rows, end in _rows(data, at, element, order):
            if element.name == "vertex":
                places = np.stack([rows[name] for name in "xyz"], axis=1)
                points.frombytes(places.astype(np.float64).tobytes())
            elif element.name == "face":
                fans.add_all(rows[corners])
            at = end


def _corners(element: _Element) -> str:
    """The property that the corners of faces are; "" of others."""
    if element.name == "vertex" and not {"x", "y", "z"} <= {
        part.name for part in element.properties if not part.length
    }:
        raise InputError("has vertices without x, y or z; allowed: with all three")
    if element.name != "face":
        return ""
    for part in element.properties:
        if part.name in _FACE and part.length and part.type[0] != "f":
            return part.name
    raise InputError(f"has faces without a list of whole numbers {' or '.join(_FACE)}; allowed: with one")


def _early(element: _Element) -> InputError:
    return InputError(
        f"ends within its {element.count} elements {element.name[:80]!r}; allowed: a whole file"
    )


def _rows(data: bytes, at: int, element: _Element, order: str) -> Iterator[tuple[np.ndarray, int]]:
    """Rows that lie one after another and have lists of the same lengths, some at a time; and where the next ones lie."""
    left, together = element.count if element.properties else 0, _TOGETHER
    given = [part for part in element.properties if part.length]
    while left:
        lengths = _lengths(data, at, element, order) if given else ()
        row = _layout(tuple(element.properties), lengths, order)
        number = min(left, together, (len(data) - at) // row.itemsize)
        if number <= 0:
            raise _early(element)
        block = np.frombuffer(data, row, number, at)
        same = np.ones(number, bool)
        for part, length in zip(given, lengths, strict=True):
            same &= block[f"number of {part.name}"] == length
        alike = number if same.all() else int(np.argmin(same))
        at += alike * row.itemsize
        left -= alike
        together = min(2 * alike, _TOGETHER)
        yield block[:alike], at


def _lengths(data: bytes, at: int, element: _Element, order: str) -> tuple[int, ...]:
    """How long each list of the row is that begins there."""
    lengths = []
    for part in element.properties:
        number = 1
        if part.length:
            kind = np.dtype(order + part.length)
            if at + kind.itemsize > len(data):
                raise _early(element)
            number = int(np.frombuffer(data, kind, 1, at)[0])
            if number < 0:
                raise InputError(f"has a list {part.name[:80]!r} of {number} numbers; allowed: 0 and above")
            lengths.append(number)
            at += kind.itemsize
        at += number * np.dtype(part.type).itemsize
    return tuple(lengths)


@lru_cache(maxsize=64)
def _layout(properties: tuple[_Property, ...], lengths: tuple[int, ...], order: str) -> np.dtype:
    """A row with lists of these lengths."""
    fields, left = [], iter(lengths)
    for part in properties:
        if part.length:
            fields += [
                (f"number of {part.name}", order + part.length),
                (part.name, order + part.type, (next(left),)),
            ]
        else:
            fields.append((part.name, order + part.type))
    return np.dtype(fields)
