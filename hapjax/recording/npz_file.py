"""Recordings as NPZ: one array a channel, `hip`, and one for its times, `hip_t`."""

import math
import zipfile
from collections import Counter
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..files import replacing
from .channels import ARRAYS
from .content import Content, check_unpacked


def read(path: Path) -> Content:
    """What an NPZ file holds.

    **Raises:** `hapjax.InputError` for what is no NPZ file, a damaged or pickled array, an unknown name, or a
    file that would unpack to far more than its size; `OSError` if it cannot be opened.
    """
    size = path.stat().st_size
    if size == 0:
        raise InputError(f"{path}: expected an NPZ file, found an empty one")
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
            _check_members(path, size, members)
            arrays, room = {}, 0
            for member in members:
                arrays[_name(member)], taken = _read_array(path, archive, member, room)
                room += taken
    except InputError:
        raise  # it is a ValueError, too
    # zipfile has three ways to say that a directory is damaged: as such, for a version in it that it does not know, and for
    # a name in it that is no text (UnicodeDecodeError).
    except (zipfile.BadZipFile, NotImplementedError, ValueError):
        problem = "expected a whole NPZ file, found another format or one that was cut short"
        raise InputError(f"{path}: {problem}") from None
    return Content(arrays)


def write(arrays: dict[str, np.ndarray], path: Path) -> None:
    """Write arrays as an NPZ file, whole or not at all."""
    with replacing(path, "wb") as file:
        np.savez(file, **arrays)  # pyright: ignore[reportArgumentType]


def _name(member: zipfile.ZipInfo) -> str:
    return member.filename.removesuffix(".npy")


def _check_members(path: Path, size: int, members: list[zipfile.ZipInfo]) -> None:
    names = [_name(member) for member in members]
    if unknown := [name for name in names if name not in ARRAYS]:
        raise InputError(f"{path}: unknown array {unknown[0]!r}, expected only {', '.join(ARRAYS)}")
    for name, times in Counter(names).most_common(1):
        if times > 1:
            raise InputError(f"{path}: expected each array once, found {name!r} {times} times")
    check_unpacked(path, size, sum(member.file_size for member in members))


def _read_array(
    path: Path, archive: zipfile.ZipFile, member: zipfile.ZipInfo, room: int
) -> tuple[np.ndarray, int]:
    """An array, and the bytes that its numbers take; `room` is what those before it take."""
    try:
        with archive.open(member) as file:
            form = np.lib.format
            read = (
                form.read_array_header_1_0 if form.read_magic(file) == (1, 0) else form.read_array_header_2_0
            )
            shape, _, dtype = read(file)
        if not dtype.hasobject and math.prod(shape) * dtype.itemsize > member.file_size:
            raise ValueError("fewer numbers than it says")
        taken = 8 * math.prod(shape)
        check_unpacked(path, path.stat().st_size, room + taken)
        with archive.open(member) as file:
            return np.lib.format.read_array(file, allow_pickle=False), taken
    except InputError:
        raise
    except Exception as error:  # numpy, zipfile and zlib raise a dozen kinds for a damaged array
        found = "Python objects (pickled)" if "allow_pickle" in str(error) else "a damaged one"
        problem = f"expected an array of real numbers, found {found}"
        raise InputError(f"{path}, {_name(member)}: {problem}") from error
