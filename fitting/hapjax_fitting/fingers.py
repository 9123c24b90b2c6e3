"""Which finger a force belongs to, and its sign."""

from dataclasses import replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from hapjax import Finding

from .evidence import Evidence, at
from .held import SURE, carried

_BETTER = 0.25  # of the squares that are not explained: what another reading must come down to
_CLEAR = 0.5  # of the squares that another good reading leaves: what the better of the two must come down to
_STEEP = 2.0  # hardly a mu is larger: beyond it a force does not belong to its surface


def fingers_of(evidence: Evidence) -> tuple[Evidence, list[Finding]]:
    """The evidence with forces of the right sign at the right fingers, and what was wrong with them.

    A force belongs to a finger's place if it pushes out of what that finger touches, grows with its depth, stays within a
    friction cone, and is 0 where nothing is touched. All ways to deal out the forces are compared (Kuhn 1955).
    """
    force = evidence.force
    assert force is not None
    fingers = range(force.shape[1])
    cost = np.array(
        [[[unexplained(evidence, i, s * force[:, j]) for s in (1, -1)] for j in fingers] for i in fingers]
    )
    fingers = np.arange(len(fingers))
    as_is = float(np.trace(cost[..., 0]))
    if as_is <= 10 * force.size * evidence.noise**2:
        return evidence, []
    signs = cost.argmin(-1)
    straight = float(cost.min(-1)[fingers, fingers].sum())
    crossed = linear_sum_assignment(cost[..., 0])[1]  # signs are not turned too: two faults at once are rare
    dealt = float(np.sum(cost[fingers, crossed, 0]))
    wrong = fingers[signs[fingers, fingers] == 1]
    swapped, known = dealt < _BETTER * min(straight, as_is), True
    if not swapped and max(dealt, straight) < _BETTER * as_is:
        swapped, known = _swapped(evidence, dealt, straight, len(wrong) == len(fingers))
    if swapped:
        return _crossed(evidence, crossed, dealt / as_is, known)
    if len(wrong) and straight < _BETTER * as_is:
        return _reversed(evidence, wrong)
    return evidence, []


def _swapped(evidence: Evidence, dealt: float, straight: float, every: bool) -> tuple[bool, bool]:
    """Whether forces are swapped where other signs explain them as well, and whether that is known: fingers that hold
    something press about alike. The better reading, where it is by far; else the one in which they carry what they hold.

    **Arguments:** the squares (N^2) that forces `dealt` out to other fingers leave, and with other signs `straight`, of
    `every` finger.
    """
    if min(dealt, straight) < _CLEAR * max(dealt, straight) or not every:
        return dealt < straight, True
    assert evidence.force is not None and evidence.recording.hip is not None
    hip = at(evidence.times, evidence.recording.hip_t, evidence.recording.hip)
    held = (evidence.touching & ~evidence.places.fixed).sum(axis=1) > 1
    mass, error = carried(evidence.scene, evidence.times, hip, evidence.force, held)
    known = abs(mass) > SURE * error
    return mass > 0 if known else dealt < straight, known


def unexplained(evidence: Evidence, finger: int, force: np.ndarray) -> float:
    """The squares (N^2) of a force (N, 3) that a finger's place does not explain, with the stiffness that fits best."""
    depth, touching = evidence.places.depth[:, finger], evidence.touching[:, finger]
    normal = np.einsum("nij,nj->ni", evidence.places.turn[:, finger], evidence.places.normal[:, finger])
    along = np.sum(force * normal, axis=-1)
    square = np.sum(force**2, axis=-1)
    across = np.sqrt(np.maximum(square - along**2, 0))
    inside = np.where(touching, depth, 0)
    stiffness = max(float(np.sum(along * inside) / max(np.sum(inside**2), 1e-300)), 0.0)
    steep = np.maximum(across - _STEEP * np.maximum(along, 0), 0)
    return float(np.sum(np.where(touching, (along - stiffness * inside) ** 2 + steep**2, square)))


def _crossed(
    evidence: Evidence, crossed: np.ndarray, left: float, known: bool
) -> tuple[Evidence, list[Finding]]:
    assert evidence.force is not None
    other = "" if known else ", or all forces reversed"
    pairs = ", ".join(f"force {j} to finger {i}" for i, j in enumerate(crossed) if i != j)
    sentence = (
        f"fingers look swapped between hip and force{other}: with {pairs}, only {left:.1%} of what the fingers' places do "
        "not explain is left"
    )
    better = replace(evidence, force=evidence.force[:, crossed])
    return better, [
        Finding("force", "swapped fingers", sentence, count=int(np.sum(crossed != np.arange(len(crossed)))))
    ]


def _reversed(evidence: Evidence, wrong: np.ndarray) -> tuple[Evidence, list[Finding]]:
    assert evidence.force is not None
    sign = np.ones(evidence.force.shape[1])
    sign[wrong] = -1
    normal = np.einsum("nfij,nfj->nfi", evidence.places.turn, evidence.places.normal)
    inward, both = np.sum(evidence.force * normal, axis=-1) < 0, evidence.touching & evidence.pressed
    found = []
    for finger in wrong:
        felt = both[:, finger]
        sentence = (
            f"force of finger {finger} points into the surface in {np.mean(inward[felt, finger]):.0%} of {felt.sum()} "
            "samples in contact: its sign looks reversed, as of the force on the object"
        )
        found.append(Finding("force", "force sign", sentence, count=int(felt.sum())))
    return replace(evidence, force=sign[:, None] * evidence.force), found
