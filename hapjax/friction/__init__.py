"""Friction laws on the god-object's offset, chosen by the type of `Surface.friction`."""

from ._law import Friction as Friction
from ._law import Law as Law
from ._law import Press as Press
from .cone import Cone as Cone

LAWS: dict[str, type[Law]] = {"cone": Cone}
