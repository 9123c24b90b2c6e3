"""Other friction laws in the place of the one whose mu is fitted."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp

from hapjax import InputError, Scene, friction

from .parameters import Selector, free_parameters

# Where a search begins, for numbers that the scene does not have: slow for a finger, and small beside mu at 0.1 m/s.
_NUMBERS = {
    "viscous": {"coefficient": 0.1},
    "stribeck": {"stribeck_velocity": 0.02, "viscous": 0.1},
    "karnopp": {"velocity_band": 1e-3},
    "dahl": {},
    "lugre": {"bristle_damping": 0.01, "viscous": 0.1, "stribeck_velocity": 0.02},
    "cone": {},
}
_TWO = ("stribeck", "lugre")  # laws of a static mu and a kinetic one
_APART = 1.25  # static over kinetic mu, where the scene has one number for both


def with_laws(
    scene: Scene, laws: Sequence[str], free: Selector
) -> tuple[dict[str, Scene], dict[str, tuple[str, ...]]]:
    """For each law the scene with it, and what is free then, for `compare`.

    Each surface or contact of which a mu, or a number of its law, is free gets the law, with starting numbers from the
    scene's mu. All of the law's own numbers are free, and what else is free is so with every law. The cone and the
    one-mu laws keep `mu_static` and `mu_kinetic` where the scene has both; Dahl's law has one mu.

    **Raises:** `InputError` for unknown or repeated laws, and where no mu is free.
    """
    for law in laws:
        if law not in friction.LAWS:
            raise InputError(f"compare names {law!r}; allowed: {', '.join(friction.LAWS)}")
        if list(laws).count(law) > 1:
            raise InputError(f"compare names {law} twice; allowed: each law once")
    if len(laws) < 2:
        raise InputError(f"compare names {len(laws)} law; allowed: at least two")
    paths = [p.name for p in free_parameters(scene, free)]
    places = {place for path in paths if (place := _place(path))}
    if not places:
        raise InputError("free names no mu; allowed: with compare, the mu of a surface or contact")
    others = tuple(path for path in paths if not _place(path))
    scenes, chosen = {}, {}
    for law in laws:
        scenes[law], own = scene, ()
        for place in sorted(places):
            scenes[law], numbers = _with_law(scenes[law], place, law)
            own += tuple(f"{place}.{number}" for number in numbers)
        chosen[law] = (*own, *others)
    return scenes, chosen


def _place(path: str) -> str | None:
    """The surface or contact of which a path is a mu, or a number of the law."""
    kind, name, *rest = path.split("[")[0].split(".")
    place = f"object.{name}.surface" if kind == "object" else f"contact.{name}"
    rest = rest[1:] if rest[:1] == ["surface"] else rest if kind == "contact" else [""]
    return place if rest[:1] in (["mu"], ["mu_static"], ["mu_kinetic"], ["friction"]) else None


def _with_law(scene: Scene, place: str, law: str) -> tuple[Scene, tuple[str, ...]]:
    kind, name, *_ = place.split(".")
    surface: Any = scene.object[name].surface if kind == "object" else scene.contact[name]
    dtype = surface.stiffness.dtype
    one = surface.mu_kinetic if surface.mu is None else surface.mu
    numbers = {key: jnp.asarray(value, dtype) for key, value in _NUMBERS[law].items()}
    numbers |= _known(surface.friction, numbers)
    if law in _TWO and surface.mu is not None:
        mus = {"mu": None, "mu_static": _APART * one, "mu_kinetic": one}
    elif law == "dahl":
        mus = {"mu": one, "mu_static": None, "mu_kinetic": None}
    else:
        mus = {key: getattr(surface, key) for key in ("mu", "mu_static", "mu_kinetic")}
    surface = replace(surface, friction=friction.LAWS[law](**numbers), **mus)
    if kind == "object":
        thing = replace(scene.object[name], surface=surface)
        scene = replace(scene, object={**scene.object, name: thing})
    else:
        scene = replace(scene, contact={**scene.contact, name: surface})
    used = tuple(key for key, value in mus.items() if value is not None)
    return scene, (*used, *(f"friction.{key}" for key in numbers))


def _known(law: Any, wanted: dict[str, jax.Array]) -> dict[str, jax.Array]:
    """Those numbers that the scene's own law has under the same name, where they can be a start."""
    found = {key: getattr(law, key, None) for key in wanted}
    return {key: value for key, value in found.items() if value is not None and float(value) > 0}
