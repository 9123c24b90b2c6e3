"""What each part of a scene costs: equations, floating-point operations and time of a step without it."""

import dataclasses
from collections import OrderedDict
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from rich.console import Console
from rich.table import Column, Table

from ..body import Body
from ..errors import InputError
from ..files import write_json
from ..integrate import SemiImplicit
from ..progress import following
from ..scene import Object, Scene, dtype_of
from ..shape import Mesh
from ..simulate import init, step
from ..surface import Surface
from ._timing import RUNS, compiled, felt, step_us


def measure(scene: Scene | None, fingers: int) -> dict[str, Any]:
    """The cost of a step of the whole scene and of the scene without each of its parts.

    `parts`: for each, `equations` of the traced step, `flops` as the compiler counts them, `step_us` inside a compiled
    loop (median), and `compile_s` of that loop; the first is `everything`. `scene` `None`: the demo's.

    **Raises:** `InputError` for a number of fingers outside 1 to 100.
    """
    if not 1 <= fingers <= 100:
        raise InputError(f"fingers is {fingers}; allowed: 1 to 100")
    scene, devices = felt(scene, fingers)
    hip = np.stack([np.asarray(device.path[0]) for device in devices])
    variants = [("everything", scene), *without_each_part(scene)]
    costs, loops = [], []
    with following(float(len(variants) + RUNS + 1), apart=True) as advance:
        for name, variant in variants:
            cost, loop = _cost(variant, hip)
            costs.append({"without": name, **cost})
            loops.append(loop)
            advance("compiling", 1.0)
        taken = step_us(loops, advance=advance)
    parts = [cost | {"step_us": us} for cost, us in zip(costs, taken, strict=True)]
    return {
        "device": str(jax.devices()[0]),
        "dtype": str(dtype_of(scene)),
        "fingers": len(devices),
        "parts": parts,
    }


def report(scene: Scene | None, fingers: int, file: Path | None) -> None:
    """Measure, print the table, and write the figures as JSON where a file is given."""
    figures = measure(scene, fingers)
    Console().print(_table(figures))
    if file is not None:
        write_json(file, figures)


def equations(jaxpr: Any) -> int:
    """The number of primitive equations; an equation that only holds inner jaxprs counts as what they hold."""
    count = 0
    for equation in jaxpr.eqns:
        inner = [leaf for leaf in jax.tree.leaves(tuple(equation.params.values())) if hasattr(leaf, "eqns")]
        count += sum(map(equations, inner)) if inner else 1
    return count


def without_each_part(scene: Scene) -> Iterator[tuple[str, Scene]]:
    """The scene with each part switched off in turn, by the part's name; with what cannot be without it."""
    for name, thing in scene.object.items():
        path = f"object.{name}"
        if isinstance(thing.shape, Mesh) and thing.shape.shaded:
            yield f"{path}.shaded", _with(scene, name, shape=_unshaded(thing.shape))
        for field, simpler in _simpler_surfaces(thing.surface):
            yield f"{path}.surface.{field}", _with(scene, name, surface=simpler)
        if thing.surface is not None:
            yield f"{path}.surface", _consistent(_with_objects(scene, name, surface=None))
        if thing.body is not None:
            for field, body in _simpler_bodies(thing.body):
                yield f"{path}.body.{field}", _consistent(_with_objects(scene, name, body=body))
            yield f"{path}.body", _consistent(_with_objects(scene, name, body=None))
        if len(scene.object) > 1:
            rest = OrderedDict((k, o) for k, o in scene.object.items() if k != name)
            yield path, _consistent(_fields(scene) | {"object": rest})
    for name, pair in scene.contact.items():
        for field, simpler in _simpler_surfaces(pair):
            yield f"contact.{name}.{field}", _changed(scene, contact={**scene.contact, name: simpler})
        rest = OrderedDict((k, p) for k, p in scene.contact.items() if k != name)
        yield f"contact.{name}", _changed(scene, contact=rest)
    if scene.torsion is not None:
        if getattr(scene.torsion, "twist_damping", None) is not None:
            torsion = dataclasses.replace(scene.torsion, twist_damping=None)
            yield "torsion.twist_damping", _changed(scene, torsion=torsion)
        yield "torsion", _changed(scene, torsion=None)
    for field, off in (("gravity", None), ("gyroscopic", False), ("dead_band", None)):
        held = getattr(scene.world, field)
        if held is not None and held is not False:
            yield f"world.{field}", _changed(scene, world=dataclasses.replace(scene.world, **{field: off}))
    if not isinstance(scene.integrator, SemiImplicit):
        plain = SemiImplicit(scene.integrator.dt, scene.integrator.substeps)
        yield "integrator.method", _changed(scene, integrator=plain)
    if scene.integrator.substeps > 1:
        yield (
            "integrator.substeps",
            _changed(scene, integrator=dataclasses.replace(scene.integrator, substeps=1)),
        )


def _simpler_surfaces(surface: Surface | None) -> Iterator[tuple[str, Surface]]:
    if surface is None:
        return
    for field in ("friction", "damping", "tangential_stiffness", "finger_mu"):
        if getattr(surface, field) is not None:
            yield field, dataclasses.replace(surface, **{field: None})
    if surface.mu_kinetic is not None:
        yield (
            "mu_kinetic",
            # A law may ask for both.
            dataclasses.replace(
                surface, mu=surface.mu_static, mu_static=None, mu_kinetic=None, friction=None
            ),
        )
    if surface.anisotropy is not None:
        yield "anisotropy", dataclasses.replace(surface, anisotropy=None, grain=None)
    faces = [n for n in ("mu", "mu_static", "mu_kinetic") if np.ndim(getattr(surface, n)) == 1]
    if faces:
        yield "mu of each face", dataclasses.replace(surface, **{n: getattr(surface, n)[0] for n in faces})


def _unshaded(mesh: Mesh) -> Mesh:
    return Mesh(mesh.vertices, mesh.triangles, mesh.scale, False, mesh.file, mesh.contact_points)


def _simpler_bodies(body: Body) -> Iterator[tuple[str, Body]]:
    if body.centre is not None:
        yield "centre", dataclasses.replace(body, centre=None)
    if body.rotation:
        yield "rotation", dataclasses.replace(body, inertia=None, centre=None, rotation=False)


def _fields(scene: Scene) -> dict[str, Any]:
    return {f.name: getattr(scene, f.name) for f in dataclasses.fields(scene)}


def _changed(scene: Scene, **parts: Any) -> Scene:
    return Scene(**_fields(scene) | parts)


def _with_objects(scene: Scene, name: str, **parts: Any) -> dict[str, Any]:
    changed = dataclasses.replace(scene.object[name], **parts)
    return _fields(scene) | {"object": OrderedDict(scene.object) | {name: changed}}


def _with(scene: Scene, name: str, **parts: Any) -> Scene:
    return Scene(**_with_objects(scene, name, **parts))


def _consistent(parts: dict[str, Any]) -> Scene:
    """A scene of these parts, less those that make no sense any more with its objects."""
    objects: dict[str, Object] = parts["object"]

    def collides(pair) -> bool:
        return all(n in objects for n in pair.between) and any(objects[n].body for n in pair.between)

    contact = OrderedDict((k, p) for k, p in parts["contact"].items() if collides(p))
    turning = [o for o in objects.values() if o.body is not None and o.body.rotation]
    changed: dict[str, Any] = {"contact": contact}
    if not any(o.surface is not None for o in turning):
        changed["torsion"] = None
    if not turning:
        changed["world"] = dataclasses.replace(parts["world"], gyroscopic=False, dead_band=None)
    return Scene(**parts | changed)


def _cost(scene: Scene, hip: np.ndarray) -> tuple[dict[str, Any], Callable[[], Any]]:
    """What is known before it runs, and a loop to be timed."""
    gimbal = np.zeros(len(hip)) if scene.torsion is not None and scene.torsion.needs_gimbal else None
    here = jnp.asarray(hip, dtype_of(scene))
    arguments = (scene, init(scene, here, gimbal), here)
    if gimbal is not None:
        arguments = (*arguments, None, jnp.asarray(gimbal, here.dtype))
    analysis = step.lower(*arguments).compile().cost_analysis() or {}
    loop, compile_s = compiled(scene, hip, gimbal)
    count = equations(jax.make_jaxpr(step)(*arguments).jaxpr)
    return {"equations": count, "flops": analysis.get("flops"), "compile_s": compile_s}, loop


def _table(figures: dict[str, Any]) -> Table:
    title = f"cost of a step: {figures['fingers']} fingers, {figures['dtype']}, {figures['device']}"
    table = Table(
        Column("without", overflow="fold"),
        "equations",
        "flops",
        "us a step",
        "of all",
        "compile s",
        title=title,
    )
    whole = figures["parts"][0]
    for part in figures["parts"]:
        flops = "" if part["flops"] is None else f"{part['flops']:.0f}"
        table.add_row(
            part["without"] if part is not whole else "nothing",
            str(part["equations"]),
            flops,
            f"{part['step_us']:.2f}",
            f"{part['step_us'] / whole['step_us']:.2f}",
            f"{part['compile_s']:.2f}",
        )
    return table
