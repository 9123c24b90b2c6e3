"""A process that does not outlive the one that started it."""

import ctypes
import os
import signal
import sys

_PDEATHSIG = 1  # of prctl, of Linux


def end_with(parent: int) -> None:
    """From now on this process gets SIGTERM when the one that started it, whose number is `parent`, is no more.

    Linux does this, other systems do not. To be called by a process whose parent started it from its main thread: the
    kernel goes by that thread's end.

    **Raises:** `SystemExit` where the parent has ended before: what is imported until here takes seconds.
    """
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PDEATHSIG, ctypes.c_ulong(signal.SIGTERM))
    if os.getppid() != parent:
        raise SystemExit(128 + signal.SIGTERM)
