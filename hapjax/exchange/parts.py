"""What a body of a model is made of, and the object that it makes."""

import re
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from .. import mesh_file
from ..body import Body
from ..errors import InputError
from ..scene import Object
from ..shape import SHAPES, Convex, Mesh, Shape


class Pose(NamedTuple):
    """Where a frame is: position (m) of its origin and rotation matrix, in another frame."""

    position: np.ndarray
    matrix: np.ndarray

    def then(self, inner: "Pose") -> "Pose":
        """Where a frame is that is at `inner` in this one."""
        return Pose(self.position + self.matrix @ inner.position, self.matrix @ inner.matrix)

    def back(self) -> "Pose":
        """Where the other frame is in this one."""
        return Pose(-self.matrix.T @ self.position, self.matrix.T)


HERE = Pose(np.zeros(3), np.eye(3))


class Weight(NamedTuple):
    """Mass (kg), centre of mass (m) and inertia about it (3x3, kg m^2), in some frame."""

    mass: float
    centre: np.ndarray
    inertia: np.ndarray

    def at(self, pose: Pose) -> "Weight":
        """The same in the frame in which this one's frame is at a pose."""
        turned = pose.matrix @ self.inertia @ pose.matrix.T
        return Weight(self.mass, pose.position + pose.matrix @ self.centre, (turned + turned.T) / 2)


class Form(NamedTuple):
    """A shape at a place: its name and fields as in a scene file, and whether it is what collides."""

    shape: str
    fields: dict[str, Any]
    pose: Pose
    collides: bool


class Part(NamedTuple):
    """One body of a model, rigid as a whole: its forms, and what it weighs, in its own frame, and where it is."""

    name: str
    pose: Pose
    forms: list[Form]
    weight: Weight | float | None
    """A number: the mass of a body of uniform density. `None`: it is fixed in space."""


def together(weights: Sequence[Weight]) -> Weight:
    """Several weights in one frame as one (Huygens and Steiner)."""
    mass = sum(w.mass for w in weights)
    if mass == 0:
        return Weight(0.0, np.zeros(3), np.zeros((3, 3)))
    centre = sum((w.mass * w.centre for w in weights), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for each in weights:
        arm = each.centre - centre
        inertia += each.inertia + each.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return Weight(mass, centre, inertia)


def shape_of(form: Form, folder: Path, hull: bool) -> Shape:
    """The shape of a form, its mesh read from the model's folder; `hull`: its convex hull."""
    kind = SHAPES[form.shape]
    if issubclass(kind, Mesh):
        return mesh_file.shape_from_table(Convex if hull else kind, form.fields, folder)
    return kind(**form.fields)


def object_of(part: Part, folder: Path, hull: bool) -> Object:
    """The object that a part is, in the frame of its one shape."""
    form = _chosen(part.forms)
    shape = shape_of(form, folder, hull)
    pose = part.pose.then(form.pose)
    body = None
    if isinstance(part.weight, Weight):
        own = part.weight.at(form.pose.back())
        body = Body(own.mass, _principal(own.inertia), own.centre)
    elif part.weight is not None:
        body = Body(part.weight)
    return Object(shape, None, body, pose.position, _quaternion(pose.matrix))


def free_name(wanted: str, taken: Sequence[str]) -> str:
    """A name as objects have them, the nearest to the wanted one that is not taken."""
    name = re.sub(r"\W", "_", wanted, flags=re.ASCII) or "object"
    name = f"_{name}" if name[0].isdigit() else name
    number, found = 2, name
    while found in taken:
        number, found = number + 1, f"{name}_{number}"
    return found


def turn_of(wxyz: np.ndarray) -> np.ndarray:
    """The matrix of a quaternion of any length but 0."""
    from scipy.spatial.transform import Rotation  # here, since it takes a while to load

    if not np.any(wxyz):
        raise InputError("quat is 0 0 0 0; allowed: four numbers w x y z that are not all 0")
    return Rotation.from_quat(wxyz, scalar_first=True).as_matrix()


def _quaternion(matrix: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(matrix).as_quat(canonical=True, scalar_first=True)


def _chosen(forms: Sequence[Form]) -> Form:
    """What collides, if it is one; else what is seen, if it is one."""
    colliding = [form for form in forms if form.collides]
    seen = [form for form in forms if not form.collides]
    for few in (colliding, seen):
        if len(few) == 1:
            return few[0]
    if not forms:
        raise InputError("has no shape; allowed: a body with a shape")
    raise InputError(
        f"has {len(colliding)} shapes that collide and {len(seen)} that are only seen; "
        "allowed: one of either kind, since an object has one shape"
    )


def _principal(inertia: np.ndarray) -> np.ndarray:
    """The three moments where the axes are those of the frame, but for rounding; else the matrix."""
    beside = inertia - np.diag(np.diagonal(inertia))
    small = np.abs(beside).max() <= 1e-9 * np.abs(inertia).max()
    return np.diagonal(inertia).copy() if small else inertia
