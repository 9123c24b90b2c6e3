"""The avatar: a hand whose fingertips are where the fingers are on what they touch (MHS section 6)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

BONE = 0.05  # m, each of the two of a finger
PALM = np.array([0.0, 0.03, 0.075])  # m, from the middle of the fingertips: behind and above, out of the view
WRIST = np.array([0.0, 0.05, 0.035])  # m, from the palm
KNUCKLE = 0.022  # m, from the palm's middle


class Hand(NamedTuple):
    """Where a hand's parts are, m: the middle of its `palm`, each finger's two `joints`, the knuckle first, and from where
    to where its `bones` go, two of each finger and the wrist's."""

    palm: Float[np.ndarray, "3"]
    joints: Float[np.ndarray, "F 2 3"]
    bones: Float[np.ndarray, "B 2 3"]


def hand(tips: Float[np.ndarray, "F 3"]) -> Hand:
    """The hand whose fingertips are at `tips` (m), world frame.

    Each finger leaves the palm on its own side and bends outward, so that fingers do not cross. Its bones are of one
    length, or longer where the tip is out of reach.
    """
    middle = tips.mean(axis=0)
    palm = middle + PALM
    out = (tips - middle) * [1.0, 1.0, 0.0]
    size = np.linalg.norm(out, axis=1, keepdims=True)
    out = np.divide(out, size, out=np.zeros_like(out), where=size > 1e-6)
    knuckles = palm + KNUCKLE * out
    out[size[:, 0] <= 1e-6] = [0.0, -1.0, 0.0]
    joints = np.stack([knuckles, _bent(knuckles, tips, out)], axis=1)
    fingers = np.concatenate([joints, np.stack([joints[:, 1], tips], axis=1)])
    return Hand(palm, joints, np.concatenate([fingers, [[palm, palm + WRIST]]]))


def _bent(
    knuckles: Float[np.ndarray, "F 3"], tips: Float[np.ndarray, "F 3"], out: Float[np.ndarray, "F 3"]
) -> Float[np.ndarray, "F 3"]:
    """The joints between two bones that reach from knuckles to tips, on the side `out`."""
    way = tips - knuckles
    reach = np.linalg.norm(way, axis=1, keepdims=True)
    along = np.divide(way, reach, out=np.zeros_like(way), where=reach > 0)
    across = out - np.sum(out * along, axis=1, keepdims=True) * along
    width = np.linalg.norm(across, axis=1, keepdims=True)
    across = np.divide(across, width, out=np.zeros_like(across), where=width > 1e-9)
    return knuckles + way / 2 + np.sqrt(np.maximum(BONE**2 - reach**2 / 4, 0)) * across
