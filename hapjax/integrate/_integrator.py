"""What a Scene asks of an integrator."""

from abc import abstractmethod
from typing import ClassVar, TypeVar

import equinox as eqx
from jaxtyping import Array, Float

from .._validate import as_float, check_number, check_positive, count
from ..body import Body, Motion, Wrench
from ..shape import Shape
from ..torsion import Twist
from ._bodies import Bodies

Links = TypeVar("Links")


class Integrator(eqx.Module):
    """Advances a body under a wrench.

    **Arguments:** `dt`, the time step that `step` uses unless it is given another, in s, above 0 and at most 1;
    `substeps`, into how many a step is cut, 1 to 10,000.

    `needs_pivot`: `advance` is to be given a pivot. `looks_ahead`: `foresee` is to know how far points are from surfaces
    that they do not touch. `reads_middle`: forces are read in the middle of a step, so torsion is to be told the spin
    half a step on, and substeps where the fingers are in the middle of each.
    """

    needs_pivot: ClassVar[bool] = False
    looks_ahead: ClassVar[bool] = False
    reads_middle: ClassVar[bool] = False

    dt: Float[Array, ""] = eqx.field(converter=as_float, default=1e-3)
    substeps: int = eqx.field(static=True, converter=count("substeps", 10_000), default=1)

    def __check_init__(self):
        check_positive("dt", self.dt, unit="s")
        check_number("dt", self.dt, "above 0 and at most 1 s", high=1.0)

    def drift(
        self, body: Body, shape: Shape, motion: Motion, gyroscopic: bool, dt: Float[Array, ""]
    ) -> Motion:
        """Where a body is when the forces of a step of `dt` s are read: where it was, unless told otherwise."""
        return motion

    def foresee(
        self, links: Links, bodies: Bodies, dt: Float[Array, ""]
    ) -> tuple[Links, dict[str, Motion] | None]:
        """Touches as the laws are to read them: as they are, unless told otherwise.

        Also the objects with the velocities that these touches and gravity give them, where that is known; `advance` is
        then given what torsion changes of the wrenches, and nothing else.

        **Arguments:** `links`, a pytree of `Link`.
        """
        return links, None

    @abstractmethod
    def advance(
        self,
        body: Body,
        shape: Shape,
        motion: Motion,
        wrench: Wrench,
        gyroscopic: bool,
        twist: Twist | None,
        dt: Float[Array, ""],
        pivot: Float[Array, "3"] | None = None,
    ) -> Motion:
        """The motion after `dt` s under a wrench about the centre of mass; a locked `twist` axis keeps no spin of its own.

        **Arguments:** `pivot` (m, world frame), a point near the contacts, for an integrator that `needs_pivot`.
        """
