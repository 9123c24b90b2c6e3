"""Shapes: closest surface point, outward normal, depth and face of any query point."""

from ._shape import BORDER as BORDER
from ._shape import Axis as Axis
from ._shape import Corner as Corner
from ._shape import Edges as Edges
from ._shape import Rims as Rims
from ._shape import Shape as Shape
from ._shape import SurfacePoint as SurfacePoint
from ._shape import Track as Track
from .box import Box as Box
from .capsule import Capsule as Capsule
from .convex import Convex as Convex
from .cylinder import Cylinder as Cylinder
from .mesh import CONTACT_POINTS as CONTACT_POINTS
from .mesh import Mesh as Mesh
from .mesh import room_for as room_for
from .plane import Plane as Plane
from .sphere import Sphere as Sphere

SHAPES: dict[str, type[Shape]] = {
    "plane": Plane,
    "sphere": Sphere,
    "box": Box,
    "cylinder": Cylinder,
    "capsule": Capsule,
    "convex": Convex,
    "mesh": Mesh,
}
