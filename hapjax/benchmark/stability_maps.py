"""The maps: which parameter runs over which values, and the verdicts of their cells for integrators and precisions."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, NamedTuple

import jax
import numpy as np

from ..errors import InputError
from ..integrate import METHODS
from .stability_cells import BASE, SECONDS, SETTLED, Numbers, Start, dropped_cube, dropped_stack, programs

DTS = (1e-4, 2e-4, 5e-4, 1e-3, 2e-3, 5e-3, 1e-2, 2e-2)  # s
QUICK_DTS = (1e-3, 5e-3, 2e-2)
DTYPES = ("float64", "float32")


@dataclass(frozen=True)
class Map:
    """A parameter against the time step: `values` of the `parameter`, in `unit`.

    `build` makes a scene and its state of an integrator's name and numbers; `limit` gives for a value the time step, s,
    up to which explicit integrators are stable, `None` where that has no formula.
    """

    parameter: str
    label: str
    unit: str
    values: tuple[float, ...]
    build: Callable[[str, Numbers], Start] = dropped_cube
    limit: Callable[[float], float] | None = None

    def thinned(self) -> "Map":
        """The same with the ends, the middle and the quarters, as near as there are values."""
        places = np.rint(np.linspace(0, len(self.values) - 1, 5)).astype(int)
        return replace(self, values=tuple(self.values[i] for i in places))


def decades(low: int, high: int, count: int = 13) -> tuple[float, ...]:
    """Numbers spread evenly over decades: `count` from 10^low to 10^high."""
    return tuple((10.0 ** np.linspace(low, high, count)).tolist())


def explicit_limit(**numbers: float) -> float:
    """2 / w, s, of the fastest swing of a cube on its face: rocking, w^2 = 6 k / m times the inertia ratio.

    Four corners of stiffness k at half an edge from the axis, against a moment of m edge^2 / 6 over the ratio.
    """
    all_of = BASE | numbers
    return 2 / np.sqrt(6 * all_of["stiffness"] * all_of["inertia_ratio"] / all_of["mass"])


def _cube_map(parameter: str, label: str, unit: str, values: Sequence[float]) -> Map:
    def limit(value: float) -> float:
        return explicit_limit(**{parameter: value})

    return Map(parameter, label, unit, tuple(values), limit=limit)


MAPS = {
    "stiffness": _cube_map("stiffness", "stiffness", "N/m", decades(2, 8)),
    "mass": _cube_map("mass", "mass", "kg", decades(-3, 1)),
    # Fewer of them: a step of a stack costs fifty times that of a cube on a floor.
    "mass_ratio": Map(
        "mass_ratio", "mass of the upper cube over that of the lower", "", decades(0, 4, 7), dropped_stack
    ),
    "mu": _cube_map("mu", "friction", "", [0.0, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 5.0, 7.0, 10.0]),
    "penetration": _cube_map(
        "gap", "place of the lowest corner at the start", "m", (-np.linspace(0, 0.02, 13)).tolist()
    ),
    "spin": _cube_map(
        "spin",
        "spin",
        "rad/s",
        [0.0, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0, 200.0, 300.0, 500.0, 700.0, 1000.0],
    ),
    "inertia": _cube_map(
        "inertia_ratio", "two larger moments of inertia over the smallest", "", decades(0, 4)
    ),
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


def chosen(names: Sequence[str], quick: bool) -> dict[str, Map]:
    """The built-in maps of these names; `quick`: thinned. **Raises:** `InputError` for a name that is none of a map."""
    check_names("maps", names, MAPS)
    return {name: MAPS[name].thinned() if quick else MAPS[name] for name in names}


def measure(
    maps: Mapping[str, Map],
    integrators: Sequence[str],
    dts: Sequence[float] = DTS,
    advance: Callable[[str, float], Any] = lambda doing, steps: None,
) -> list[Cell]:
    """Every cell of `maps` by `dts` (s) for `integrators` in float64 and float32; needs 64-bit numbers on.

    **Arguments:** `advance(doing, steps)` is called before and after each row of a map, with what is being done and the
    share of the work done, in steps.

    **Raises:** `InputError` for a name that is none of an integrator.
    """
    check_names("integrators", integrators, METHODS)
    cells = []
    for (name, one), method, dtype in product(maps.items(), integrators, DTYPES):
        program = programs(one.build, method, dtype)
        for dt in sorted(dts, reverse=True):  # what is wrong shows early
            doing = f"{name}, {method}, {dtype}, dt = {dt * 1e3:g} ms"
            advance(doing, 0.0)
            found = program.run([BASE | {one.parameter: value} for value in one.values], dt)
            rows = zip(one.values, found.verdict, found.quiet_after, found.peak, strict=True)
            cells += [Cell(name, method, dtype, v, dt, s, float(q), float(p)) for v, s, q, p in rows]
            advance(doing, SECONDS / dt)
    return cells


def work(maps: Mapping[str, Map], integrators: Sequence[str], dts: Sequence[float] = DTS) -> float:
    """The sum of the steps that `measure` tells `advance` of."""
    return len(maps) * len(integrators) * len(DTYPES) * sum(SECONDS / dt for dt in dts)


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
        program = programs(dropped_cube, method, dtype)
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
