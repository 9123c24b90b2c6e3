"""The arrays of a recorded NPZ file, or one sentence on why there are none."""

from pathlib import Path

import numpy as np

from hapjax import InputError


def arrays_of(path: Path) -> dict[str, np.ndarray]:
    """All arrays of a file by name. **Raises:** `InputError` where it cannot be read, or is no whole NPZ of numbers."""
    try:
        with open(path, "rb") as file, np.load(file, allow_pickle=False) as archive:
            return {name: archive[name] for name in archive.files}
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from error
    except Exception as error:  # numpy, zipfile and zlib raise a dozen kinds for what is no NPZ file
        raise InputError(
            f"{path}: expected a whole NPZ file of numbers, found another or a damaged one"
        ) from error
