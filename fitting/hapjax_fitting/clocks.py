"""Whether the clocks of a recording's channels agree."""

from dataclasses import replace

import numpy as np

from hapjax import Finding

from .evidence import Evidence

_FAR = 0.25  # s, the largest shift that is looked for
_COARSE, _FINE = 51, 21  # shifts that are tried
_SAMPLES = 400  # moments that are looked at
_BETTER = 0.4  # of the squares that are not explained: what a shift must bring them down to
_NOISE = 2.0  # of the squares that noise leaves: beyond it there is something to explain
_LEAST = 2e-3  # s
_TICK = 1e-3  # s, over which rates are taken


def clock_of(evidence: Evidence) -> tuple[Evidence, list[Finding]]:
    """The evidence with clocks that agree, and by how much one was shifted.

    The forces are compared with those that the fingers' depths give, at all shifts of the channel's clock; the force of a
    surface is a combination of its depth and of depth times its rate (Hunt and Crossley 1975), with the best coefficients.
    """
    force = evidence.force
    assert force is not None
    few = slice(None, None, -(-len(force) // _SAMPLES))
    thin = replace(evidence, times=evidence.times[few], force=force[few])
    now = float(_costs(thin, np.zeros(1), (1.0, 1.0))[0])
    if now <= _NOISE * evidence.blur**2 * force[few].size:
        return evidence, []
    length = float(evidence.recording.hip_t[-1] - evidence.recording.hip_t[0])  # pyright: ignore[reportOptionalSubscript]
    far = min(_FAR, length / 4)
    channels = {"force": (1.0, 1.0)}  # how its shift moves hip and pose against it
    if not evidence.places.fixed.all():
        channels |= {"hip": (-1.0, 0.0), "pose": (0.0, -1.0)}
    found = {name: _best(thin, moved, far) for name, moved in channels.items()}
    name = min(found, key=lambda name: found[name][1])
    lag, cost = found[name]
    if cost > _BETTER * now or abs(lag) < max(_LEAST, 2 * length / len(evidence.recording.hip_t)):  # pyright: ignore[reportArgumentType]
        return evidence, []
    sentence = (
        f"{name} is {1e3 * abs(lag):.1f} ms {'late' if lag > 0 else 'early'}: with that undone, only {cost / now:.1%} "
        "of what the fingers' depths do not explain of the force is left"
    )
    finding = Finding(name, "shifted clock", sentence)
    moved = channels[name]
    places = evidence.shifted(np.array([moved[0] * lag]), np.array([moved[1] * lag]))
    return replace(evidence, places=places), [finding]


def _best(evidence: Evidence, moved: tuple[float, float], far: float) -> tuple[float, float]:
    """The shift (s) that explains the forces best, the least of those that are about as good, and what it leaves."""
    lags = np.linspace(-far, far, _COARSE)
    costs = _costs(evidence, lags, moved)
    good = lags[costs <= 1.1 * costs.min()]
    first = good[np.argmin(np.abs(good))]
    step = lags[1] - lags[0]
    for _ in range(2):
        lags = first + np.linspace(-step, step, _FINE)
        costs = _costs(evidence, lags, moved)
        first, step = lags[np.argmin(costs)], lags[1] - lags[0]
    return float(first), float(costs.min())


def _costs(evidence: Evidence, lags: np.ndarray, moved: tuple[float, float]) -> np.ndarray:
    """The squares (N^2) of the normal forces that are not explained at each shift (L,) s."""
    places = evidence.shifted(moved[0] * lags, moved[1] * lags)
    soon = evidence.shifted(moved[0] * lags - _TICK, moved[1] * lags - _TICK)
    assert evidence.force is not None
    shape = (len(lags), *evidence.force.shape)
    touching = (places.depth > 0).reshape(shape[:3])
    depth = np.where(touching, places.depth.reshape(shape[:3]), 0)
    rate = (soon.depth - places.depth).reshape(shape[:3]) / _TICK
    normal = np.einsum("nfij,nfj->nfi", places.turn, places.normal).reshape(shape)
    along = np.sum(evidence.force * normal, axis=-1)
    # Out of contact all of a force is unexplained.
    wanted = np.where(touching, along, np.linalg.norm(evidence.force, axis=-1)).reshape(len(lags), -1)
    basis = np.stack([depth, depth * rate], axis=-1).reshape(len(lags), -1, 2)
    square = np.einsum("lni,lnj->lij", basis, basis)
    factors = np.einsum(
        "lij,ln,lnj->li", np.linalg.pinv(square, hermitian=True), wanted, basis, optimize=True
    )
    return np.sum((wanted - np.einsum("lni,li->ln", basis, factors)) ** 2, axis=-1)
