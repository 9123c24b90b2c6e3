"""Multi-point haptic contact with friction: touch, hold, turn and identify virtual objects."""

from .body import Body as Body
from .contact import Contact as Contact
from .errors import InputError as InputError
from .grasp import GravityDrop as GravityDrop
from .integrate import SemiImplicit as SemiImplicit
from .integrate import SemiImplicitMatrix as SemiImplicitMatrix
from .packed import PackedStep as PackedStep
from .packed import pack as pack
from .prescribed import drag as drag
from .recording import Recording as Recording
from .scene import Object as Object
from .scene import Scene as Scene
from .scene import World as World
from .scene import cast as cast
from .scene_file import load_scene as load_scene
from .scene_file import save_scene as save_scene
from .shape import Box as Box
from .shape import Plane as Plane
from .shape import Sphere as Sphere
from .simulate import Reply as Reply
from .simulate import State as State
from .simulate import init as init
from .simulate import rollout as rollout
from .simulate import step as step
from .surface import Surface as Surface
