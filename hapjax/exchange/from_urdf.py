"""URDF as parts: links that are fixed to each other are one."""

import xml.etree.ElementTree as ET

import numpy as np

from ..errors import InputError, within
from .markup import number, numbers
from .parts import HERE, Form, Part, Pose, Weight, together


def parts_of_urdf(root: ET.Element, name: str) -> list[Part]:
    """The one part of a robot that does not move within itself. `name`: where it has none."""
    links = {_named(link): link for link in root.iter("link") if link in list(root)}
    if not links:
        raise InputError("robot has no link; allowed: one or more")
    joints = {_child(joint, links): joint for joint in root.findall("joint")}
    tops = [each for each in links if each not in joints]
    if len(tops) != 1:
        raise InputError(f"robot has {len(tops)} links that hang on no joint; allowed: 1")
    forms: list[Form] = []
    weights: list[Weight] = []
    for each, link in links.items():
        pose = _pose_of(each, joints, links)
        with within(f"link {each}: "):
            found, weight = _link(link)
        forms += [form._replace(pose=pose.then(form.pose)) for form in found]
        weights += [] if weight is None else [weight.at(pose)]
    weight = together(weights) if weights else None
    return [Part(root.get("name") or name, HERE, forms, weight)]


def _named(link: ET.Element) -> str:
    return _attribute(link, "name")


def _child(joint: ET.Element, links: dict[str, ET.Element]) -> str:
    """The link that a joint holds. **Raises:** `InputError` where the joint moves."""
    name, kind = joint.get("name", ""), joint.get("type")
    if kind != "fixed":
        raise InputError(
            f"joint {name} is {kind!r}; allowed: fixed, since an object does not move within itself"
        )
    ends = [_attribute(_only(joint, end), "link") for end in ("parent", "child")]
    for end in ends:
        if end not in links:
            raise InputError(f"joint {name} names the link {end!r}; allowed: {', '.join(links)}")
    return ends[1]


def _pose_of(link: str, joints: dict[str, ET.Element], links: dict[str, ET.Element]) -> Pose:
    """Where a link is in the frame of the robot."""
    pose = HERE
    for _ in links:
        if link not in joints:
            return pose
        joint = joints[link]
        with within(f"joint {joint.get('name', '')}: "):
            pose = _origin(joint).then(pose)
        link = _attribute(_only(joint, "parent"), "link")
    raise InputError(f"link {link} hangs on itself; allowed: a tree of links")


def _link(link: ET.Element) -> tuple[list[Form], Weight | None]:
    forms = []
    for kind in ("visual", "collision"):
        for part in link.findall(kind):
            forms.append(_form(_only(part, "geometry"), _origin(part), kind == "collision"))
    inertial = link.find("inertial")
    return forms, None if inertial is None else _weight(inertial)


def _form(geometry: ET.Element, pose: Pose, collides: bool) -> Form:
    for kind in ("box", "sphere", "cylinder", "capsule", "mesh"):
        found = geometry.find(kind)
        if found is not None:
            return Form(kind, _fields(found, kind), pose, collides)
    given = ", ".join(child.tag for child in geometry) or "nothing"
    raise InputError(f"geometry is {given}; allowed: box, sphere, cylinder, capsule, mesh")


def _fields(found: ET.Element, kind: str) -> dict:
    if kind == "box":
        return {"size": numbers(_attribute(found, "size"), 3, "box size")}
    if kind == "mesh":
        scale = numbers(found.get("scale", "1 1 1"), 3, "mesh scale")
        if np.ptp(scale) != 0:
            raise InputError(f"mesh scale is {found.get('scale')!r}; allowed: the same along all axes")
        return {"file": _attribute(found, "filename"), "scale": float(scale[0])}
    names = ("radius",) if kind == "sphere" else ("radius", "length")
    return {name: number(_attribute(found, name), f"{kind} {name}") for name in names}


def _weight(inertial: ET.Element) -> Weight:
    pose, inertia = _origin(inertial), _only(inertial, "inertia")
    mass = number(_attribute(_only(inertial, "mass"), "value"), "mass")
    full = np.empty((3, 3))
    for i in range(3):
        for j in range(i, 3):
            name = f"i{'xyz'[i]}{'xyz'[j]}"
            full[i, j] = full[j, i] = number(_attribute(inertia, name), f"inertia {name}")
    return Weight(mass, np.zeros(3), full).at(pose)


def _origin(element: ET.Element) -> Pose:
    """The `origin` in an element; roll, pitch and yaw are turns about fixed axes."""
    from scipy.spatial.transform import Rotation  # here, since it takes a while to load

    origin = element.find("origin")
    if origin is None:
        return HERE
    angles = numbers(origin.get("rpy", "0 0 0"), 3, "origin rpy")
    place = numbers(origin.get("xyz", "0 0 0"), 3, "origin xyz")
    return Pose(place, Rotation.from_euler("xyz", angles).as_matrix())


def _only(element: ET.Element, tag: str) -> ET.Element:
    found = element.find(tag)
    if found is None:
        raise InputError(f"{element.tag} has no {tag}; allowed: one")
    return found


def _attribute(element: ET.Element, name: str) -> str:
    if name not in element.attrib:
        raise InputError(f"{element.tag} has no {name}; allowed: a {element.tag} that gives it")
    return element.attrib[name]
