"""The servo's end of the bus."""

import ctypes
import struct
import time
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Shaped

from hapjax import InputError

from ..event import Event
from . import services
from .about import About

_SCALARS = struct.Struct("<qqddqqqqqqqq")  # those at the beginning of a sample
COUNTED = ("missed", "not_finite", "limited", "lost", "slewed", "ramped", "overrun")  # in each sample
_AGAIN = 0.05  # s between two looks for readers that are to be told what was said before they came


@dataclass(frozen=True)
class Broadcast:
    """How a run goes on the bus: under the name `run`, when as many `readers` as this are there, or after `patience` s.

    A name: up to 100 letters, digits, dots, dashes and underscores, that no other run has at the time.
    """

    run: str
    readers: int = 0
    patience: float = 20.0

    def __post_init__(self):
        services.check_name(self.run)
        if not 0 <= self.readers <= services.READERS:
            raise InputError(f"readers is {self.readers}; allowed: 0 to {services.READERS}")
        if not 0 <= self.patience < np.inf:
            raise InputError(f"patience is {self.patience} s; allowed: 0 or above")


class TickPublisher:
    """Puts each tick on the bus, and never waits: of a reader that is late the oldest samples are lost to that reader.

    **Arguments:** `about` the run.

    **Attributes:** `run`, its name; `unsent`, how many ticks the bus did not take.

    **Raises:** `InputError` where there is no shared memory to be had, or another run has the same name.
    """

    def __init__(self, about: About):
        self.run, self.unsent = about.run, 0
        self._node = services.join(about.run)
        with services.beginning(about.run):
            ticks = services.ticks(self._node, about.run, about.tick, about.rate).create()
            events = services.events(self._node, about.run).create()
            told = services.about(self._node, about.run).create()
            self._ticks = ticks.publisher_builder().max_loaned_samples(1).create()
            self._events = events.publisher_builder().max_loaned_samples(1).create()
            said = about.to_json()
            self._about = (
                told.publisher_builder().max_loaned_samples(1).initial_max_slice_len(len(said)).create()
            )
            sample = self._about.loan_slice_uninit(len(said))
            ctypes.memmove(sample.payload_ptr, said, len(said))
            sample.assume_init().send()
        self._services = [ticks, events, told]
        self._every = max(1, round(_AGAIN * about.rate))
        self._bytes = bytearray(about.tick.itemsize)
        self._payload = services.payload("Tick", about.tick).from_buffer(self._bytes)
        record = np.frombuffer(self._bytes, about.tick)[0]
        self._hip, self._gimbal, self._force = record["hip"], record["gimbal"], record["force"]
        self._memory = record["memory"][: about.memory]
        self._now = (-1, about.clock_ns)

    def publish(
        self,
        tick: int,
        time_ns: int,
        lateness_us: float,
        compute_us: float,
        counts: tuple[int, ...],
        down: int,
        hip: Shaped[np.ndarray, "F 3"],
        gimbal: Shaped[np.ndarray, "G"],
        force: Float[np.ndarray, "F 3"],
        memory: Any,
    ) -> None:
        """Say what a tick was.

        **Arguments:** `time_ns` when it began; `counts` so far, as `COUNTED` names them; `down`, a bit for each finger
        whose device has a fault; `hip` (m) and `gimbal`
        (rad) as the step got them, `force` (N) as the devices put it out, the packed step's `memory` after it.
        """
        self._now = (tick, time_ns)
        _SCALARS.pack_into(self._bytes, 0, tick, time_ns, lateness_us, compute_us, *counts, down)
        self._hip[...] = hip
        self._gimbal[...] = gimbal
        self._force[...] = force
        self._memory[...] = memory
        try:
            self._ticks.send_copy(self._payload)
            if tick % self._every == 0:
                self._tell_newcomers()
        except Exception:  # whatever the bus has, the fingers come first
            self.unsent += 1

    def event(self, kind: str, sentence: str, finger: int = -1) -> None:
        """Say that something happened at the last tick; `finger` -1: to none of them."""
        self.tell(Event(*self._now, finger, kind, sentence))

    def tell(self, event: Event) -> None:
        """Say what happened."""
        text = event.sentence.encode()[: services.TEXT]
        row = (event.tick, event.time_ns, event.finger, event.kind.encode(), text)
        data = np.array([row], services.EVENT).tobytes()
        try:
            self._events.send_copy(services.payload("Event", services.EVENT).from_buffer_copy(data))
        except Exception:
            self.unsent += 1

    def wait_for(self, readers: int, patience: float) -> int:
        """Wait until `readers` are there, `patience` s at most; how many are."""
        until = time.monotonic() + patience
        while (there := self.readers()) < readers and time.monotonic() < until:
            self._tell_newcomers()
            time.sleep(0.01)
        self._tell_newcomers()
        return there

    def readers(self) -> int:
        """How many read the ticks; those that were killed count until they are cleaned up."""
        return self._services[0].dynamic_config.number_of_subscribers

    def close(self) -> None:
        """Leave the bus. Readers still get what was published before."""
        for port in (self._ticks, self._events, self._about):
            port.delete()
        self._services = []
        self._node = None

    def __enter__(self) -> "TickPublisher":
        return self

    def __exit__(self, kind, error, trace) -> None:
        why = "" if error is None else f": {error or kind.__name__}"
        self.event("end", f"the loop ended after {self._now[0] + 1} ticks{why}")
        self.close()

    def _tell_newcomers(self) -> None:
        # A reader gets what was sent before it came when the sender next looks.
        for port in (self._ticks, self._about, self._events):
            port.update_connections()
