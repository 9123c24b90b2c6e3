"""`hapjax export`."""

import sys
from pathlib import Path
from typing import Literal

import jax
from tyro.conf import Positional

from ..errors import InputError
from ..exchange import save_mjcf, save_urdf
from ..files import check_apart, check_writable, write_json
from ..scene_file import load_scene


def export(
    scene: Positional[Path],
    *,
    to: Literal["mjcf", "urdf"],
    out: Path | None = None,
    object: str | None = None,
    json: Path | None = None,
) -> None:
    """Write a scene as MJCF, for MuJoCo, or one of its objects as URDF: mass, inertia, friction, stiffness, damping.

    Meshes are written beside it, as OBJ files. What of the scene the format has no word for is said.
    Example: hapjax export cube.toml --to mjcf --out cube.xml

    Args:
        scene: Scene file (TOML).
        to: The format.
        out: File to write (.xml for MJCF, .urdf); absent: the scene's name with that ending.
        object: Of urdf: which object; absent: the only one that moves.
        json: File for what was written and what was left out; - is standard output.
    """
    ending = "xml" if to == "mjcf" else "urdf"
    target = scene.parent / f"{scene.stem}.{ending}" if out is None else out
    check_apart([target, json], [scene])
    if json is not None:
        check_writable(json)
    with jax.enable_x64(True):
        loaded = load_scene(scene)
        if to == "urdf":
            left_out = save_urdf(loaded, target, object)
        elif object is None:
            left_out = save_mjcf(loaded, target)
        else:
            raise InputError(f"--object is {object!r} with --to mjcf; allowed: with --to urdf")
    for sentence in left_out:
        print(f"hapjax: {scene}: {sentence}", file=sys.stderr)
    print(target)
    if json is not None:
        write_json(json, {"file": str(target), "left_out": list(left_out)})
