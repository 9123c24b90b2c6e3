"""The figures of a session, from its ticks as they come."""

from typing import Any

import numpy as np

_SHARES = {"p50": 0.5, "p99": 0.99, "p99.9": 0.999}


class Spread:
    """How numbers of 0 and above are spread, to 1 %, in a place that does not grow."""

    _EDGES = 0.01 * 1.01 ** np.arange(2400)  # 0.01 to 2e8 us

    def __init__(self):
        self._counts = np.zeros(len(self._EDGES) + 1, np.int64)
        self.largest = 0.0

    def add(self, values: np.ndarray) -> None:
        """Count these too."""
        self._counts += np.bincount(np.searchsorted(self._EDGES, values), minlength=len(self._counts))
        self.largest = max(self.largest, float(values.max(initial=0.0)))

    def to_dict(self) -> dict[str, float]:
        """p50, p99, p99.9 and max."""
        below = np.cumsum(self._counts)
        edges = np.append(self._EDGES, np.inf)
        found = {name: edges[np.searchsorted(below, share * below[-1])] for name, share in _SHARES.items()}
        return {name: min(float(edge), self.largest) for name, edge in found.items()} | {"max": self.largest}


class Figures:
    """What came of a session so far.

    **Arguments:** `fingers`, how many there are.

    **Attributes:** `newest`, the last tick that came, `None` before the first; `lateness_us`, `compute_us`, each a `Spread`.
    """

    def __init__(self, fingers: int):
        self._seen = 0
        self.newest: Any = None
        self.lateness_us, self.compute_us = Spread(), Spread()
        self._largest, self._sum = np.zeros(fingers), np.zeros(fingers)

    def add(self, ticks: np.ndarray) -> None:
        """Count these ticks, as a `TickReader` takes them."""
        if not len(ticks):
            return
        self._seen, self.newest = self._seen + len(ticks), ticks[-1]
        self.lateness_us.add(ticks["lateness_us"])
        self.compute_us.add(ticks["compute_us"])
        size = np.linalg.norm(ticks["force"], axis=2)
        self._largest = np.maximum(self._largest, size.max(axis=0))
        self._sum += size.sum(axis=0)

    @property
    def ticks(self) -> int:
        """How many there were, as far as is known."""
        return 0 if self.newest is None else int(self.newest["tick"]) + 1

    @property
    def unseen(self) -> int:
        """How many of these did not come: who counts was so late that newer ones pushed them out."""
        return self.ticks - self._seen

    def line(self, rate: float) -> str:
        """What the fingers feel now, and how the loop does."""
        assert self.newest is not None
        felt = "  ".join(f"{np.linalg.norm(force):5.2f} N" for force in self.newest["force"])
        late = self.lateness_us.to_dict()["p99"]
        said = f"{(self.newest['tick'] + 1) / rate:7.1f} s  {felt}  late by {late:.0f} us (p99)"
        return f"{said}, missed ticks: {self.newest['missed']}"

    def to_dict(self) -> dict[str, Any]:
        """All of them; force in N."""
        counts = {}
        if self.newest is not None:
            names = self.newest.dtype.names
            counted = names[names.index("compute_us") + 1 : names.index("down")]
            counts = {name: int(self.newest[name]) for name in counted}
        mean = self._sum / max(self._seen, 1)
        return {
            "ticks": self.ticks,
            "unseen": self.unseen,
            **counts,
            "lateness_us": self.lateness_us.to_dict(),
            "compute_us": self.compute_us.to_dict(),
            "force": [{"max": float(a), "mean": float(b)} for a, b in zip(self._largest, mean, strict=True)],
        }
