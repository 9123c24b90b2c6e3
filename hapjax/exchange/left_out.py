"""What of a scene other simulators have no word for, told in a sentence each."""

from collections.abc import Iterator

import numpy as np

from ..friction import LAWS, Cone
from ..scene import Scene
from ..surface import Surface
from ..torsion import MODELS, SoftFinger

_NO_COUNTERPART = {
    "tangential_stiffness": "friction has no spring of its own there",
    "anisotropy": "friction is the same in all directions there; mu along the grain is written",
    "finger_mu": "mu is the same for all that touches there",
}


def left_out_of_surface(surface: Surface, path: str, kinetic: bool) -> Iterator[str]:
    """What is lost of a surface or a contact at a `path`; `kinetic`: whether the format has a mu of sliding."""
    for name, why in _NO_COUNTERPART.items():
        if getattr(surface, name) is not None:
            yield f"{path}.{name} is left out: {why}"
    if surface.mu_kinetic is not None and not kinetic:
        yield f"{path}.mu_kinetic is left out: sliding has the mu of breaking away there"
    if surface.friction is not None and not isinstance(surface.friction, Cone):
        law = next(name for name, kind in LAWS.items() if isinstance(surface.friction, kind))
        yield f"{path}.friction is left out: there is no law {law} there, and mu alone is written"
    mus = (surface.mu, surface.mu_static)
    if any(mu is not None and np.ndim(mu) == 1 for mu in mus):
        yield f"{path}.mu differs from face to face, which it cannot there: the mean is written"


def left_out_of_scene(scene: Scene, soft_fingers: bool) -> Iterator[str]:
    """What is lost of a scene as a whole; `soft_fingers`: whether the format has friction in twist."""
    if scene.torsion is not None and not (soft_fingers and isinstance(scene.torsion, SoftFinger)):
        model = next(name for name, kind in MODELS.items() if isinstance(scene.torsion, kind))
        yield f"torsion is left out: there is no {model} there"
    if scene.world.dead_band is not None:
        yield "world.dead_band is left out: there is none there"
