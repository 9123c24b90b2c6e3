"""The shared memory of a run, by iceoryx2: which services it has, and how a process takes part in them."""

import ctypes
import os
import re
import struct
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from hapjax import InputError
from hapjax.extras import need

READERS = 6  # at a time: a recorder, a viewer, a fit, and others that come while these are still being let go
SENDERS = 6  # of live numbers, at a time
LATE = 1.25  # s, by how much a reader may be late before samples are lost to it
EVENTS = 256  # that are kept for a reader
TEXT = 480  # bytes of an event's sentence
EVENT = np.dtype(
    [("tick", "<i8"), ("time_ns", "<i8"), ("finger", "<i8"), ("kind", "S16"), ("text", f"S{TEXT}")]
)
FINGERS = 5  # that a mouse can move at a time
HANDS = np.dtype([("goals", "<f8", (FINGERS, 3))])  # m, NaN of those that it does not
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,99}")


def iceoryx() -> ModuleType:
    """The library, told to be quiet. **Raises:** `hapjax.InputError` where it is not installed."""
    iox = need("iceoryx2", "devices")
    iox.set_log_level(iox.LogLevel.Error)
    return iox


def join(name: str) -> Any:
    """A node of this process. What processes that were killed left behind is cleaned up on the way.

    **Raises:** `hapjax.InputError` where there is no shared memory to be had.
    """
    iox = iceoryx()
    with said("shared memory"):
        builder = iox.NodeBuilder.new().name(iox.NodeName.new(name)).config(config())
        # Ctrl-C stays Python's.
        builder = builder.signal_handling_mode(iox.SignalHandlingMode.Disabled)
        return builder.create(iox.ServiceType.Ipc)


@cache
def config() -> Any:
    """Where it all lies: each user has a place of their own, since nobody else may write there."""
    iox = iceoryx()
    made = iox.config.default()
    user = os.getuid() if hasattr(os, "getuid") else 0
    made.global_cfg.root_path = iox.Path.new(str(Path(tempfile.gettempdir()) / f"hapjax-{user}"))
    made.global_cfg.prefix = iox.FileName.new(f"hapjax{user}_")
    return made


def check_name(run: str) -> None:
    """Refuse what is no name of a run. **Raises:** `hapjax.InputError`."""
    if not _NAME.fullmatch(run):
        raise InputError(f"run is {run!r}; allowed: up to 100 letters, digits, dots, dashes and underscores")


def check_free(run: str) -> None:
    """Refuse a name that is taken. **Raises:** `hapjax.InputError`."""
    iox = iceoryx()
    node = join("hapjax")
    kinds = iox.MessagingPattern.PublishSubscribe, iox.ServiceType.Ipc
    with said("shared memory"):
        names = [iox.ServiceName.new(f"{run}/{part}") for part in ("tick", "event", "about")]
        there = any(iox.Service.does_exist(name, config(), *kinds) for name in names)
    del node
    if there:
        raise _taken(run)


@contextmanager
def beginning(run: str) -> Iterator[None]:
    """Say what is refused of the services that make a run. **Raises:** `hapjax.InputError`."""
    with said(f"the run {run} on the bus"):
        try:
            yield
        except iceoryx().PublishSubscribeCreateError as error:
            raise _taken(run) if "AlreadyExists" in str(error) else error from None


def _taken(run: str) -> InputError:
    return InputError(
        f"the name {run} is taken, by another run or by who still reads one that has ended; allowed: a name that no run has"
    )


def ticks(node: Any, run: str, sample: np.dtype, rate: float) -> Any:
    """The service of a run's ticks, to be opened or created: the newest push out the oldest, and nobody waits."""
    return _keeping(node, f"{run}/tick", payload("Tick", sample), depth(rate))


def events(node: Any, run: str) -> Any:
    """The service of a run's events, to be opened or created."""
    return _keeping(node, f"{run}/event", payload("Event", EVENT), EVENTS)


def about(node: Any, run: str) -> Any:
    """The service that says what a run is, to be opened or created."""
    iox = iceoryx()
    return _keeping(node, f"{run}/about", iox.Slice[ctypes.c_uint8], 1)


def numbers(node: Any, run: str, sample: np.dtype) -> Any:
    """The service by which a run is given live numbers: many may send, the servo takes, whichever of them comes first."""
    builder = node.service_builder(iceoryx().ServiceName.new(f"{run}/numbers"))
    builder = builder.publish_subscribe(payload("Numbers", sample)).enable_safe_overflow(True)
    builder = builder.history_size(0).subscriber_max_buffer_size(SENDERS).max_subscribers(1)
    return builder.max_publishers(SENDERS).max_nodes(4 * SENDERS).open_or_create()


def hands(node: Any, run: str) -> Any:
    """The service by which a viewer says where the fingers that a mouse moves are to be."""
    builder = node.service_builder(iceoryx().ServiceName.new(f"{run}/hands"))
    builder = builder.publish_subscribe(payload("Hands", HANDS)).enable_safe_overflow(True)
    builder = builder.history_size(0).subscriber_max_buffer_size(2).max_subscribers(FINGERS)
    return builder.max_publishers(2).max_nodes(4 * FINGERS).open_or_create()


def send(port: Any, name: str, record: np.ndarray) -> None:
    """Publish one record."""
    port.send_copy(payload(name, record.dtype).from_buffer_copy(record.tobytes()))


def values(sample: Any, dtype: np.dtype) -> list[float]:
    """The numbers of a sample that was received. In the middle of a loop: nothing is quicker than struct."""
    return list(
        struct.unpack(f"<{dtype.itemsize // 8}d", ctypes.string_at(sample.payload_ptr, dtype.itemsize))
    )


def depth(rate: float) -> int:
    """How many ticks are kept for each reader."""
    return max(EVENTS, int(np.ceil(LATE * rate)))


@cache  # to make a type takes longer than to send one of it
def payload(name: str, sample: np.dtype) -> type[ctypes.Structure]:
    """A sample as the library wants it: so many times 8 bytes."""
    words, rest = divmod(sample.itemsize, 8)
    assert not rest
    return type(f"Hapjax{name}", (ctypes.Structure,), {"_fields_": [("words", ctypes.c_uint64 * words)]})


def runs() -> list[str]:
    """The names of the runs that are on the bus, of this user and on this machine, sorted."""
    iox = iceoryx()
    node = join("hapjax")
    with said("shared memory"):
        found = [service.name().to_string() for service in iox.Service.list(config(), iox.ServiceType.Ipc)]
    del node
    return sorted(name.removesuffix("/about") for name in found if name.endswith("/about"))


@contextmanager
def said(what: str) -> Iterator[None]:
    """Say what the library refuses in a sentence. **Raises:** `hapjax.InputError`."""
    try:
        yield
    except (InputError, KeyboardInterrupt):
        raise
    except Exception as error:  # the library has an exception for each call, and no family of them
        reason = str(error) or type(error).__name__
        raise InputError(f"{what} is not to be had ({reason}); hapjax doctor says what is wrong") from None


def _keeping(node: Any, name: str, kind: Any, kept: int) -> Any:
    builder = node.service_builder(iceoryx().ServiceName.new(name)).publish_subscribe(kind)
    builder = builder.enable_safe_overflow(True).history_size(kept).subscriber_max_buffer_size(kept)
    # A process that was killed counts until it is cleaned up.
    return builder.max_subscribers(READERS).max_publishers(1).max_nodes(4 * READERS)
