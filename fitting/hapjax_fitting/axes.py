"""Which way the axes of a force point: friction points from a finger to where it was, whatever a sensor's frame is."""

from dataclasses import replace
from itertools import permutations, product

import numpy as np
from jaxtyping import Float

from hapjax import Finding

from .evidence import Evidence
from .motion import AXES, FEW

_MUS = 0.05 * 1.5 ** np.arange(11)  # up to 2.9: near one of them friction is about right
# Of the squares that are not explained, and of all: what another reading must come down to.
_BETTER, _GOOD = 0.25, 0.05
_AS_GOOD = 1.1
_AGAINST = -0.8  # of the work that it could do: so much friction takes away where it is beyond doubt
# Of a normal along an axis that lies in the surface; what a force's square is at least, over the noise's; the cosine
# between what is reversed and what is expected; and the share of the work that friction along an axis never does.
_FLAT, _HEARD, _OPPOSITE, _WITH = 0.1, 3.0, -0.8, 0.5
# The 48 ways to put three axes in another order and to turn some of them round; those that change least come first.
_READINGS = sorted(
    (np.diag(signs)[list(order)] for order in permutations(range(3)) for signs in product((1, -1), repeat=3)),
    key=lambda reading: np.count_nonzero(np.diag(reading) != 1),
)


def axes_of(evidence: Evidence, so_read: bool) -> tuple[Evidence, list[Finding]]:
    """The evidence with forces along the right axes, and which were reversed or exchanged.

    The force of each finger is compared with the one of a god-object that its path drags along (Melder, Harwin and
    Sharkey, step 3), with the stiffness and the mu that fit best, for all 48 ways to name and to turn three axes.

    **Arguments:** `so_read`, whether other faults were undone in the evidence, on which this then rests.
    """
    assert evidence.force is not None
    force, found = evidence.force.copy(), []
    if _is_friction(evidence):
        return evidence, []
    given = _dragged(evidence)
    for finger in range(force.shape[1]):
        felt = evidence.touching[:, finger]
        measured = force[felt, finger]
        if len(measured) < FEW:
            continue
        left = _unexplained(measured, given[:, felt, finger])
        enough = min(_BETTER * left[0], _GOOD * float(np.sum(measured**2)))
        if left[0] > 10 * measured.size * evidence.blur**2 and left.min() <= enough:
            reading = _READINGS[int(np.argmax(left <= _AS_GOOD * left.min()))]
            rest = f"with that undone, only {left.min() / left[0]:.1%} of what its motion does not explain of it is left"
        else:
            # A force that does not go with its depth may be of another time.
            depth, along = evidence.places.depth[felt, finger], evidence.along[felt, finger]
            off = along - np.sum(along * depth) / np.sum(depth**2) * depth
            if np.mean(off**2) > max(10 * evidence.blur**2, _BETTER * np.var(along)):
                continue
            signs = _signs(measured, given[:, felt, finger], evidence.normal[felt, finger], evidence.blur)
            if (signs > 0).all():
                continue
            reading, rest = np.diag(signs), "along it the force mirrors what the finger's motion gives"
        force[:, finger] = force[:, finger] @ reading.T
        found.append(_named(finger, reading, rest, len(measured), so_read))
    return replace(evidence, force=force), found


def _signs(
    force: Float[np.ndarray, "n 3"],
    given: Float[np.ndarray, "M n 3"],
    normal: Float[np.ndarray, "n 3"],
    noise: float,
) -> Float[np.ndarray, "3"]:
    """-1 for an axis along surfaces in which the force goes against friction all the time, with any mu and any stiffness.

    That of springs that hold as well: a small part of the force may be reversed beside a large one that is not explained.
    """
    signs = np.ones(3)
    for axis in range(3):
        flat = np.abs(normal[:, axis]) < _FLAT
        felt, like = force[flat, axis], given[:, flat, axis]
        if np.count_nonzero(flat) < FEW or np.mean(felt**2) <= _HEARD * noise**2:
            continue
        # Also about its mean: a force that is only off by a constant has no share in that.
        both = (_alike(felt, like), _alike(felt - felt.mean(), like - like.mean(axis=1, keepdims=True)))
        if max(alike[np.argmax(np.abs(alike))] for alike in both) < _OPPOSITE:
            signs[axis] = -1
    return signs


def _alike(force: Float[np.ndarray, " n"], given: Float[np.ndarray, "M n"]) -> Float[np.ndarray, " M"]:
    """The cosines between a force and others."""
    sizes = np.linalg.norm(given, axis=1) * np.linalg.norm(force)
    return given @ force / np.maximum(sizes, 1e-300)


def _is_friction(evidence: Evidence) -> bool:
    """Whether the forces along surfaces do work against all that fingers do, and along no axis for it."""
    normal = evidence.places.normal

    def along(vectors: np.ndarray) -> np.ndarray:
        tangential = vectors - np.sum(vectors * normal, axis=-1, keepdims=True) * normal
        tangential = np.einsum("nfij,nfj->nfi", evidence.places.turn, tangential)
        return np.where(evidence.touching[..., None], tangential, 0)

    force, way = along(evidence.local()), along(_steps(evidence.places.point))
    work, most = np.sum(force * way, axis=0), np.sum(np.abs(force * way), axis=0)
    whole = np.sum(np.linalg.norm(force, axis=-1) * np.linalg.norm(way, axis=-1), axis=0)
    return bool((work.sum(axis=-1) < _AGAINST * whole).all() and (work <= _WITH * most).all())


def _steps(point: np.ndarray) -> np.ndarray:
    """How far fingers (N, F, 3) come at each moment, from halfway before to halfway after."""
    return np.gradient(point, axis=0) if len(point) > 1 else np.zeros_like(point)


def _unexplained(
    force: Float[np.ndarray, "n 3"], given: Float[np.ndarray, "M n 3"]
) -> Float[np.ndarray, " 48"]:
    """The squares (N^2) that are left of a force with each reading, with the mu and the stiffness that fit best."""
    products = np.einsum("mni,nj->mij", given, force)
    along = np.maximum(np.einsum("rij,mij->rm", np.stack(_READINGS), products), 0)
    square = np.maximum(np.sum(given**2, axis=(1, 2)), 1e-300)
    return np.sum(force**2) - np.max(along**2 / square, axis=1)


def _dragged(evidence: Evidence) -> Float[np.ndarray, "M N F 3"]:
    """The force over the stiffness (m), in the world frame, of god-objects that fingers drag along, for each mu."""
    places = evidence.places
    surface = places.point + places.depth[..., None] * places.normal
    limit = _MUS[:, None, None] * np.maximum(places.depth, 0)
    begins = np.ones(places.depth.shape, bool)
    begins[1:] = (places.depth[:-1] <= 0) | (places.which[1:] != places.which[:-1])
    offset, place = np.zeros((len(_MUS), *surface.shape)), np.zeros((len(_MUS), *surface.shape[1:]))
    for n, normal in enumerate(places.normal):
        off = np.where(begins[n, :, None], 0.0, place - surface[n])
        off -= np.sum(off * normal, axis=-1, keepdims=True) * normal
        size = np.linalg.norm(off, axis=-1)
        off *= (np.minimum(size, limit[:, n]) / np.maximum(size, 1e-300))[..., None]
        offset[:, n], place = off, surface[n] + off
    local = offset + places.depth[..., None] * places.normal
    return np.einsum("nfij,mnfj->mnfi", places.turn, local)


def _named(finger: int, reading: np.ndarray, rest: str, count: int, so_read: bool) -> Finding:
    """What a reading is called, and the rest of what is said of it."""
    begin = "so read, " if so_read else ""
    if (reading == np.diag(np.diag(reading))).all():
        wrong = " and ".join(AXES[i] for i in range(3) if reading[i, i] < 0)
        sentence = (
            f"{begin}{wrong} of the force of finger {finger} {'points' if len(wrong) == 1 else 'point'} the way in which "
            f"its friction cannot: the sign looks reversed; {rest}"
        )
        return Finding("force", "force sign", sentence, count=count)
    names = [f"{'-' if row.min() < 0 else ''}{AXES[int(np.abs(row).argmax())]}" for row in reading]
    sentence = (
        f"{begin}the axes of the force of finger {finger} look exchanged: with its {', '.join(names)} read as the world's "
        f"x, y, z: {rest}"
    )
    return Finding("force", "force axes", sentence, count=count)
