"""Pushes of an object that stands on small feet: read from a file, checked, and carried along their motion.

A file (NPZ, SI units) holds `t`, `tip` and `force` of P pushes one after the other, push i in the rows
`offset[i]:offset[i+1]`; `com_before` and `com_after` (P, 3), x, y and angle of the object's centre of mass;
and `support_points` (V, 2) and `support_load` (V,) of its feet.
"""

import math
from pathlib import Path

import jax.numpy as jnp
import numpy as np
from npz_arrays import arrays_of

from hapjax import InputError
from hapjax_fitting import Drags

SPANS = (
    60  # spans of time a push is averaged in: the tool travels 0.3 mm in each, the tip's noise averages out
)
ONSET = 0.5  # contact starts at this share of the push's typical force
LEAST_FORCE = 0.02  # of the object's weight: less, all push long, is a tool that missed the object
LEAST_TRAVEL = 1e-3  # m, ten times what the tip's place is rounded to
SHAPES = {
    "t": ("samples",),
    "tip": ("samples", 2),
    "force": ("samples", 2),
    "com_before": ("pushes", 3),
    "com_after": ("pushes", 3),
    "support_points": ("feet", 2),
    "support_load": ("feet",),
}


def read(path: Path) -> dict[str, np.ndarray]:
    """The arrays of a file, checked."""
    arrays = arrays_of(path)
    for name in ("offset", *SHAPES):
        if name not in arrays:
            raise InputError(f"{path}: array {name!r} is missing")
        kinds = "iu" if name == "offset" else "iuf"
        if arrays[name].dtype.kind not in kinds or not np.all(np.isfinite(arrays[name])):
            kind = "whole" if name == "offset" else "finite real"
            raise InputError(f"{path}, {name}: expected {kind} numbers only, found others")
    _check_shapes(path, arrays)
    _check_values(path, arrays)
    return arrays


def _check_shapes(path: Path, arrays: dict[str, np.ndarray]) -> None:
    if arrays["offset"].ndim != 1 or len(arrays["offset"]) < 2:
        raise InputError(
            f"{path}, offset: shape {arrays['offset'].shape}; expected (pushes + 1,), at least (2,)"
        )
    sizes = {"pushes": len(arrays["offset"]) - 1}
    for name, shape in SHAPES.items():
        found = arrays[name].shape
        if len(found) == len(shape) and found[0] > 0:
            sizes.setdefault(str(shape[0]), found[0])
        if found != (sizes.get(str(shape[0])), *shape[1:]):
            words = ", ".join(str(sizes.get(str(s), s)) for s in shape) + ("," if len(shape) == 1 else "")
            raise InputError(
                f"{path}, {name}: shape {found}; expected ({words}), the first being the {shape[0]}"
            )


def _check_values(path: Path, arrays: dict[str, np.ndarray]) -> None:
    offset, samples = arrays["offset"], len(arrays["t"])
    if offset[0] != 0 or offset[-1] != samples or np.any(offset[1:] <= offset[:-1]):
        raise InputError(f"{path}, offset: expected numbers that rise from 0 to {samples}, found others")
    starts_push = np.isin(np.arange(1, samples), offset)
    if np.any((np.diff(arrays["t"]) <= 0) & ~starts_push):
        raise InputError(f"{path}, t: expected times that rise within each push, found others")
    if np.any(arrays["support_load"] <= 0):
        raise InputError(f"{path}, support_load: {arrays['support_load'].min():g}; allowed: above 0 N")
    if not np.any(arrays["support_points"]):
        raise InputError(f"{path}, support_points: all at the centre of mass; allowed: one elsewhere")


def in_contact(t, tip, force, weight: float) -> tuple[np.ndarray, np.ndarray] | str:
    """A push's tip and force (SPANS, 2), means over equal spans of its contact; or why there are none."""
    size = np.linalg.norm(force, axis=1)
    if size.max() < LEAST_FORCE * weight:
        return f"no contact, its largest force is {size.max():.2g} N"
    typical = np.median(size[size > 0.5 * size.max()])
    contact = slice(int(np.argmax(size >= ONSET * typical)), None)
    t, tip, force = t[contact], tip[contact], force[contact]
    if len(t) < SPANS:
        return f"contact for {len(t)} samples only, {SPANS} are needed"
    # A straight line undoes the rounding of the tip's place, which is coarser than a step.
    line = np.stack([np.ones_like(t), t - t[0]], axis=1)
    tip = line @ np.linalg.lstsq(line, tip, rcond=None)[0]
    if np.linalg.norm(tip[-1] - tip[0]) < LEAST_TRAVEL:
        return f"the tool travels less than {LEAST_TRAVEL:g} m in contact"
    edges = np.linspace(0, len(t), SPANS + 1).astype(int)
    tip, force = (np.add.reduceat(x, edges[:-1]) / np.diff(edges)[:, None] for x in (tip, force))
    return tip, force


def rotate(angle: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Plane vectors turned by an angle (rad)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * v[..., 0] - s * v[..., 1], s * v[..., 0] + c * v[..., 1]], axis=-1)


def poses(tip: np.ndarray, before: np.ndarray, after: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The centre of mass (P, S, 2) m and the angle (P, S) rad between the poses before and after."""
    progress = np.linalg.norm(tip - tip[:, :1], axis=-1)
    progress = progress / progress[:, -1:]
    turn = (after[:, 2] - before[:, 2] + np.pi) % (2 * np.pi) - np.pi
    angle = before[:, 2, None] + progress * turn[:, None]
    met = rotate(-before[:, 2], tip[:, 0] - before[:, :2])
    left = rotate(-before[:, 2] - turn, tip[:, -1] - after[:, :2])
    point = met[:, None] + progress[..., None] * (left - met)[:, None]
    return tip - rotate(angle, point), angle


def load(path: Path) -> tuple[Drags, list[str]]:
    """The pushes of a file in 60 spans of time each, and which of them were left out, and why."""
    d = read(path)
    weight = float(np.sum(d["support_load"]))
    kept, taken, skipped = [], [], []
    for i, (a, b) in enumerate(zip(d["offset"][:-1], d["offset"][1:], strict=True)):
        t, tip, force = (d[name][a:b].astype(float) for name in ("t", "tip", "force"))
        means = in_contact(t, tip, force, weight)
        if isinstance(means, str):
            skipped.append(f"{path}: push {i} is left out: {means}")
        else:
            kept.append(i)
            taken.append(means)
    if len(kept) < 2:
        raise InputError(f"{path}: {len(kept)} of {i + 1} pushes can be used; an interval needs at least 2")
    tip, force = (np.stack(x) for x in zip(*taken, strict=True))
    centre, angle = poses(tip, d["com_before"][kept], d["com_after"][kept])
    arms = rotate(angle[..., None], d["support_points"])
    gyration = math.sqrt(np.sum(d["support_load"] * np.sum(d["support_points"] ** 2, axis=1)) / weight)
    lever = tip - centre
    moment = lever[..., 0] * force[..., 1] - lever[..., 1] * force[..., 0]
    wrench = np.concatenate([force, moment[..., None] / gyration], axis=-1)
    arms, feet = (np.pad(x, [(0, 0)] * 3 + [(0, 1)]) for x in (arms, centre[:, :, None] + arms))
    values = (feet, arms, d["support_load"], wrench, gyration)
    return Drags(*(jnp.asarray(x, float) for x in values)), skipped
