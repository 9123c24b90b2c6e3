"""How a grasp resists turning, chosen by the type of `Scene.torsion` and by `model` in a scene file."""

from ._torsion import Grip as Grip
from ._torsion import Held as Held
from ._torsion import Torsion as Torsion
from ._torsion import Twist as Twist
from ._torsion import lock as lock
from .gimbal import Gimbal as Gimbal
from .gravity_drop import GravityDrop as GravityDrop
from .soft_finger import SoftFinger as SoftFinger

MODELS: dict[str, type[Torsion]] = {
    "gravity_drop": GravityDrop,
    "gimbal": Gimbal,
    "soft_finger": SoftFinger,
}
