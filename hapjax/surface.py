"""What a touch on a surface is made of: friction, stiffness, damping."""

from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int

from ._validate import as_float, check_not_negative, check_number, check_positive, is_traced
from .errors import InputError


class Surface(eqx.Module):
    """What a finger feels of an object, or two objects of each other.

    **Arguments:**

    - `stiffness`: N/m, above 0.
    - `mu`: Coulomb friction, 0 or above: one number, or one a face in the order of the shape's `faces`.
    - `mu_static`, `mu_kinetic`: instead of `mu`, where breaking away takes more than sliding on; the static one is
      the larger.
    - `damping`: Hunt-Crossley loss c in s/m, 0 or above. `None`: none, and no arithmetic for it.

    **Raises:** `InputError` where a number is out of its range, or neither or both kinds of mu are given.
    """

    stiffness: Float[Array, ""] = eqx.field(converter=as_float)
    mu: Float[Array, "*faces"] | None = eqx.field(converter=as_float, default=None)
    mu_static: Float[Array, "*faces"] | None = eqx.field(converter=as_float, default=None)
    mu_kinetic: Float[Array, "*faces"] | None = eqx.field(converter=as_float, default=None)
    damping: Float[Array, ""] | None = eqx.field(converter=as_float, default=None)

    def __check_init__(self):
        check_positive("stiffness", self.stiffness, unit="N/m")
        if self.damping is not None:
            check_not_negative("damping", self.damping, unit="s/m")
        names = [n for n in ("mu", "mu_static", "mu_kinetic") if getattr(self, n) is not None]
        if names not in (["mu"], ["mu_static", "mu_kinetic"]):
            given = f"{' and '.join(names)} given" if names else "mu is missing"
            raise InputError(f"{given}; allowed: mu alone, or mu_static with mu_kinetic")
        for name in names:
            value = getattr(self, name)
            shape = getattr(value, "shape", ())
            check_not_negative(name, value, shape=shape if len(shape) <= 1 else (), unit="")
        _check_order(self.mu_static, self.mu_kinetic)

    def check_faces(self, faces: tuple[str, ...]) -> None:
        """Refuse a list of mu whose length is not the number of the shape's faces."""
        for name in ("mu", "mu_static", "mu_kinetic"):
            value = getattr(self, name)
            if value is not None and value.ndim == 1:
                check_number(
                    name,
                    value,
                    f"one number, or one for each of the faces {', '.join(faces)}",
                    shape=(len(faces),),
                )

    def static_at(self, face: Int[Array, ""]) -> Float[Array, ""]:
        """The mu of breaking away on a face."""
        return _of_face(self.mu if self.mu_static is None else self.mu_static, face)

    def kinetic_at(self, face: Int[Array, ""]) -> Float[Array, ""] | None:
        """The mu of sliding on a face where it is a number of its own."""
        return None if self.mu_kinetic is None else _of_face(self.mu_kinetic, face)


def _of_face(mu: Any, face: Int[Array, ""]) -> Float[Array, ""]:
    return mu[face] if mu.ndim == 1 else mu


def _check_order(static: Any, kinetic: Any) -> None:
    if static is None or is_traced(static) or is_traced(kinetic):
        return
    if static.shape != kinetic.shape:
        raise InputError(
            f"mu_static has shape {static.shape} and mu_kinetic {kinetic.shape}; "
            "allowed: both one number, or both one a face"
        )
    if np.any(np.asarray(kinetic) > np.asarray(static)):
        raise InputError(
            f"mu_kinetic is {np.asarray(kinetic).tolist()} and mu_static {np.asarray(static).tolist()}; "
            "allowed: mu_kinetic at most mu_static"
        )
