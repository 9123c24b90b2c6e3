"""What is to be estimated of a run, and how: all that the process has to know, as text."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from ..errors import InputError
from ..scene import Scene
from ..scene_file import load_scene


@dataclass(frozen=True)
class Tuning:
    """What is to be estimated while a scene is felt.

    **Arguments:** `run`, its name on the bus; its `scene`'s file; the `truth`, a scene's file, that simulated sensors
    measure; how many seconds a fit is to, `window`, 1 to 60; whether the run is given each estimate, `adopt`, or only when
    it is asked for.

    **Raises:** `InputError` for a window out of range.
    """

    run: str
    scene: str
    truth: str
    window: float = 4.0
    adopt: bool = False

    def __post_init__(self):
        if not 1 <= self.window <= 60:
            raise InputError(f"window is {self.window} s; allowed: 1 to 60")

    def check(self, scene: Scene, fingers: int) -> None:
        """Refuse a truth that is not about the objects of the scene, felt by so many fingers. **Raises:** `InputError`."""
        truth = load_scene(self.truth)
        if truth.moving() != scene.moving():
            names = ", ".join(scene.moving()) or "none"
            found = ", ".join(truth.moving()) or "none"
            raise InputError(
                f"{self.truth}: the objects that move are {found}; allowed: as in the scene, {names}"
            )
        turned = [s.torsion is not None and s.torsion.needs_gimbal for s in (truth, scene)]
        if turned[0] and not turned[1]:
            raise InputError(
                f"{self.truth}: torsion is a gimbal; allowed: a torsion that reads none, as in the scene"
            )
        for name in truth.touchable():
            surface = truth.object[name].surface
            assert surface is not None
            surface.check_fingers(fingers)

    def to_json(self) -> str:
        """All of it, as JSON."""
        return json.dumps(asdict(self))


def tuned_by_default(scene: Scene) -> tuple[str, ...]:
    """The paths of mu and stiffness of all that fingers feel, those of which each is one number."""
    paths: list[str] = []
    for name in scene.touchable():
        for number in ("mu", "mu_static", "mu_kinetic", "stiffness"):
            value = getattr(scene.object[name].surface, number)
            if value is not None and np.ndim(value) == 0:
                paths.append(f"object.{name}.surface.{number}")
    return tuple(paths)


def said(values: Mapping[str, tuple[float, Sequence[float]] | None]) -> str:
    """Estimates in words, each with its 95 % interval, `None` where the data do not say."""
    parts = []
    for name, found in values.items():
        known = (
            "not identified" if found is None else f"{found[0]:.4g} ({found[1][0]:.4g} to {found[1][1]:.4g})"
        )
        parts.append(f"{name} {known}")
    return ", ".join(parts)
