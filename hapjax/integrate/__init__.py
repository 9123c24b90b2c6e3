"""Integrators, chosen by their type in a Scene and by `method` in a scene file."""

from ._bodies import Bodies as Bodies
from ._integrator import Integrator as Integrator
from .implicit import Implicit as Implicit
from .lie_midpoint import LieMidpoint as LieMidpoint
from .pivot import PivotForm as PivotForm
from .semi_implicit import SemiImplicit as SemiImplicit
from .semi_implicit_matrix import SemiImplicitMatrix as SemiImplicitMatrix

METHODS: dict[str, type[Integrator]] = {
    "semi_implicit": SemiImplicit,
    "semi_implicit_matrix": SemiImplicitMatrix,
    "pivot": PivotForm,
    "implicit": Implicit,
    "lie_midpoint": LieMidpoint,
}
