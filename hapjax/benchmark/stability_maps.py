"""The maps: which parameter runs over which values, and the verdicts of their cells for integrators and precisions."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from ..errors import InputError
from ..integrate import METHODS
from .stability_cells import BASE, SECONDS, SETTLED, Cells, Numbers, Start, dropped_cube, dropped_stack

DTS = (1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2)  # s
QUICK_DTS = (1e-3, 5e-3, 2e-2)
DTYPES = ("float64", "float32")


@dataclass(frozen=True)
class Map:
    """A parameter against the time step: `values` of the `parameter`, in `unit`; `log`, whether they are spread so."""

    parameter: str
    label: str
    unit: str
    values: tuple[float, ...]
    log: bool = True
    build: Callable[[str, Numbers], Start] = dropped_cube

    def thinned(self) -> "Map":
        """The same with every fourth value: the ends, the middle and the quarters."""
        return Map(self.parameter, self.label, self.unit, self.values[::4], self.log, self.build)


def _decades(low: float, high: float) -> tuple[float, ...]:
    return tuple(10.0 ** np.linspace(low, high, 13))


MAPS = {
    "stiffness": Map("stiffness", "stiffness", "N/m", _decades(2, 8)),
    "mass": Map("mass", "mass", "kg", _decades(-3, 1)),
    "mass_ratio": Map(
        "mass_ratio", "mass of the upper cube over that of the lower", "", _decades(0, 4), build=dropped_stack
    ),
    "mu": Map("mu", "mu", "", (0.0, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0), log=False),
    "penetration": Map(
        "gap", "place of the lowest corner at the start", "m", tuple(-np.linspace(0, 0.02, 13)), log=False
    ),
    "spin": Map(
        "spin",
        "spin",
        "rad/s",
        (0.0, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 300.0, 500.0, 700.0, 1000.0),
        log=False,
    ),
    "inertia": Map("inertia_ratio", "two larger moments of inertia over the smallest", "", _decades(0, 4)),
}


class Cell(NamedTuple):
    """A row of the table of cells: where it is, and what became of it."""

    map: str
    integrator: str
    dtype: str
    value: float
    dt: float
    verdict: str
    quiet_after: float
    peak: float


def measure(
    maps: Sequence[str],
    integrators: Sequence[str],
    quick: bool = False,
    advance: Callable[[str, float], Any] = lambda doing, steps: None,
) -> list[Cell]:
    """Every cell of `maps` for `integrators` in float64 and float32; needs 64-bit numbers on.

    **Arguments:** `quick`: every fourth value, three time steps; `advance(doing, steps)` is called after each row of a
    map with what is being done and the share of the work done, in steps.

    **Raises:** `InputError` for a name that is none of a map or an integrator.
    """
    check_names("maps", maps, MAPS)
    check_names("integrators", integrators, METHODS)
    cells = []
    for name in maps:
        one = MAPS[name].thinned() if quick else MAPS[name]
        for method, dtype in product(integrators, DTYPES):
            program = Cells(partial(one.build, method), jnp.dtype(dtype))
            for dt in time_steps(quick):
                advance(f"{name}, {method}, {dtype}, dt = {dt * 1e3:g} ms", 0)
                found = program.run([BASE | {one.parameter: value} for value in one.values], dt)
                rows = zip(one.values, found.verdict, found.quiet_after, found.peak, strict=True)
                cells += [
                    Cell(name, method, dtype, float(v), dt, s, float(q), float(p)) for v, s, q, p in rows
                ]
                advance(f"{name}, {method}, {dtype}, dt = {dt * 1e3:g} ms", SECONDS / dt)
    return cells


def time_steps(quick: bool) -> tuple[float, ...]:
    """The time steps of a map, the longest first: what is wrong shows early."""
    return tuple(sorted(QUICK_DTS if quick else DTS, reverse=True))


def work(maps: Sequence[str], integrators: Sequence[str], quick: bool) -> float:
    """The sum of the steps that `measure` tells `advance` of."""
    return len(maps) * len(integrators) * len(DTYPES) * sum(SECONDS / dt for dt in time_steps(quick))


def unsettled(
    method: str = "implicit",
    dtype: str = "float64",
    stiffness: Sequence[float] = MAPS["stiffness"].values,
    dts: Sequence[float] = DTS,
    masses: Sequence[float] = (0.001, 0.05, 10.0),
    mus: Sequence[float] = (0.0, 0.5, 2.0, 10.0),
) -> list[dict[str, Any]]:
    """The cells of stiffness (N/m) by dt (s) by mass (kg) by mu in which a dropped cube does not settle within 2 s.

    Each has its numbers, its `verdict`, `quiet_after` and `peak`; none is what an integrator for stiff contacts is to
    reach. One program serves all: the cells of one time step run side by side.
    """
    found = []
    grid = [{"stiffness": k, "mass": m, "mu": mu} for k, m, mu in product(map(float, stiffness), masses, mus)]
    with jax.enable_x64(True):
        program = Cells(partial(dropped_cube, method), jnp.dtype(dtype))
        for dt in sorted(dts, reverse=True):
            outcome = program.run([BASE | cell for cell in grid], dt)
            rows = zip(grid, outcome.verdict, outcome.quiet_after, outcome.peak, strict=True)
            found += [
                cell | {"dt": dt, "verdict": s, "quiet_after": float(q), "peak": float(p)}
                for cell, s, q, p in rows
                if s != SETTLED
            ]
    return found


def check_names(field: str, names: Sequence[str], known: Any) -> None:
    """Refuse names that are not known. **Raises:** `InputError`."""
    if not names:
        raise InputError(f"{field} is empty; allowed: {', '.join(known)}")
    for name in names:
        if name not in known:
            raise InputError(f"{field} has {name!r}; allowed: {', '.join(known)}")
