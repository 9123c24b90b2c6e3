"""MJCF as parts: what stands in the world's body, and each body in it."""

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from ..errors import InputError, within
from .markup import number, numbers
from .mjcf_geom import Settings, form_of, pose_of
from .parts import HERE, Form, Part, Pose, Weight, shape_of, together

_DENSITY = 1000.0  # kg/m^3, MuJoCo's
_IGNORED = ("site", "camera", "light")


class _Geom(NamedTuple):
    """A form, its density (kg/m^3) or, where it is given, its mass (kg), and whether either is said of itself.

    `shell`: it weighs something at its surface alone.
    """

    form: Form
    mass: float | None
    density: float
    said: bool
    shell: bool

    def weighs(self) -> bool:
        """Whether it weighs something."""
        return (self.density if self.mass is None else self.mass) > 0


class _Found(NamedTuple):
    """What is fixed to one body, in its frame. Geoms whose weight is given beside them weigh nothing themselves."""

    geoms: list[_Geom]
    weights: list[Weight]
    joints: list[ET.Element]


def gravity_of_mjcf(root: ET.Element) -> np.ndarray:
    """Gravity, m/s^2."""
    text = "0 0 -9.81"
    for option in root.findall("option"):  # what is said last counts
        text = option.get("gravity", text)
    gravity = numbers(text, 3, "option gravity")
    flags = [flag.attrib["gravity"] for flag in root.iterfind("option/flag") if "gravity" in flag.attrib]
    return np.zeros(3) if flags and flags[-1] == "disable" else gravity


def parts_of_mjcf(root: ET.Element, folder: Path, hull: bool) -> list[Part]:
    """The parts of a model whose meshes are in a folder."""
    for element in root.iter("include"):
        raise InputError(f"includes {element.get('file')!r}; allowed: a model in one file")
    settings, parts = Settings.of(root), list[Part]()
    for world in root.findall("worldbody"):
        for kind, element, pose, style in _children(world, HERE, None, settings):
            name = element.get("name") or kind
            with within(f"{kind} {name}: "):
                if kind == "geom":
                    form = form_of(element, style, settings)
                    parts.append(Part(name, pose, [form], None))
                elif kind == "body":
                    found = _Found([], [], [])
                    _gather(element, HERE, style, settings, found)
                    forms, weight = [geom.form for geom in found.geoms], _weight(found, folder, hull)
                    parts.append(Part(name, pose.then(pose_of(element.attrib, settings)), forms, weight))
                else:
                    raise InputError("is in no body; allowed: geoms and bodies in the worldbody")
    if not parts:
        raise InputError("has no body; allowed: a model with one in its worldbody")
    return parts


def _children(
    body: ET.Element, pose: Pose, style: str | None, settings: Settings
) -> Iterator[tuple[str, ET.Element, Pose, str | None]]:
    """What is in a body, also within frames: its tag, itself, where its frame is, and the class of what has none."""
    style = body.get("childclass", style)
    for element in body:
        if element.tag == "frame":
            yield from _children(element, pose.then(pose_of(element.attrib, settings)), style, settings)
        elif element.tag in ("geom", "body", "inertial", "joint", "freejoint"):
            yield element.tag, element, pose, style
        elif element.tag not in _IGNORED:
            allowed = ", ".join(("geom", "body", "frame", "inertial", "freejoint", *_IGNORED))
            raise InputError(f"{body.tag} has a {element.tag}; allowed: {allowed}")


def _gather(body: ET.Element, pose: Pose, style: str | None, settings: Settings, found: _Found) -> None:
    """Take in a body that is at a pose, and the bodies that are fixed to it."""
    if number(body.get("gravcomp", "0"), "gravcomp") != 0:
        raise InputError(
            f"gravcomp is {body.get('gravcomp')!r}; allowed: 0, since gravity pulls at all there is"
        )
    geoms, weights = list[_Geom](), list[Weight]()
    for kind, element, place, own in _children(body, pose, style, settings):
        if kind == "body":
            joints = len(found.joints)
            inner = place.then(pose_of(element.attrib, settings))
            with within(f"body {element.get('name') or kind}: "):
                _gather(element, inner, own, settings, found)
                if len(found.joints) > joints:
                    raise InputError("moves in another body; allowed: bodies of the worldbody move")
        elif kind == "geom":
            geoms.append(_geom(element, place, own, settings))
        elif kind == "inertial":
            weights.append(_inertial(element, settings).at(place))
        else:
            type_ = "free" if kind == "freejoint" else settings.attributes(element, own).get("type", "hinge")
            if type_ != "free":
                raise InputError(f"has a joint that is {type_}; allowed: free, or none")
            found.joints.append(element)
    from_geoms = settings.compiler.get("inertiafromgeom", "auto")
    weigh = any(geom.weighs() for geom in geoms)
    if from_geoms == "false" or (weights and not (from_geoms == "true" and weigh)):
        found.weights.extend(weights)
        geoms = [geom._replace(mass=0.0, said=False) for geom in geoms]
    found.geoms.extend(geoms)


def _geom(element: ET.Element, place: Pose, style: str | None, settings: Settings) -> _Geom:
    """A geom of a body that is at a place."""
    given = settings.attributes(element, style)
    mass = number(given["mass"], "geom mass") if "mass" in given else None
    density = number(given["density"], "geom density") if "density" in given else _DENSITY
    if density < 0 or (mass or 0) < 0:
        raise InputError(f"geom weighs {density if mass is None else mass}; allowed: 0 or above")
    form = form_of(element, style, settings)
    said = "mass" in element.attrib or "density" in element.attrib
    shell = given.get("shellinertia") == "true"
    return _Geom(form._replace(pose=place.then(form.pose)), mass, density, said, shell)


def _inertial(element: ET.Element, settings: Settings) -> Weight:
    pose = pose_of(element.attrib, settings)
    mass = number(element.get("mass", ""), "inertial mass")
    if "fullinertia" in element.attrib:
        xx, yy, zz, xy, xz, yz = numbers(element.attrib["fullinertia"], 6, "fullinertia")
        inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    else:
        inertia = np.diag(numbers(element.get("diaginertia", ""), 3, "diaginertia"))
    return Weight(mass, np.zeros(3), inertia).at(pose)


def _weight(found: _Found, folder: Path, hull: bool) -> Weight | float | None:
    """What a body weighs, if it is free, or if the file says anything of it."""
    if not (found.weights or found.joints or any(geom.said for geom in found.geoms)):
        return None
    weights = [_weight_of(geom, folder, hull) for geom in found.geoms]
    uniform = len(weights) == 1 and not found.weights
    return weights[0].mass if uniform else together([*found.weights, *weights])


def _weight_of(geom: _Geom, folder: Path, hull: bool) -> Weight:
    """The weight of a geom of uniform density, in the frame of its body."""
    if not geom.weighs():
        return Weight(0.0, np.zeros(3), np.zeros((3, 3)))
    if geom.shell:
        raise InputError("has a geom with shellinertia; allowed: one that weighs something all through")
    shape = shape_of(geom.form, folder, hull)
    volume, centre, per_mass = shape.volume(), shape.centre(), shape.inertia_per_mass()
    if volume is None or per_mass is None:
        raise InputError(f"has a {geom.form.shape} that weighs something; allowed: one that is fixed")
    mass = geom.density * float(volume) if geom.mass is None else geom.mass
    about = np.asarray(per_mass, float)
    inertia = mass * (np.diag(about) if about.ndim == 1 else about)
    return Weight(mass, np.zeros(3) if centre is None else np.asarray(centre, float), inertia).at(
        geom.form.pose
    )
