"""The cases of the work-precision diagrams, each with its truth."""

from ._case import Case as Case
from ._case import Mujoco as Mujoco
from ._case import Order as Order
from .ball import BOUNCE, RESTITUTION, SINK, SLIDE_TO_ROLL
from .disc import DISC
from .lift import HOLD, LOAD_STEP, SLIP
from .rod import PENDULUM, ROD
from .sliding import DIAGONAL, INCLINE_HOLD, INCLINE_SLIDE, SLIDE
from .tip import TIP, TIP_REST
from .top import HEAVY_TOP, TOP

CASES: dict[str, Case] = {
    case.name: case
    for case in (
        TOP,
        HEAVY_TOP,
        ROD,
        SLIDE,
        INCLINE_HOLD,
        INCLINE_SLIDE,
        SLIDE_TO_ROLL,
        RESTITUTION,
        BOUNCE,
        SINK,
        DIAGONAL,
        SLIP,
        HOLD,
        DISC,
        TIP,
        TIP_REST,
        LOAD_STEP,
        PENDULUM,
    )
}
