"""Memory of large arrays."""

import ctypes
import sys
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np


def empty(shape: tuple[int, ...], dtype: Any) -> np.ndarray:
    """An array that begins where `jnp.asarray`, given its `dtype`, takes it as it is: without a second one beside it."""
    size = int(np.prod(shape)) * np.dtype(dtype).itemsize
    room = np.empty(size + 64, np.uint8)
    begin = -room.ctypes.data % 64
    return room[begin : begin + size].view(dtype).reshape(shape)


def give_back() -> None:
    """Let the system have what is free.

    The C library keeps arrays that were let go, up to 64 MiB and all that lies between others, in case they are needed
    again. glibc gives them back when told to; elsewhere nothing is done.
    """
    trim = _trim()
    if trim is not None:
        trim(0)


@cache
def _trim() -> Callable[[int], int] | None:
    return getattr(ctypes.CDLL(None), "malloc_trim", None) if sys.platform == "linux" else None
