"""Scenes from and to TOML: the same names as the Python fields, what is absent is left out."""

import dataclasses
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tomli_w

from . import mesh_file, scene_text
from .body import Body
from .contact import Contact
from .errors import InputError, within
from .files import replacing
from .friction import LAWS
from .integrate import METHODS
from .scene import Object, Scene, World
from .shape import SHAPES, Mesh, Shape
from .surface import Surface
from .torsion import MODELS

_PLACE = ("position", "orientation")
_MOST = {"object": 100, "contact": 500}  # which take some 20 kB and 8 kB each


def load_scene(path: str | os.PathLike) -> Scene:
    """Read a scene file.

    **Raises:** `InputError`, one sentence that names the file, the field, the value and what is allowed.
    """
    path = Path(path)
    with within(f"{path}: "):
        return scene_from_dict(scene_text.read(path), path.parent)


def save_scene(scene: Scene, path: str | os.PathLike) -> None:
    """Write a scene file, whole or not at all. `load_scene` gives the same numbers back, to the last bit."""
    text = tomli_w.dumps(scene_to_dict(scene, Path(path).parent))
    with replacing(path) as file:
        file.write(text)


def scene_from_dict(table: Mapping[str, Any], folder: Path | None = None) -> Scene:
    """The scene that a scene file's tables describe; the files of its meshes are in `folder`.

    **Raises:** `InputError` as `load_scene`, without a file.
    """
    _known(table, "", ("object", "contact", "torsion", "world", "integrator"))
    for kind, most in _MOST.items():
        if len(_tables(table, kind)) > most:
            raise InputError(f"{kind} has {len(table[kind])} tables; allowed: {most} or fewer")
    parts: dict[str, Any] = {
        "object": {name: _object(name, t, folder) for name, t in _tables(table, "object").items()},
        "contact": {
            name: _surface(Contact, t, f"contact.{name}.") for name, t in _tables(table, "contact").items()
        },
    }
    if "torsion" in table:
        parts["torsion"] = _chosen(MODELS, "model", None, table["torsion"], "torsion.")
    if "world" in table:
        parts["world"] = _build(World, table["world"], "world.")
    if "integrator" in table:
        parts["integrator"] = _chosen(METHODS, "method", "semi_implicit", table["integrator"], "integrator.")
    return Scene(**parts)


def scene_to_dict(scene: Scene, folder: Path | None = None) -> dict[str, Any]:
    """The tables of the scene file in `folder` that describes a scene.

    **Raises:** `InputError` where a mesh is in no file, or in none of that folder.
    """
    objects: dict[str, Any] = {}
    for name, thing in scene.object.items():
        with within(f"object.{name}."):
            objects[name] = _object_table(thing, folder)
    table: dict[str, Any] = {"object": objects}
    if scene.contact:
        table["contact"] = {name: _surface_table(pair) for name, pair in scene.contact.items()}
    if scene.torsion is not None:
        table["torsion"] = {"model": _name_of(MODELS, scene.torsion), **_fields(scene.torsion)}
    table["world"] = _fields(scene.world)
    table["integrator"] = {"method": _name_of(METHODS, scene.integrator), **_fields(scene.integrator)}
    return table


def _object(name: str, table: Any, folder: Path | None) -> Object:
    prefix = f"object.{name}."
    _check_table(table, f"object.{name}")
    shape_type = _choice(SHAPES, "shape", None, table, prefix)
    is_mesh = issubclass(shape_type, Mesh)
    fields = (
        mesh_file.shape_fields(shape_type) if is_mesh else [f.name for f in dataclasses.fields(shape_type)]
    )
    _known(table, prefix, ("shape", *fields, *_PLACE, "surface", "body"))
    parts: dict[str, Any] = {key: table[key] for key in _PLACE if key in table}
    given = {key: table[key] for key in fields if key in table}
    if is_mesh:
        with within(prefix):
            parts["shape"] = mesh_file.shape_from_table(shape_type, given, folder)
    else:
        parts["shape"] = _build(shape_type, given, prefix)
    if "surface" in table:
        parts["surface"] = _surface(Surface, table["surface"], f"{prefix}surface.")
    if "body" in table:
        parts["body"] = _body(table["body"], parts["shape"], f"{prefix}body.")
    with within(prefix):
        return Object(**parts)


def _body(table: Any, shape: Shape, prefix: str) -> Body:
    """A body from its table, which has a mass, or the density of a uniform solid in its place."""
    _check_table(table, prefix[:-1])
    if "density" not in table:
        return _build(Body, table, prefix)
    for other in ("mass", "inertia", "centre"):
        if other in table:
            raise InputError(
                f"{prefix}density and {prefix}{other} are both given; allowed: density alone, or mass"
            )
    _known(table, prefix, ("density", "rotation"))
    with within(prefix):
        return Body.of_density(shape, **table)


def _object_table(thing: Object, folder: Path | None) -> dict[str, Any]:
    shape = thing.shape
    if isinstance(shape, Mesh):
        fields = {key: _plain(value) for key, value in mesh_file.table_of_shape(shape, folder).items()}
    else:
        fields = _fields(shape)
    table = {"shape": _name_of(SHAPES, shape), **fields}
    table |= {key: _plain(getattr(thing, key)) for key in _PLACE}
    if thing.surface is not None:
        table["surface"] = _surface_table(thing.surface)
    if thing.body is not None:
        table["body"] = _fields(thing.body)
    return table


def _surface(part: type[Surface], table: Any, prefix: str) -> Surface:
    """A surface or a contact, whose friction law is named by a key of a table of its own."""
    _check_table(table, prefix[:-1])
    if "friction" in table:
        law = _chosen(LAWS, "law", None, table["friction"], f"{prefix}friction.")
        table = {**table, "friction": law}
    return _build(part, table, prefix)


def _surface_table(surface: Surface) -> dict[str, Any]:
    table = _fields(surface)
    if surface.friction is not None:
        table["friction"] = {"law": _name_of(LAWS, surface.friction), **_fields(surface.friction)}
    return table


def _chosen(types: Mapping[str, type], key: str, default: str | None, table: Any, prefix: str) -> Any:
    """The part whose type one key of its table names."""
    _check_table(table, prefix[:-1])
    chosen = _choice(types, key, default, table, prefix)
    return _build(chosen, {k: v for k, v in table.items() if k != key}, prefix)


def _choice(
    types: Mapping[str, type], key: str, default: str | None, table: Mapping[str, Any], prefix: str
) -> type:
    if key not in table and default is None:
        raise InputError(f"{prefix}{key} is missing; allowed: {', '.join(types)}")
    name = table.get(key, default)
    if not isinstance(name, str) or name not in types:
        raise InputError(f"{prefix}{key} is {name!r}; allowed: {', '.join(types)}")
    return types[name]


def _build(part: type, table: Any, prefix: str) -> Any:
    """A module from the table that has its fields."""
    _check_table(table, prefix[:-1])
    fields = dataclasses.fields(part)
    _known(table, prefix, [f.name for f in fields])
    for field in fields:
        required = field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING
        if required and field.name not in table:
            raise InputError(f"{prefix}{field.name} is missing; allowed: a scene that gives it")
    with within(prefix):
        return part(**table)


def _tables(table: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    found = table.get(key, {})
    _check_table(found, key)
    return found


def _check_table(table: Any, name: str) -> None:
    if not isinstance(table, Mapping):
        raise InputError(f"{name} is {table!r}; allowed: a table")


def _known(table: Mapping[str, Any], prefix: str, allowed) -> None:
    for key in table:
        if key not in allowed:
            raise InputError(f"{prefix}{key} is not known; allowed: {', '.join(allowed)}")


def _name_of(types: Mapping[str, type], part: Any) -> str:
    for name, kind in types.items():
        if type(part) is kind:
            return name
    raise InputError(f"{type(part).__name__} has no name in scene files; allowed: {', '.join(types)}")


def _fields(part: Any) -> dict[str, Any]:
    values = {f.name: getattr(part, f.name) for f in dataclasses.fields(part)}
    return {name: _plain(value) for name, value in values.items() if value is not None}


def _plain(value: Any) -> Any:
    """A value as TOML has it; a float32 by its own shortest decimals, so that 0.6 stays 0.6."""
    if isinstance(value, (jax.Array, np.ndarray)):
        return _decimal(np.asarray(value))
    return list(value) if isinstance(value, tuple) else value


def _decimal(value: np.ndarray) -> Any:
    return float(str(value[()])) if value.ndim == 0 else [_decimal(np.asarray(v)) for v in value]
