"""What a touch tells a friction law, and what the law answers."""

from abc import abstractmethod
from collections.abc import Callable
from typing import ClassVar

import equinox as eqx
from jaxtyping import Array, Float


class Press(eqx.Module):
    """A point pressed onto a surface, all in the surface's frame.

    - `offset` (m): the god-object from the surface point, in the tangent plane, before the law has moved it.
    - `stiffness` (N/m): of the tangential spring between the two.
    - `normal_force` (N), 0 or above.
    - `viscous` (N): the tangential force of the contact's own damping. `None`: none.
    - `travel` (m): the point's tangential way over the surface in this step. `None` where the law does not need it.
    - `sliding`: what the law remembered of the last step. `None`: nothing.
    - `rounding` (m): differences of positions up to this are errors of arithmetic.
    - `dt` (s): the step.
    - `static`, `kinetic`: mu of breaking away and of sliding on in the direction of a vector of the tangent plane, which
      need not be of unit length; `kinetic` is `None` where it is no number of its own.
    """

    offset: Float[Array, "3"]
    stiffness: Float[Array, ""]
    normal_force: Float[Array, ""]
    viscous: Float[Array, "3"] | None
    travel: Float[Array, "3"] | None
    sliding: Float[Array, ""] | None
    rounding: Float[Array, ""]
    dt: Float[Array, ""] | None
    static: Callable[[Float[Array, "3"]], Float[Array, ""]]
    kinetic: Callable[[Float[Array, "3"]], Float[Array, ""]] | None


class Friction(eqx.Module):
    """What a law answers: the offset after it (m), the tangential force (N), and what it remembers."""

    offset: Float[Array, "3"]
    force: Float[Array, "3"]
    sliding: Float[Array, ""] | None


class Law(eqx.Module):
    """A friction law. Its numbers are leaves; mu and the stiffness are the surface's.

    `needs_travel`: it reads `Press.travel`; `needs_dt`: it reads `Press.dt`.
    """

    needs_travel: ClassVar[bool] = False
    needs_dt: ClassVar[bool] = False

    @abstractmethod
    def remembers(self, has_kinetic: bool) -> bool:
        """Whether it keeps a number from step to step, on a surface with or without a mu of sliding of its own."""

    @abstractmethod
    def hold(self, press: Press) -> Friction:
        """The friction of one step."""

    def check(self, has_kinetic: bool) -> None:  # noqa: B027  most laws take either kind of mu
        """Refuse a surface whose mu the law cannot use, with an `InputError`."""
