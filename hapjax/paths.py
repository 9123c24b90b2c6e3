"""Numbers of a scene by the paths that they have in its file."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from .errors import InputError, within
from .scene import Object, Scene

_FIXED = ("integrator",)  # how a scene is computed, not what it is


def number_at(scene: Scene, path: str) -> Float[Array, "..."]:
    """The number or numbers with a path such as `object.cube.surface.mu`.

    **Raises:** `InputError` where the scene has none there, naming what it has.
    """
    node: Any = scene
    walked: list[str] = []
    for name in path.split("."):
        parts = _parts(node)
        if name not in parts:
            where = ".".join(walked) or "the scene"
            raise InputError(
                f"{path}: {where} has no {name or 'part without a name'}; allowed: {_next(parts, walked)}"
            )
        node = parts[name]
        walked.append(name)
    if not hasattr(node, "dtype"):
        raise InputError(
            f"{path} is a part of the scene, not a number; allowed: {_next(_parts(node), walked)}"
        )
    return node


def part_at(node: Any, path: str) -> Any:
    """What is at a path that is known to be there, of a scene or of another pytree like it."""
    for name in path.split("."):
        node = node[name] if isinstance(node, Mapping) else getattr(node, name)
    return node


def with_numbers(scene: Scene, values: Mapping[str, Any]) -> Scene:
    """The scene with other numbers at some paths, checked as a scene file's are.

    **Raises:** `InputError` for a path that it does not have, and for a value out of range or of another shape.
    """
    for path, value in values.items():
        old = number_at(scene, path)
        if np.shape(value) != old.shape:
            raise InputError(f"{path} has the shape {np.shape(value)}; allowed: {old.shape}")
        scene = _replaced(scene, path.split("."), np.asarray(value, old.dtype), "")
    return scene


def _replaced(node: Any, names: list[str], value: Any, prefix: str) -> Any:
    """The node with another value below it; each part on the way is built, and so checked, anew."""
    name, *rest = names
    if isinstance(node, Mapping):
        return {**node, name: _replaced(node[name], rest, value, f"{prefix}{name}.")}
    new = _replaced(getattr(node, name), rest, value, f"{prefix}{name}.") if rest else value
    with within(prefix):
        return dataclasses.replace(node, **{name: new})


def _parts(node: Any) -> dict[str, Any]:
    """What a path can go on with."""
    if isinstance(node, Mapping):
        return dict(node)
    if not dataclasses.is_dataclass(node):
        return {}
    left_out = _FIXED if isinstance(node, Scene) else ("shape",) if isinstance(node, Object) else ()
    parts = {f.name: getattr(node, f.name) for f in dataclasses.fields(node) if f.name not in left_out}
    return {name: part for name, part in parts.items() if hasattr(part, "dtype") or _parts(part)}


def _next(parts: Mapping[str, Any], walked: list[str]) -> str:
    return ", ".join(".".join([*walked, name]) for name in parts) or "a path to a number"
