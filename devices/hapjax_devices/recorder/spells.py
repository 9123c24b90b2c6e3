"""Spells of what goes wrong: told when they begin and when they are over, not at each of a thousand ticks."""

import numpy as np

from ..bus import Event

_COUNTED = {
    "missed": "deadlines missed",
    "not_finite": "forces not finite, none put out",
    "limited": "forces over a device's limit, cut to it",
    "lost": "ticks at which the scene left the range of sense, no force put out",
}


class Spells:
    """Watches the counters of ticks.

    **Arguments:** `calm`, after how many ticks without another one a spell is over.
    """

    def __init__(self, calm: int):
        self._calm = calm
        self._counts = dict.fromkeys(_COUNTED, 0)
        self._open: dict[str, _Spell] = {}

    def watch(self, ticks: np.ndarray) -> list[Event]:
        """The spells that begin or end in these ticks."""
        found: list[Event] = []
        for kind in _COUNTED:
            counts = ticks[kind]
            steps = np.diff(counts, prepend=self._counts[kind])
            for place in np.flatnonzero(steps > 0):
                row = ticks[place]
                self._rose(kind, int(row["tick"]), int(row["time_ns"]), int(steps[place]), found)
            if len(counts):
                self._counts[kind] = int(counts[-1])
                self._calmed(kind, int(ticks["tick"][-1]), found)
        return found

    def end(self) -> list[Event]:
        """The spells that are not over."""
        return [spell.ended(kind) for kind, spell in self._open.items()]

    def _rose(self, kind: str, tick: int, time_ns: int, by: int, found: list[Event]) -> None:
        self._calmed(kind, tick, found)
        spell = self._open.get(kind)
        if spell is None:
            self._open[kind] = _Spell(tick, time_ns, by)
            found.append(Event(tick, time_ns, -1, kind, f"{_COUNTED[kind]}: begins at tick {tick}"))
        else:
            spell.last, spell.time_ns, spell.count = tick, time_ns, spell.count + by

    def _calmed(self, kind: str, tick: int, found: list[Event]) -> None:
        spell = self._open.get(kind)
        if spell is not None and tick - spell.last > self._calm:
            found.append(spell.ended(kind))
            del self._open[kind]


class _Spell:
    def __init__(self, tick: int, time_ns: int, count: int):
        self.first, self.last, self.time_ns, self.count = tick, tick, time_ns, count

    def ended(self, kind: str) -> Event:
        sentence = f"{_COUNTED[kind]}: {self.count} in the ticks {self.first} to {self.last}"
        return Event(self.last, self.time_ns, -1, kind, sentence)
