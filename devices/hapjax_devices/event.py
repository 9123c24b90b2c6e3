"""What happens in a run, in words: each thing once, and of what goes on for long its beginning and its end."""

import time
from collections.abc import Callable
from typing import NamedTuple

CALM = 0.1  # s without another one after which a spell is over

_SPELLS = {
    "missed": "deadlines missed",
    "overrun": "ticks that came far too late, no force put out",
    "lost": "ticks at which the scene left the range of sense, no force put out",
    "not_finite": "forces not finite, none put out",
    "limited": "forces over the device's limit, cut to it",
    "slewed": "forces that rose faster than the device may, held back",
    "ramped": "forces of a finger that is let in again, rising",
}


class Event(NamedTuple):
    """Something that happened at a `tick` (`time_ns` by its clock) to a `finger` (-1: to none), of a `kind`, in words."""

    tick: int
    time_ns: int
    finger: int
    kind: str
    sentence: str

    def said(self, fingers: int) -> str:
        """The sentence as a run with so many fingers says it: with the finger, where there is more than one."""
        return self.sentence if fingers < 2 or self.finger < 0 else f"finger {self.finger}: {self.sentence}"


class Diary:
    """Keeps what happens, and tells it to who listens.

    What may happen at each of a thousand ticks a second is told when it begins and, with how often it did, when it has
    not for 0.1 s.

    **Arguments:** `rate` of the ticks, Hz.

    **Attributes:** `events`, all so far.
    """

    def __init__(self, rate: float):
        self._calm, self._told = max(1, round(CALM * rate)), 0
        self._now = (-1, time.perf_counter_ns())
        self._spells: dict[tuple[str, int], _Spell] = {}
        self.events: list[Event] = []

    def turn(self, tick: int, time_ns: int) -> None:
        """Go on to a tick that begins at `time_ns`."""
        self._now = (tick, time_ns)
        if self._spells:
            self._close(tick - self._calm)

    def say(self, kind: str, sentence: str, finger: int = -1) -> None:
        """Something has happened."""
        self.events.append(Event(*self._now, finger, kind, sentence))

    def count(self, kind: str, finger: int = -1, by: int = 1) -> None:
        """It has happened, again perhaps; `kind` is one of those that have spells."""
        tick, time_ns = self._now
        spell = self._spells.get((kind, finger))
        if spell is None:
            self._spells[kind, finger] = _Spell(tick, time_ns, by)
            self.say(kind, f"{_SPELLS[kind]}: begins at tick {tick}", finger)
        else:
            spell.last, spell.time_ns, spell.count = tick, time_ns, spell.count + by

    def tell(self, listener: Callable[[Event], object]) -> None:
        """Tell what was not told yet."""
        for event in self.events[self._told :]:
            listener(event)
        self._told = len(self.events)

    def end(self) -> None:
        """Nothing goes on any more."""
        self._close(self._now[0])

    def _close(self, tick: int) -> None:
        for (kind, finger), spell in [*self._spells.items()]:
            if spell.last <= tick:
                del self._spells[kind, finger]
                said = f"{_SPELLS[kind]}: {spell.count} in the ticks {spell.first} to {spell.last}"
                self.events.append(Event(spell.last, spell.time_ns, finger, kind, said))


class _Spell:
    def __init__(self, tick: int, time_ns: int, count: int):
        self.first, self.last, self.time_ns, self.count = tick, tick, time_ns, count
