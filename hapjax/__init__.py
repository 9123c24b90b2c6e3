"""Multi-point haptic contact with friction: touch, hold, turn and identify virtual objects."""

from importlib import import_module
from typing import TYPE_CHECKING

from .at_once import compute_at_once as compute_at_once
from .body import Body as Body
from .contact import Contact as Contact
from .errors import InputError as InputError
from .friction import Cone as Cone
from .friction import Dahl as Dahl
from .friction import Karnopp as Karnopp
from .friction import LuGre as LuGre
from .friction import Stribeck as Stribeck
from .friction import Viscous as Viscous
from .integrate import Implicit as Implicit
from .integrate import LieMidpoint as LieMidpoint
from .integrate import PivotForm as PivotForm
from .integrate import SemiImplicit as SemiImplicit
from .integrate import SemiImplicitMatrix as SemiImplicitMatrix
from .packed import PackedStep as PackedStep
from .packed import pack as pack
from .prescribed import drag as drag
from .scene import Object as Object
from .scene import Scene as Scene
from .scene import World as World
from .scene import cast as cast
from .shape import Box as Box
from .shape import Capsule as Capsule
from .shape import Convex as Convex
from .shape import Cylinder as Cylinder
from .shape import Mesh as Mesh
from .shape import Plane as Plane
from .shape import Sphere as Sphere
from .simulate import Reply as Reply
from .simulate import State as State
from .simulate import init as init
from .simulate import rollout as rollout
from .simulate import step as step
from .surface import Surface as Surface
from .torsion import Gimbal as Gimbal
from .torsion import GravityDrop as GravityDrop
from .torsion import SoftFinger as SoftFinger

if TYPE_CHECKING:
    from .exchange import load_model as load_model
    from .exchange import save_mjcf as save_mjcf
    from .exchange import save_urdf as save_urdf
    from .mesh_file import load_mesh as load_mesh
    from .recording import Finding as Finding
    from .recording import Recording as Recording
    from .recording import load_recording as load_recording
    from .scene_file import load_scene as load_scene
    from .scene_file import save_scene as save_scene

# Files are read and written by those who ask for it: a step needs none of this.
_LATER = {
    "load_model": "exchange",
    "save_mjcf": "exchange",
    "save_urdf": "exchange",
    "load_mesh": "mesh_file",
    "Finding": "recording",
    "Recording": "recording",
    "load_recording": "recording",
    "load_scene": "scene_file",
    "save_scene": "scene_file",
}


def __getattr__(name: str) -> object:
    if name not in _LATER:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f".{_LATER[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *_LATER})
