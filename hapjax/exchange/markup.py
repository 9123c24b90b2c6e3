"""XML: read with care, and written."""

import os
import re
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import InputError

_LARGEST = 16 * 2**20  # bytes; meshes are files of their own
_DEEPEST = 100
_AT_LEAST = 2**20  # bytes that a model may take in memory, however small its file
_TIMES = 18  # what its tree may take beside the text itself, in sizes of the file
# Bytes in CPython of an element with a short text, of a table of attributes, and of each of them.
_ELEMENT, _TABLE, _ATTRIBUTE = 150, 200, 60
_ALLOWED = "allowed: a model in MJCF or URDF"


def read_xml(path: Path) -> ET.Element:
    """The root element of a file. Nothing but the file itself is read, and nothing in it is expanded.

    **Raises:** `InputError`, without the file's name: it cannot be read, is no XML, declares a document type (the only
    place for entities), is nested too deep, or has far more elements than text.
    """
    try:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            data = file.read(min(size, _LARGEST))
    except OSError as error:
        raise InputError(f"cannot be read ({error.strerror}); {_ALLOWED}") from None
    except ValueError:
        raise InputError(f"is no name of a file; {_ALLOWED}") from None
    if size > _LARGEST:
        raise InputError(f"has {size} bytes; allowed: a model of at most {_LARGEST} bytes")
    parser = ET.XMLParser(target=_Guarded(len(data)))
    try:
        parser.feed(data)
        return parser.close()
    except InputError:
        raise
    except (ET.ParseError, ValueError, LookupError) as error:  # also encodings that nobody knows
        raise InputError(f"is not XML: {error}; {_ALLOWED}") from None


class _Guarded(ET.TreeBuilder):
    """Builds the tree, unless it grows out of proportion."""

    def __init__(self, size: int):
        super().__init__()
        self._left, self._depth = max(_TIMES * size, _AT_LEAST), 0

    def doctype(self, name: str, pubid: str | None, system: str | None) -> None:
        """Comes before any entity is declared."""
        raise InputError("declares a document type (DOCTYPE); allowed: a model without one")

    def start(self, tag: Any, attrs: Any) -> ET.Element:
        """An element begins."""
        self._depth += 1
        self._left -= _ELEMENT + (_TABLE if attrs else 0) + _ATTRIBUTE * len(attrs)
        if self._depth > _DEEPEST:
            raise InputError(f"is nested more than {_DEEPEST} deep; allowed: less")
        if self._left < 0:
            raise InputError("has too many elements for its size; allowed: a model written out as usual")
        return super().start(tag, attrs)

    def end(self, tag: str) -> ET.Element:
        """An element ends."""
        self._depth -= 1
        return super().end(tag)


def numbers(text: str, count: int | None, name: str) -> np.ndarray:
    """The `count` numbers of an attribute, or any number of them.

    **Raises:** `InputError` that names the attribute by its `name`.
    """
    try:  # one by one: a list of the words would take thirty times the text
        found = np.fromiter((float(word[0]) for word in re.finditer(r"\S+", text)), float)
    except ValueError:
        found = None
    if found is None or count not in (None, len(found)) or not np.isfinite(found).all():
        many = "finite numbers" if count is None else f"{count} finite number{'s' if count > 1 else ''}"
        raise InputError(f"{name} is {text[:60]!r}; allowed: {many}")
    return found


def number(text: str, name: str) -> float:
    """The one number of an attribute; see `numbers`."""
    return float(numbers(text, 1, name)[0])


def words(*values: Any) -> str:
    """Numbers as an attribute has them: by their shortest decimals, a float32 by its own."""
    return " ".join(str(x) for value in values for x in np.ravel(np.asarray(value)))


def document(root: ET.Element) -> str:
    """The text of a file."""
    ET.indent(root)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + ET.tostring(root, "unicode") + "\n"


def model_path(path: str | os.PathLike[str], suffix: str) -> Path:
    """The path of a model to write. **Raises:** `InputError` where its ending is another."""
    path = Path(path)
    if path.suffix.lower() != suffix:
        raise InputError(f"{path}: has the ending {path.suffix!r}; allowed: {suffix}")
    return path
