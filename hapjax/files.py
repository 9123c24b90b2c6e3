"""Files that are written whole or not at all."""

import errno
import json
import math
import os
import secrets
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from .errors import InputError

_LINKS = 40  # that Linux follows from one to the next
_DISK = {errno.ENOSPC, errno.EDQUOT, errno.EIO}  # of the system, whatever was asked for


@contextmanager
def replacing(path: str | os.PathLike[str], mode: str = "w") -> Iterator[IO[Any]]:
    """Open a new file that takes the place of `path` once the block has ended without an exception.

    Until then `path` is as it was; after an exception it still is, and nothing else is left behind.

    **Arguments:**

    - `path`: the file to write; its folder must exist.
    - `mode`: `"w"` for UTF-8 text, lines ended as they are written; `"wb"` for bytes.

    **Raises:** `hapjax.InputError` if the folder does not exist, or the file cannot be written; `OSError` where the disk is
    full or fails.
    """
    target = check_writable(path)
    # In the same folder, because only within one file system is the replacement one step.
    temporary = target.with_name(f".{target.name}.{secrets.token_hex(4)}")
    encoding, newline = (None, None) if "b" in mode else ("utf-8", "")
    try:
        with open(temporary, mode, encoding=encoding, newline=newline) as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        if target.exists():
            shutil.copymode(target, temporary)
        os.replace(temporary, target)
    except OSError as error:
        if error.errno in _DISK:
            raise OSError(error.errno, f"cannot be written: {error.strerror}", os.fspath(path)) from error
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            temporary.unlink()


def write_json(path: str | os.PathLike[str], figures: Any) -> None:
    """Write figures as JSON, `finite`. **Raises:** `hapjax.InputError` as `replacing`."""
    with replacing(path) as out:
        json.dump(finite(figures), out, indent=2, allow_nan=False)
        out.write("\n")


def finite(figures: Any) -> Any:
    """The figures with `None` for NaN and infinity, which JSON has no words for; their tuples become lists."""
    if isinstance(figures, Mapping):
        return {key: finite(value) for key, value in figures.items()}
    if isinstance(figures, list | tuple):
        return [finite(value) for value in figures]
    return None if isinstance(figures, float) and not math.isfinite(figures) else figures


def check_writable(path: str | os.PathLike[str]) -> Path:
    """The file that `path` leads to. Refuses, before any work is done for it, what `replacing` could not write.

    **Raises:** `hapjax.InputError` if the folder does not exist or may not be written, or if `path` is a folder, a
    device or a pipe, which a file must not take the place of, or stands for what is already open.
    """
    try:
        target = Path(os.path.realpath(path))
        there, regular = target.exists(), target.is_file()
        already_open = _stands_for_what_is_open(path)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: cannot be written: {error}") from error
    if already_open:
        raise InputError(
            f"{path}: cannot be written: it stands for what is already open; allowed: a file's own name, "
            "and with --json - for standard output"
        )
    if there and not regular:
        raise InputError(f"{path}: cannot be written: it is no regular file")
    if not target.parent.is_dir():
        raise InputError(f"{path}: cannot be written: the folder {target.parent} does not exist")
    if not os.access(target.parent, os.W_OK):
        raise InputError(f"{path}: cannot be written: the folder {target.parent} is read-only")
    return target


def _stands_for_what_is_open(path: str | os.PathLike[str]) -> bool:
    """Whether `path` is a link of `/proc`, or leads to one, as `/dev/stdout` does.

    The file behind it may have been opened to add to it; to take its place would lose what it holds.
    """
    name = os.fspath(path)
    for _ in range(_LINKS):
        if not os.path.islink(name):
            break
        folder = os.path.realpath(os.path.dirname(name))
        if folder.startswith("/proc/"):
            return True
        name = os.path.join(folder, os.readlink(name))
    return False


def check_apart(
    writes: Iterable[str | os.PathLike[str] | None], reads: Iterable[str | os.PathLike[str] | None]
) -> None:
    """Refuse a file to write that is one of those to read, or another of those to write: one of the two would be lost.

    `None` stands for none. **Raises:** `hapjax.InputError`.
    """
    taken = {place_of(path) for path in reads if path is not None}
    for path in writes:
        if path is None:
            continue
        if place_of(path) in taken:
            raise InputError(
                f"{path}: would take the place of another file of this command; allowed: a new name"
            )
        taken.add(place_of(path))


def place_of(path: str | os.PathLike[str]) -> str:
    """Where a path leads to, whatever its links; itself where it is no name of a file."""
    with suppress(OSError, ValueError):
        return os.path.realpath(path)
    return os.fspath(path)  # no name of a file, as who reads or writes it will say


def check_makeable(folder: str | os.PathLike[str]) -> None:
    """Refuse what is no folder and cannot become one, or takes no files. **Raises:** `hapjax.InputError`.

    It is tried, for no question to the system tells all; nothing is left of that.
    """
    place, made = Path(folder).absolute(), []
    missing = [part for part in (place, *place.parents) if not part.exists()]
    try:
        for part in reversed(missing):
            part.mkdir()
            made.append(part)
        with tempfile.TemporaryFile(dir=place):
            pass
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{folder}: cannot be made a folder with files: {reason}") from error
    finally:
        for part in reversed(made):
            with suppress(OSError):
                part.rmdir()
