"""Scenes as MJCF, for MuJoCo."""

import math
import os
import xml.etree.ElementTree as ET
from collections.abc import Iterator

import numpy as np

from ..body import Body, centre_within, inertia_of
from ..contact import Contact
from ..errors import InputError
from ..scene import Object, Scene
from ..shape import Box, Capsule, Cylinder, Mesh, Plane, Shape, Sphere
from ..surface import Surface
from ..torsion import SoftFinger
from .left_out import left_out_of_scene, left_out_of_surface
from .markup import document, model_path, words
from .softness import (
    IMPEDANCE,
    LEAST_DAMPING,
    friction_damping,
    geom_impedance,
    linear_damping,
    mujoco_solref,
    one_mu,
)
from .wavefront import mesh_name, replacing_with_meshes

# Of a contact in a time step, whose spring and damper MuJoCo takes at its beginning: rad of its swing, and how much of its
# speed a point loses. A body on many points, or on points far out, has up to twenty times the latter.
_SWING, _LOSS = 0.2, 0.1


def save_mjcf(scene: Scene, path: str | os.PathLike[str]) -> tuple[str, ...]:
    """Write a scene as MJCF, meshes as OBJ files beside it; whole or not at all.

    A contact becomes a `pair`; what is not named in one passes through, as in the scene. A surface becomes the geom's own
    friction and softness, which win over those of whatever else is put into the model. Stiffness is mapped by
    `K = (1 - d) k A`, damping by `B = c (g + 4 v w / (3 pi))`, as `solref="-K -B"`, where A = 1/m1 + 1/m2, w^2 = k A,
    v = 0.1 m/s and c is at least 0.5 s/m. The impedance d is 0.001 in a pair and 2 B dt in a geom; mu is MuJoCo's sliding
    friction on an elliptic cone, which halves what slips in each time step.

    **Arguments:** `path`: a file ending in `.xml`.

    **Returns:** what of the scene MJCF has no word for, a sentence each. They stand in the file, too, as comments.

    **Raises:** `InputError` where a file cannot be written, or an object is named `world`, as MuJoCo's own body is.
    """
    path = model_path(path, ".xml")
    if "world" in scene.object:
        raise InputError("object is named 'world', as MuJoCo's own body is; allowed: any other name")
    root, step, left_out = ET.Element("mujoco", model=path.stem), _time_step(scene), tuple(_left_out(scene))
    root.extend(ET.Comment(f" {sentence} ") for sentence in left_out)
    _options(root, scene, step)
    meshes = [name for name, thing in scene.object.items() if isinstance(thing.shape, Mesh)]
    if meshes:
        assets = ET.SubElement(root, "asset")
        for name in meshes:
            ET.SubElement(assets, "mesh", name=name, file=mesh_name(path, name))
    world = ET.SubElement(root, "worldbody")
    for name, thing in scene.object.items():
        _body(world, scene, name, thing, step)
    if scene.contact:
        _pairs(ET.SubElement(root, "contact"), scene, step)
    with replacing_with_meshes(path, scene.object.items()) as file:
        file.write(document(root))
    return left_out


def _touches(scene: Scene) -> Iterator[tuple[str, Surface, float]]:
    """What is soft in the model: its path, itself, and how far a unit of force moves what meets there (1/kg)."""
    for name, thing in scene.object.items():
        if thing.surface is not None and thing.body is not None:
            yield f"object.{name}.surface", thing.surface, 1 / float(thing.body.mass)
    for name, pair in scene.contact.items():
        yield f"contact.{name}", pair, _mobility(scene, pair)


def _mobility(scene: Scene, pair: Contact) -> float:
    bodies = [scene.object[name].body for name in pair.between]
    return sum(1 / float(body.mass) for body in bodies if body is not None)


def _damping(scene: Scene, surface: Surface, mobility: float) -> float:
    return linear_damping(surface, mobility, scene.world, LEAST_DAMPING)


def _time_step(scene: Scene) -> float:
    """The scene's own time step (s), or a shorter one that its contacts need."""
    step = float(scene.integrator.dt) / scene.integrator.substeps
    for _, surface, mobility in _touches(scene):
        swing = math.sqrt(float(surface.stiffness) * mobility)
        step = min(step, _SWING / swing, _LOSS / _damping(scene, surface, mobility))
    return step


def _options(root: ET.Element, scene: Scene, step: float) -> None:
    gravity = (0, 0, 0) if scene.world.gravity is None else scene.world.gravity
    # Friction in MuJoCo is a damper, which creeps: by the share (1 - d) / (d impratio) of what pulls, in two time steps.
    given = {"gravity": words(gravity), "timestep": words(step)}
    ET.SubElement(root, "option", given, cone="elliptic", impratio="10000000")


def _body(world: ET.Element, scene: Scene, name: str, thing: Object, step: float) -> None:
    turn = np.asarray(thing.orientation, np.float64)
    place = {"pos": words(thing.position), "quat": words(turn / np.linalg.norm(turn))}
    body = ET.SubElement(world, "body", {"name": name, **place})
    if thing.body is not None:
        _joints(body, name, thing.body)
        _inertial(body, thing.body, thing.shape)
    # Geoms with the conaffinity 1 and no contype touch what a user puts in, whose contype is 1 too, and not each other.
    touched = {"contype": "0", "conaffinity": "0" if thing.surface is None else "1"}
    friction = {} if thing.surface is None else _friction(scene, thing.surface, thing.body, step)
    ET.SubElement(body, "geom", {"name": name, **_form(thing.shape, name), **touched, **friction})


def _joints(body: ET.Element, name: str, moving: Body) -> None:
    if moving.rotation:
        ET.SubElement(body, "freejoint", name=name)
        return
    for axis, way in zip("xyz", ("1 0 0", "0 1 0", "0 0 1"), strict=True):
        # With a dot, since no object has one in its name.
        ET.SubElement(body, "joint", name=f"{name}.{axis}", type="slide", axis=way)


def _inertial(body: ET.Element, moving: Body, shape: Shape) -> None:
    centre, inertia = centre_within(moving, shape), np.asarray(inertia_of(moving, shape))
    about: dict[str, str] = {"pos": words((0, 0, 0) if centre is None else centre)}
    if inertia.ndim == 1:
        about["diaginertia"] = words(inertia)
    else:
        about["fullinertia"] = words(np.diagonal(inertia), inertia[0, 1:], inertia[1, 2])
    ET.SubElement(body, "inertial", {"mass": words(moving.mass), **about})


def _form(shape: Shape, name: str) -> dict[str, str]:
    """Type and size of a geom: half of the edges and of the length."""
    match shape:
        case Plane():
            return {"type": "plane", "size": "0 0 1"}  # without end
        case Sphere():
            return {"type": "sphere", "size": words(shape.radius)}
        case Box():
            return {"type": "box", "size": words(shape.size / 2)}
        case Cylinder() | Capsule():
            kind = "cylinder" if isinstance(shape, Cylinder) else "capsule"
            return {"type": kind, "size": words(shape.radius, shape.length / 2)}
    return {"type": "mesh", "mesh": name}


def _friction(scene: Scene, surface: Surface, body: Body | None, step: float) -> dict[str, str]:
    """What the geom of an object gives to any contact with what is not in the scene, taken as fixed or far heavier."""
    twist = scene.torsion.torsional_mu if isinstance(scene.torsion, SoftFinger) else None
    mu, dimensions = one_mu(surface), "3" if twist is None else "4"
    given = {
        "priority": "1",
        "condim": dimensions,
        "friction": words(mu, 0.0 if twist is None else twist, 0.0),
    }
    if body is None:
        return given
    damping = _damping(scene, surface, 1 / float(body.mass))
    return given | _softness(surface, 1 / float(body.mass), damping, geom_impedance(damping, step))


def _softness(surface: Surface, mobility: float, damping: float, impedance: float) -> dict[str, str]:
    solref = mujoco_solref(float(surface.stiffness), mobility, damping, impedance)
    return {"solref": words(solref), "solimp": words(impedance, impedance, 1.0, 0.5, 1.0)}


def _pairs(contact: ET.Element, scene: Scene, step: float) -> None:
    for name, pair in scene.contact.items():
        first, second = pair.between
        mobility, mu = _mobility(scene, pair), one_mu(pair)
        given = {"name": name, "geom1": first, "geom2": second, "condim": "3"}
        given["friction"] = words(mu, mu, 0.0, 0.0, 0.0)
        given |= _softness(pair, mobility, _damping(scene, pair, mobility), IMPEDANCE)
        given["solreffriction"] = words(0.0, -friction_damping(IMPEDANCE, step))
        ET.SubElement(contact, "pair", given)


def _left_out(scene: Scene):
    yield from left_out_of_scene(scene, soft_fingers=True)
    for name, thing in scene.object.items():
        if isinstance(thing.shape, Mesh) and thing.shape.is_hollow:
            yield f"object.{name}.shape bends inward somewhere: MuJoCo's contacts are with its convex hull"
        if thing.surface is None:
            continue
        yield from left_out_of_surface(thing.surface, f"object.{name}.surface", kinetic=False)
        if thing.body is None:
            path = f"object.{name}.surface.stiffness"
            yield f"{path} is left out: MuJoCo's depends on the mass of what touches a fixed object"
    for name, pair in scene.contact.items():
        yield from left_out_of_surface(pair, f"contact.{name}", kinetic=False)
    for path, surface, _ in _touches(scene):
        if surface.damping is None or float(surface.damping) < LEAST_DAMPING:
            given = "none" if surface.damping is None else f"{float(surface.damping):g} s/m"
            yield f"{path}.damping is {given}, with which little rests there: {LEAST_DAMPING} s/m is written"
