"""Files that are written whole or not at all."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, Any

from .errors import InputError


@contextmanager
def replacing(path: str | os.PathLike[str], mode: str = "w") -> Iterator[IO[Any]]:
    """Open a new file that takes the place of `path` once the block has ended without an exception.

    Until then `path` is as it was; after an exception it still is, and nothing else is left behind.

    **Arguments:**

    - `path`: the file to write; its folder must exist.
    - `mode`: `"w"` for UTF-8 text, lines ended as they are written; `"wb"` for bytes.

    **Raises:** `hapjax.InputError` if the folder does not exist, or the file cannot be written.
    """
    target = Path(os.path.realpath(path))
    # In the same folder, because only within one file system is the replacement one step.
    temporary = target.with_name(f".{target.name}.{secrets.token_hex(4)}")
    encoding, newline = (None, None) if "b" in mode else ("utf-8", "")
    try:
        with open(temporary, mode, encoding=encoding, newline=newline) as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, target)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            temporary.unlink()
