"""Friction laws on the god-object's offset, chosen by the type of `Surface.friction`."""

from ._law import Friction as Friction
from ._law import Law as Law
from ._law import Press as Press
from .cone import Cone as Cone
from .dahl import Dahl as Dahl
from .karnopp import Karnopp as Karnopp
from .lugre import LuGre as LuGre
from .stribeck import Stribeck as Stribeck
from .viscous import Viscous as Viscous

LAWS: dict[str, type[Law]] = {
    "cone": Cone,
    "viscous": Viscous,
    "stribeck": Stribeck,
    "karnopp": Karnopp,
    "dahl": Dahl,
    "lugre": LuGre,
}
