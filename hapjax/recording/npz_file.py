"""Recordings as NPZ: the arrays `hip`, `hip_t`, `force`, `force_t`, `gimbal`, `gimbal_t`, `pose`, `pose_t`."""

import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..files import replacing
from .channels import ARRAYS

# A file may unpack to 20 times its size and 64 MiB more: real recordings shrink to half at best.
UNPACKED_RATIO, UNPACKED_MARGIN = 20, 64 * 2**20


def read(path: Path) -> tuple[dict[str, np.ndarray], Callable[[str, int], str]]:
    """The arrays of an NPZ file by name, and how a row of them is called.

    **Raises:** `hapjax.InputError` for what is no NPZ file, a damaged or pickled array, an unknown name, or a file that
    would unpack to far more than its size; `OSError` if it cannot be opened.
    """
    names = _member_names(path)
    if repeated := {name for name in names if names.count(name) > 1}:
        raise InputError(
            f"{path}: expected each array once, found {', '.join(sorted(repeated))} more than once"
        )
    if unknown := [name for name in names if name not in ARRAYS]:
        raise InputError(f"{path}: unknown array {unknown[0]!r}, expected only {', '.join(ARRAYS)}")
    with np.load(path, allow_pickle=False) as archive:
        arrays = {name: _read_array(path, archive, name) for name in names}
    return arrays, lambda channel, row: f"row {row}"


def write(arrays: dict[str, np.ndarray], path: Path) -> None:
    """Write arrays as an NPZ file, whole or not at all."""
    with replacing(path, "wb") as file:
        np.savez(file, **arrays)  # pyright: ignore[reportArgumentType]


def _member_names(path: Path) -> list[str]:
    size = path.stat().st_size
    if size == 0:
        raise InputError(f"{path}: expected an NPZ file, found an empty one")
    try:
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
    except zipfile.BadZipFile:
        raise InputError(
            f"{path}: expected an NPZ file, found none: it was cut short or is of another format"
        ) from None
    unpacked = sum(member.file_size for member in members)
    limit = UNPACKED_RATIO * size + UNPACKED_MARGIN
    if unpacked > limit:
        raise InputError(
            f"{path}: {size} bytes that unpack to {unpacked}, expected at most {limit}; save it without compression"
        )
    return [member.filename.removesuffix(".npy") for member in members]


def _read_array(path: Path, archive: "np.lib.npyio.NpzFile", name: str) -> np.ndarray:
    try:
        return archive[name]
    except Exception as error:  # numpy, zipfile and zlib raise a dozen kinds for a damaged array
        if "allow_pickle" in str(error):
            raise InputError(
                f"{path}, {name}: expected an array of real numbers, found Python objects (pickled)"
            ) from None
        raise InputError(f"{path}, {name}: expected a whole array, found a damaged one ({error})") from error
