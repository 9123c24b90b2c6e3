"""Several processes of one command: how they meet, and which of them speaks."""

import contextlib
import os
from collections.abc import Callable
from typing import TypeVar

import jax
import numpy as np

from .errors import InputError

T = TypeVar("T")
_LONGEST = 2000  # bytes of a sentence that is passed on


@contextlib.contextmanager
def together(of_job: bool, process: tuple[int, int, str] | None):
    """Inside the block, work with the other processes of the job (SLURM, Open MPI) or, as `process`, number I of N that
    meet at HOST:PORT; alone where neither is given.

    Process 0 speaks for all: what the others print goes nowhere, and where all refuse the same, they say nothing.

    **Raises:** `InputError` where there is no such job, or the numbers do not fit together.
    """
    if not of_job and process is None:
        yield
        return
    _meet(of_job, process)
    try:
        if jax.process_index() == 0:
            yield
        else:
            with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
                yield
    except InputError:
        if jax.process_index() == 0:
            raise
        raise SystemExit(2) from None
    finally:
        jax.distributed.shutdown()


def agreed(load: Callable[[], T]) -> T:
    """What `load` returns. **Raises:** `InputError` in every process where it does in one: none waits for it."""
    found, refusal = None, b""
    try:
        found = load()
    except InputError as error:
        if jax.process_count() == 1:
            raise
        refusal = str(error).encode()[:_LONGEST]
    if jax.process_count() > 1:
        from jax.experimental.multihost_utils import process_allgather

        told = process_allgather(np.frombuffer(refusal.ljust(_LONGEST, b"\0"), np.uint8))
        for index, words in enumerate(told):
            if words.any():
                sentence = words.tobytes().rstrip(b"\0").decode(errors="ignore")
                raise InputError(f"process {index}: {sentence}")
    return found  # pyright: ignore[reportReturnType]


def _meet(of_job: bool, process: tuple[int, int, str] | None) -> None:
    if process is None:
        try:
            jax.distributed.initialize()
        except ValueError:
            raise InputError(
                "distributed is given, but this is no process of a job; allowed: under SLURM's srun or Open MPI's mpirun"
            ) from None
        return
    index, count, address = process
    if of_job:
        raise InputError("distributed is given with process; allowed: one of the two")
    if not 0 <= index < count:
        raise InputError(f"process is {index} of {count}; allowed: 0 to {count - 1}, each once")
    host, _, port = address.rpartition(":")
    if not host or not (port.isdecimal() and 0 < int(port) < 65536):
        raise InputError(f"process has the address {address!r}; allowed: HOST:PORT, the port from 1 to 65535")
    jax.distributed.initialize(address, count, index)
