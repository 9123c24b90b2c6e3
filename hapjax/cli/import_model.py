"""`hapjax import`."""

from pathlib import Path

import jax
from tyro.conf import FlagCreatePairsOff, Positional

from ..errors import InputError
from ..exchange import load_model
from ..files import check_apart, check_writable, write_json
from ..scene_file import save_scene


def import_model(
    model: Positional[Path], *, out: Path, hull: FlagCreatePairsOff[bool] = False, json: Path | None = None
) -> None:
    """Make a scene file of a model of another simulator: shape, place, mass, centre and inertia of each body.

    Friction and stiffness are for you to add, or to fit. Example: hapjax import cube.urdf --out again.toml

    Args:
        model: MJCF (.xml) or URDF file; its meshes have to be in its folder or below it.
        out: Scene file (TOML) to write; where the model has meshes, in the model's folder or above it.
        hull: Take the convex hull of each mesh, which then need not be closed.
        json: File for the objects, with their shapes and masses; - is standard output.
    """
    if out.suffix != ".toml":  # so that neither the model nor a mesh is overwritten
        raise InputError(f"{out}: has the ending {out.suffix!r}; allowed: .toml")
    check_apart([out, json], [model])
    for file in (out, json):
        if file is not None:
            check_writable(file)
    with jax.enable_x64(True):
        scene = load_model(model, hull)
        save_scene(scene, out)
    found = {}
    for name, thing in scene.object.items():
        mass = None if thing.body is None else float(thing.body.mass)
        found[name] = {"shape": type(thing.shape).__name__.lower(), "mass": mass}
        weight = "fixed" if mass is None else f"{mass:.6g} kg"
        print(f"{out}: object.{name}: {found[name]['shape']}, {weight}")
    if json is not None:
        write_json(json, {"file": str(out), "objects": found})
