"""The nearest scene that can be: what a fit finds may be just beyond it, where noise has it so."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from hapjax import Scene

from .parameters import find_leaf

_NOTICED = 1e-3  # a share of the number


def possible(scene: Scene) -> tuple[Scene, tuple[str, ...]]:
    """The scene that can be saved and loaded, and what differs, in sentences.

    A mu_static is at least its mu_kinetic: below, the model slides at the kinetic one all the same. Principal moments that
    no body has, one above the sum of the other two, are moved to the nearest ones, which a flat body has.
    """
    changes: dict[str, Array] = {}
    for name, thing in scene.object.items():
        if thing.surface is not None:
            _check_mu(f"object.{name}.surface", thing.surface, changes)
        if thing.body is not None and thing.body.inertia is not None and thing.body.inertia.ndim == 1:
            changes[f"object.{name}.body.inertia"] = _flat_at_most(thing.body.inertia)
    for name, contact in scene.contact.items():
        _check_mu(f"contact.{name}", contact, changes)
    before = {path: find_leaf(scene, path) for path in changes}
    said = tuple(
        f"The scene has {path} as {_listed(new)} in place of {_listed(before[path])}: {_why(path)}."
        for path, new in changes.items()
        if bool(jnp.any(jnp.abs(new - before[path]) > _NOTICED * before[path]))
    )
    for path, new in changes.items():
        scene = eqx.tree_at(lambda s, path=path: _node(s, path), scene, new)
    return scene, said


def _node(scene: Scene, path: str) -> Any:
    node: Any = scene
    for name in path.split("."):
        node = node[name] if isinstance(node, dict) else getattr(node, name)
    return node


def _check_mu(path: str, surface: Any, changes: dict[str, Array]) -> None:
    if surface.mu_static is not None and surface.mu_kinetic is not None:
        changes[f"{path}.mu_static"] = jnp.maximum(surface.mu_static, surface.mu_kinetic)


def _flat_at_most(moments: Float[Array, "3"]) -> Float[Array, "3"]:
    """The nearest moments that obey the triangle inequality."""
    excess = jnp.maximum(2 * jnp.max(moments) - jnp.sum(moments), 0)
    return moments + jnp.where(moments == jnp.max(moments), -1, 1) * excess / 3


def _listed(numbers: Array) -> str:
    return ", ".join(f"{x:.4g}" for x in numbers.ravel().tolist())


def _why(path: str) -> str:
    if path.endswith("mu_static"):
        return "it is never below mu_kinetic"
    return "no body has a principal moment above the sum of the other two, and the nearest ones stand in"
