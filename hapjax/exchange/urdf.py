"""An object as URDF."""

import os
import xml.etree.ElementTree as ET
from collections.abc import Iterator

import numpy as np

from ..body import Body, centre_within, inertia_of
from ..errors import InputError
from ..scene import Scene
from ..shape import Box, Capsule, Cylinder, Shape, Sphere
from ..surface import Surface
from .left_out import left_out_of_scene, left_out_of_surface
from .markup import document, model_path, words
from .softness import linear_damping, one_mu
from .wavefront import mesh_name, replacing_with_meshes


def save_urdf(scene: Scene, path: str | os.PathLike[str], name: str | None = None) -> tuple[str, ...]:
    """Write one moving object of a scene as a URDF of one link, a mesh as an OBJ file beside it; whole or not at all.

    URDF itself has mass, centre, inertia and shape. Friction, stiffness and damping are written in the two ways that
    simulators read: `contact` with `lateral_friction`, `stiffness` (N/m) and `damping` (N s/m, m B, B as in
    `save_mjcf`), as Bullet does; and `drake:proximity_properties`, whose law
    is Hunt and Crossley's too, with the same numbers. They are those of the object's surface, else of its first contact.

    **Arguments:** `path`: a file ending in `.urdf`; `name`: of the object; `None`: the only one that moves.

    **Returns:** what of the scene the file has no word for, a sentence each.

    **Raises:** `InputError` where there is no such object, or a file cannot be written.
    """
    path = model_path(path, ".urdf")
    name, body = _chosen(scene, name)
    shape = scene.object[name].shape
    where, surface = _felt(scene, name)
    root = ET.Element("robot", {"name": path.stem, "xmlns:drake": "http://drake.mit.edu"})
    link = ET.SubElement(root, "link", name=name)
    _inertial(link, body, shape)
    for kind in ("visual", "collision"):
        part = ET.SubElement(link, kind)
        _form(ET.SubElement(part, "geometry"), shape, mesh_name(path, name))
        if kind == "collision" and surface is not None:
            _drake(ET.SubElement(part, "drake:proximity_properties"), surface)
    if surface is not None:
        mass = float(body.mass)
        damping = mass * linear_damping(surface, 1 / mass, scene.world)
        _bullet(ET.SubElement(link, "contact"), surface, damping)
    with replacing_with_meshes(path, [(name, scene.object[name])]) as file:
        file.write(document(root))
    return tuple(_left_out(scene, name, body, where, surface))


def _chosen(scene: Scene, name: str | None) -> tuple[str, Body]:
    moving = scene.moving()
    allowed = ", ".join(moving) or "a scene in which something moves"
    if name is None and len(moving) != 1:
        raise InputError(f"{len(moving)} objects have a body, and a URDF is of one; allowed: {allowed}")
    name = moving[0] if name is None else name
    body = scene.object[name].body if name in scene.object else None
    if body is None:
        raise InputError(f"object is {name!r}, which is none that has a body; allowed: {allowed}")
    return name, body


def _felt(scene: Scene, name: str) -> tuple[str, Surface | None]:
    """The surface that is written, and its path."""
    surface = scene.object[name].surface
    if surface is not None:
        return f"object.{name}.surface", surface
    pairs = ((f"contact.{each}", pair) for each, pair in scene.contact.items() if name in pair.between)
    return next(pairs, ("", None))


def _inertial(link: ET.Element, body: Body, shape: Shape) -> None:
    inertial = ET.SubElement(link, "inertial")
    centre, inertia = centre_within(body, shape), np.asarray(inertia_of(body, shape))
    ET.SubElement(inertial, "origin", xyz=words((0, 0, 0) if centre is None else centre), rpy="0 0 0")
    ET.SubElement(inertial, "mass", value=words(body.mass))
    full = np.diag(inertia) if inertia.ndim == 1 else inertia
    places = {f"i{'xyz'[i]}{'xyz'[j]}": words(full[i, j]) for i in range(3) for j in range(i, 3)}
    ET.SubElement(inertial, "inertia", places)


def _form(geometry: ET.Element, shape: Shape, file: str) -> None:
    match shape:
        case Sphere():
            ET.SubElement(geometry, "sphere", radius=words(shape.radius))
        case Box():
            ET.SubElement(geometry, "box", size=words(shape.size))
        case Cylinder():
            ET.SubElement(geometry, "cylinder", radius=words(shape.radius), length=words(shape.length))
        case Capsule():
            ET.SubElement(geometry, "capsule", radius=words(shape.radius), length=words(shape.length))
        case _:
            ET.SubElement(geometry, "mesh", filename=file)


def _drake(properties: ET.Element, surface: Surface) -> None:
    kinetic = (
        one_mu(surface) if surface.mu_kinetic is None else float(np.mean(np.asarray(surface.mu_kinetic)))
    )
    numbers = {
        "point_contact_stiffness": surface.stiffness,
        "hunt_crossley_dissipation": 0.0 if surface.damping is None else surface.damping,
        "mu_static": one_mu(surface),
        "mu_dynamic": kinetic,
    }
    for name, value in numbers.items():
        ET.SubElement(properties, f"drake:{name}", value=words(value))


def _bullet(contact: ET.Element, surface: Surface, damping: float) -> None:
    numbers = {"lateral_friction": one_mu(surface), "stiffness": surface.stiffness, "damping": damping}
    for name, value in numbers.items():
        ET.SubElement(contact, name, value=words(value))


def _left_out(scene: Scene, name: str, body: Body, where: str, surface: Surface | None) -> Iterator[str]:
    yield from left_out_of_scene(scene, soft_fingers=False)
    if surface is not None:
        yield from left_out_of_surface(surface, where, kinetic=True)
    if not body.rotation:
        yield f"object.{name}.body.rotation is left out: a link turns"
    for each in scene.contact:
        if f"contact.{each}" != where:
            yield f"contact.{each} is left out: a URDF has no pairs of objects"
    for other in scene.object:
        if other != name:
            yield f"object.{other} is left out: a URDF is of one object"
