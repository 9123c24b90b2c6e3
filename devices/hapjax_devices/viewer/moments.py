"""What there is to be seen at each of several times, wherever it comes from: a run, or a recording."""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from jaxtyping import Float

from .geometry import placed, turned


@dataclass(frozen=True)
class Moments:
    """F fingers and O objects, of which P are felt, at T times, in the world frame.

    **Attributes:** `time` (s); `hip` (m); `force` on the fingers (N); `pose` of every object in the scene's order, x y z qw
    qx qy qz; of each touch, 0 where there is none: where the god-object is, `point` (m), its `depth` (m), the outward
    `normal`, `normal_force` and `friction` on the finger (N), and mu times the depth, `circle` (m); A_crit, `critical_area`
    (m^2), NaN where there is none.
    """

    time: Float[np.ndarray, "T"]
    hip: Float[np.ndarray, "T F 3"]
    force: Float[np.ndarray, "T F 3"]
    pose: Float[np.ndarray, "T O 7"]
    point: Float[np.ndarray, "T P F 3"]
    depth: Float[np.ndarray, "T P F"]
    normal: Float[np.ndarray, "T P F 3"]
    normal_force: Float[np.ndarray, "T P F"]
    friction: Float[np.ndarray, "T P F 3"]
    circle: Float[np.ndarray, "T P F"]
    critical_area: Float[np.ndarray, "T"]

    def __len__(self) -> int:
        return len(self.time)

    def __getitem__(self, part: slice) -> "Moments":
        """The moments of a part of the times."""
        return Moments(*(getattr(self, field.name)[part] for field in fields(self)))

    def __add__(self, later: "Moments") -> "Moments":
        """These, and then those."""
        pairs = ((getattr(self, field.name), getattr(later, field.name)) for field in fields(self))
        return Moments(*map(np.concatenate, pairs))

    @property
    def limit(self) -> Float[np.ndarray, "T P F"]:
        """How large friction may be, mu times the normal force, N: the radius of the friction circle there."""
        return self.normal_force * np.divide(
            self.circle, self.depth, out=np.zeros_like(self.circle), where=self.depth > 0
        )

    @property
    def tip(self) -> Float[np.ndarray, "T F 3"]:
        """Where fingertips are seen (m): at the god-object of the deepest touch, else at the HIP."""
        deepest = self.deepest[:, None, :, None]
        god = np.take_along_axis(self.point, deepest, axis=1)[:, 0]
        return np.where(self.depth.max(axis=1)[..., None] > 0, god, self.hip)

    @property
    def deepest(self) -> Any:
        """The number of the felt object that each finger is deepest in, (T, F)."""
        return self.depth.argmax(axis=1)

    def of_deepest(self, values: Float[np.ndarray, "T P F"]) -> Float[np.ndarray, "T F"]:
        """Of values that each touch has, those of each finger's deepest touch."""
        return np.take_along_axis(values, self.deepest[:, None], axis=1)[:, 0]


def moments(
    time: Float[np.ndarray, "T"],
    hip: Float[np.ndarray, "T F 3"],
    force: Float[np.ndarray, "T F 3"],
    pose: Float[np.ndarray, "T O 7"],
    felt: list[int],
    touch: dict[str, np.ndarray],
    critical_area: Float[np.ndarray, "T"],
) -> Moments:
    """The moments of touches that are given in the frames of the objects that are `felt`, by their numbers.

    **Arguments:** `touch`: `point` and `depth` of the god-objects, `force`, `normal_force`, `friction_force` and `circle` of
    `hapjax`'s `Touch`, (T, P, F) and (T, P, F, 3).
    """
    frames = pose[:, felt, None]
    pressed, size = touch["depth"] > 0, touch["normal_force"][..., None]
    normal = np.divide(
        touch["force"] - touch["friction_force"], size, out=np.zeros_like(touch["force"]), where=size > 0
    )
    return Moments(
        time,
        hip,
        force,
        pose,
        np.where(pressed[..., None], placed(frames, touch["point"]), 0.0),
        np.where(pressed, touch["depth"], 0.0),
        turned(frames, normal),
        np.where(pressed, touch["normal_force"], 0.0),
        turned(frames, touch["friction_force"]),
        np.where(pressed, touch["circle"], 0.0),
        critical_area,
    )
