"""Geoms of MJCF: their attributes by class, their places, and what they look like."""

import xml.etree.ElementTree as ET
from collections.abc import Mapping
from pathlib import PurePosixPath
from typing import Any, NamedTuple

import numpy as np

from ..errors import InputError
from .markup import numbers
from .parts import Form, Pose, turn_of

_MAIN = "main"
_TURNS = ("quat", "axisangle", "euler", "xyaxes", "zaxis")
# What the compiler can do to what bodies weigh, and with what it leaves it as it is.
_UNCHANGED = {
    "coordinate": "local",
    "settotalmass": "-1",
    "boundmass": "0",
    "boundinertia": "0",
    "inertiagrouprange": "0 5",
}


class Settings(NamedTuple):
    """What a model says for all of its elements: the compiler's attributes, those of each class by tag, and the meshes."""

    compiler: dict[str, str]
    classes: dict[str, dict[str, dict[str, str]]]
    meshes: dict[str, dict[str, Any]]

    @classmethod
    def of(cls, root: ET.Element) -> "Settings":
        """The settings of a model."""
        compiler = {key: value for each in root.findall("compiler") for key, value in each.attrib.items()}
        for name, allowed in _UNCHANGED.items():
            if compiler.get(name, allowed) != allowed:
                raise InputError(f"compiler {name} is {compiler[name]!r}; allowed: {allowed}")
        settings = cls(compiler, {}, {})
        for top in root.findall("default"):
            settings._take(top, _MAIN, settings.classes.get(_MAIN, {}))
        for asset in root.findall("asset"):
            for element in asset.findall("mesh"):
                name, fields = settings._mesh(element)
                settings.meshes[name] = fields
        return settings

    def attributes(self, element: ET.Element, style: str | None) -> dict[str, str]:
        """The attributes of an element, with those of its class, or else of the `style` around it."""
        name = element.get("class", style) or _MAIN
        if name not in self.classes and name != _MAIN:
            raise InputError(f"class is {name!r}; allowed: {', '.join(self.classes) or 'none'}")
        return _over(self.classes.get(name, {}).get(element.tag, {}), element.attrib)

    def _take(self, default: ET.Element, name: str, above: Mapping[str, dict[str, str]]) -> None:
        """A class and those within it, which begin with what it has."""
        own = {tag: dict(given) for tag, given in above.items()}
        for element in default:
            if element.tag != "default":
                own[element.tag] = _over(own.get(element.tag, {}), element.attrib)
        self.classes[name] = own
        for inner in default.findall("default"):
            self._take(inner, inner.get("class", ""), own)

    def _mesh(self, element: ET.Element) -> tuple[str, dict[str, Any]]:
        """The name of a mesh and its fields as in a scene file."""
        given = self.attributes(element, None)
        file = given.get("file")
        name = given.get("name") or PurePosixPath(file or "").stem
        for other in ("refpos", "refquat", "builtin"):
            if other in given:
                raise InputError(f"mesh {name} has {other}; allowed: none")
        if given.get("inertia", "exact") not in ("exact", "legacy"):
            raise InputError(f"mesh {name} inertia is {given['inertia']!r}; allowed: exact, legacy")
        scale = numbers(given.get("scale", "1 1 1"), 3, f"mesh {name} scale")
        if np.ptp(scale) != 0:
            raise InputError(f"mesh {name} scale is {given['scale']!r}; allowed: the same along all axes")
        if file is None:
            points = numbers(given.get("vertex", ""), None, f"mesh {name} vertex")
            if len(points) % 3:
                raise InputError(f"mesh {name} vertex has {len(points)} numbers; allowed: three a vertex")
            return name, {"points": points.reshape(-1, 3), "scale": float(scale[0])}
        if self.compiler.get("strippath") == "true":
            file = PurePosixPath(file).name
        place = self.compiler.get("meshdir", self.compiler.get("assetdir", ""))
        return name, {"file": str(PurePosixPath(place) / file), "scale": float(scale[0])}


def _over(inherited: Mapping[str, str], own: Mapping[str, str]) -> dict[str, str]:
    """Attributes, with those that are inherited. Of the ways to say an orientation only the nearest counts."""
    turned = any(way in own for way in _TURNS)
    kept = {name: text for name, text in inherited.items() if not (turned and name in _TURNS)}
    return {**kept, **own}


def pose_of(given: Mapping[str, str], settings: Settings) -> Pose:
    """Where an element is in the frame around it."""
    return Pose(numbers(given.get("pos", "0 0 0"), 3, "pos"), _turn(given, settings))


def form_of(element: ET.Element, style: str | None, settings: Settings) -> Form:
    """What a geom looks like."""
    given = settings.attributes(element, style)
    kind = given.get("type", "sphere")
    collides = any(given.get(each, "1") != "0" for each in ("contype", "conaffinity"))
    if kind == "mesh":
        return Form(*_mesh_of(given, settings), pose_of(given, settings), collides)
    if "mesh" in given:
        raise InputError(f"geom is a {kind} fitted to a mesh; allowed: the mesh itself")
    if kind not in ("plane", "sphere", "box", "cylinder", "capsule"):
        raise InputError(f"geom type is {kind!r}; allowed: plane, sphere, box, cylinder, capsule, mesh")
    size = numbers(given.get("size", ""), None, "geom size")
    if "fromto" in given:
        return Form(*_between(kind, size, given), collides)
    return Form(kind, _fields(kind, size), pose_of(given, settings), collides)


def _mesh_of(given: Mapping[str, str], settings: Settings) -> tuple[str, dict[str, Any]]:
    name = given.get("mesh", "")
    if name not in settings.meshes:
        raise InputError(f"geom mesh is {name!r}; allowed: {', '.join(settings.meshes) or 'none'}")
    fields = settings.meshes[name]
    return "mesh" if "file" in fields else "convex", fields


def _fields(kind: str, size: np.ndarray) -> dict[str, Any]:
    """The fields of a shape as a scene file has them: full lengths."""
    if kind == "plane":
        return {}
    _enough(kind, size, {"sphere": 1, "box": 3, "cylinder": 2, "capsule": 2}[kind])
    if kind == "box":
        return {"size": 2 * size[:3]}
    return {"radius": size[0]} if kind == "sphere" else {"radius": size[0], "length": 2 * size[1]}


def _between(kind: str, size: np.ndarray, given: Mapping[str, str]) -> tuple[str, dict[str, Any], Pose]:
    """A shape that reaches from one point to another."""
    if kind not in ("box", "cylinder", "capsule"):
        raise InputError(f"geom fromto is given for a {kind}; allowed: box, cylinder, capsule")
    _enough(kind, size, 1)
    ends = numbers(given["fromto"], 6, "geom fromto").reshape(2, 3)
    along = ends[0] - ends[1]
    length = float(np.linalg.norm(along))
    if length == 0:
        raise InputError(f"geom fromto is {given['fromto']!r}; allowed: two points that are apart")
    pose = Pose(ends.mean(axis=0), _z_to(along))
    if kind == "box":
        return kind, {"size": np.array([2 * size[0], 2 * size[0], length])}, pose
    return kind, {"radius": size[0], "length": length}, pose


def _enough(kind: str, size: np.ndarray, count: int) -> None:
    if len(size) < count:
        raise InputError(f"geom size has {len(size)} numbers; allowed: {count} for a {kind}")


def _turn(given: Mapping[str, str], settings: Settings) -> np.ndarray:
    """The matrix of an orientation in any of MJCF's ways."""
    from scipy.spatial.transform import Rotation  # here, since it takes a while to load

    ways = [way for way in _TURNS if way in given]
    if len(ways) > 1:
        raise InputError(f"orientation is given as {' and '.join(ways)}; allowed: one of them")
    degrees = settings.compiler.get("angle", "degree") == "degree"
    if "axisangle" in given:
        *axis, angle = numbers(given["axisangle"], 4, "axisangle")
        vector = _unit(np.array(axis), "axisangle") * (np.deg2rad(angle) if degrees else angle)
        return Rotation.from_rotvec(vector).as_matrix()
    if "euler" in given:
        # SciPy writes turns about axes that turn along in capitals, MuJoCo those about fixed ones.
        order = settings.compiler.get("eulerseq", "xyz").swapcase()
        angles = numbers(given["euler"], 3, "euler")
        if len(order) != 3 or not set(order) <= set("xyz") and not set(order) <= set("XYZ"):
            raise InputError(f"compiler eulerseq is {order.swapcase()!r}; allowed: such as xyz or XYZ")
        return Rotation.from_euler(order, angles, degrees=degrees).as_matrix()
    if "xyaxes" in given:
        both = numbers(given["xyaxes"], 6, "xyaxes").reshape(2, 3)
        x = _unit(both[0], "xyaxes")
        y = _unit(both[1] - (both[1] @ x) * x, "xyaxes")
        return np.stack([x, y, np.cross(x, y)], axis=1)
    if "zaxis" in given:
        return _z_to(numbers(given["zaxis"], 3, "zaxis"))
    return turn_of(numbers(given.get("quat", "1 0 0 0"), 4, "quat"))


def _z_to(direction: np.ndarray) -> np.ndarray:
    """The least turn that takes z there."""
    z = _unit(direction, "zaxis")
    half = np.array([1 + z[2], -z[1], z[0], 0.0])
    return turn_of(half if z[2] > -1 else np.array([0.0, 1.0, 0.0, 0.0]))


def _unit(vector: np.ndarray, name: str) -> np.ndarray:
    length = np.linalg.norm(vector)
    if length == 0:
        raise InputError(f"{name} has the direction 0 0 0; allowed: any other")
    return vector / length
