"""`hapjax import`."""

from pathlib import Path

import jax
from tyro.conf import FlagCreatePairsOff, Positional

from ..errors import InputError
from ..exchange import load_model
from ..files import check_writable
from ..scene_file import save_scene


def import_model(model: Positional[Path], *, out: Path, hull: FlagCreatePairsOff[bool] = False) -> None:
    """Make a scene file of a model of another simulator: shape, place, mass, centre and inertia of each body.

    Friction and stiffness are for you to add, or to fit. Example: hapjax import cube.urdf --out again.toml

    Args:
        model: MJCF (.xml) or URDF file; its meshes have to be in its folder or below it.
        out: Scene file (TOML) to write; where the model has meshes, in the model's folder or above it.
        hull: Take the convex hull of each mesh, which then need not be closed.
    """
    if out.suffix != ".toml":  # so that neither the model nor a mesh is overwritten
        raise InputError(f"{out}: has the ending {out.suffix!r}; allowed: .toml")
    check_writable(out)
    with jax.enable_x64(True):
        scene = load_model(model, hull)
        save_scene(scene, out)
    for name, thing in scene.object.items():
        weight = "fixed" if thing.body is None else f"{float(thing.body.mass):.6g} kg"
        print(f"{out}: object.{name}: {type(thing.shape).__name__.lower()}, {weight}")
