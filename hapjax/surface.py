"""What a touch on a surface is made of: friction, stiffness, damping."""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from . import safe
from ._validate import as_float, check_not_negative, check_number, check_positive, is_traced
from .errors import InputError, within
from .friction import Cone, Friction, Law, Press
from .shape import SurfacePoint

_MUS = ("mu", "mu_static", "mu_kinetic")


class Surface(eqx.Module):
    """What a finger feels of an object, or two objects of each other.

    **Arguments:**

    - `stiffness`: N/m, above 0.
    - `mu`: Coulomb friction, 0 or above: one number, or one a face in the order of the shape's `faces`.
    - `mu_static`, `mu_kinetic`: instead of `mu`, where breaking away takes more than sliding on; the static one is
      the larger.
    - `damping`: Hunt-Crossley loss c in s/m, 0 or above. `None`: none, and no arithmetic for it.
    - `tangential_stiffness`: N/m, above 0, of the spring that friction stretches. `None`: `stiffness`.
    - `anisotropy`: mu across the grain over mu along it, above 0. `None`: mu is the same in all directions.
    - `grain`: the direction of the grain, in the object's frame, for a surface with `anisotropy`; a face has that of its
      projection. A face that it is normal to has mu across the grain in all directions.
    - `friction`: the law. `None`: the cone.
    - `finger_mu`: one factor a finger, 0 or above, by which every mu of the surface is larger for it. `None`: all fingers
      feel the same.

    **Raises:** `InputError` where a number is out of its range, or neither or both kinds of mu are given.
    """

    stiffness: Float[Array, ""] = eqx.field(converter=as_float)
    mu: Float[Array, "*faces"] | None = eqx.field(converter=as_float, default=None)
    mu_static: Float[Array, "*faces"] | None = eqx.field(converter=as_float, default=None)
    mu_kinetic: Float[Array, "*faces"] | None = eqx.field(converter=as_float, default=None)
    damping: Float[Array, ""] | None = eqx.field(converter=as_float, default=None)
    tangential_stiffness: Float[Array, ""] | None = eqx.field(converter=as_float, default=None)
    anisotropy: Float[Array, ""] | None = eqx.field(converter=as_float, default=None)
    grain: Float[Array, "3"] | None = eqx.field(converter=as_float, default=None)
    friction: Law | None = None
    finger_mu: Float[Array, "F"] | None = eqx.field(converter=as_float, default=None)

    def __check_init__(self):
        check_positive("stiffness", self.stiffness, unit="N/m")
        if self.damping is not None:
            check_not_negative("damping", self.damping, unit="s/m")
        if self.tangential_stiffness is not None:
            check_positive("tangential_stiffness", self.tangential_stiffness, unit="N/m")
        self._check_grain()
        names = [n for n in _MUS if getattr(self, n) is not None]
        if names not in (["mu"], ["mu_static", "mu_kinetic"]):
            given = f"{' and '.join(names)} given" if names else "mu is missing"
            raise InputError(f"{given}; allowed: mu alone, or mu_static with mu_kinetic")
        for name in names:
            value = getattr(self, name)
            shape = getattr(value, "shape", ())
            check_not_negative(name, value, shape=shape if len(shape) <= 1 else (), unit="")
        _check_order(self.mu_static, self.mu_kinetic)
        if self.finger_mu is not None:
            allowed, shape = "a list, 0 or above for each finger", np.shape(self.finger_mu)
            if len(shape) != 1:
                raise InputError(f"finger_mu has the shape {shape}; allowed: {allowed}")
            check_number("finger_mu", self.finger_mu, allowed, shape=shape, low=0.0)
        if self.friction is not None and not isinstance(self.friction, Law):
            raise InputError(f"friction is {self.friction!r}; allowed: a friction law")
        with within("friction: "):
            self.law().check(self.mu_kinetic is not None)

    def _check_grain(self) -> None:
        if (self.anisotropy is None) != (self.grain is None):
            missing = "grain" if self.grain is None else "anisotropy"
            raise InputError(f"{missing} is missing; allowed: anisotropy and grain, or neither")
        if self.anisotropy is None:
            return
        check_positive("anisotropy", self.anisotropy, unit="")
        check_number("grain", self.grain, "three numbers that are not all 0", shape=(3,))
        if not is_traced(self.grain) and not np.any(np.asarray(self.grain)):
            raise InputError("grain is [0, 0, 0]; allowed: three numbers that are not all 0")

    def check_faces(self, faces: tuple[str, ...]) -> None:
        """Refuse a list of mu whose length is not the number of the shape's faces."""
        for name in _MUS:
            value = getattr(self, name)
            if value is not None and value.ndim == 1:
                shown = ", ".join(faces) if len(faces) < 50 else f"{faces[0]} to {faces[-1]}"
                check_number(
                    name, value, f"one number, or one for each of the faces {shown}", shape=(len(faces),)
                )

    def check_fingers(self, count: int) -> None:
        """Refuse factors that are not one for each of the fingers."""
        if self.finger_mu is not None and self.finger_mu.shape != (count,):
            raise InputError(
                f"finger_mu has {len(self.finger_mu)} factors for {count} finger{'' if count == 1 else 's'}; "
                "allowed: one for each"
            )

    def of_finger(self, factor: Float[Array, ""] | None) -> "Surface":
        """What a finger feels whose mu is larger by a factor; `None`: the surface itself."""
        if factor is None:
            return self
        given = {name: getattr(self, name) for name in _MUS}
        larger = {name: factor * mu for name, mu in given.items() if mu is not None}
        return dataclasses.replace(self, **larger, finger_mu=None)

    def law(self) -> Law:
        """The friction law."""
        return _CONE if self.friction is None else self.friction

    def remembers(self) -> bool:
        """Whether the law keeps a number of each touching point from step to step."""
        return self.law().remembers(self.mu_kinetic is not None)

    def needs_velocity(self) -> bool:
        """Whether a touch depends on how fast the point moves."""
        return self.damping is not None or self.law().needs_travel

    def hold(
        self,
        near: SurfacePoint,
        offset: Float[Array, "3"],
        normal_force: Float[Array, ""],
        viscous: Float[Array, "3"] | None,
        travel: Float[Array, "3"] | None,
        sliding: Float[Array, ""] | None,
        rounding: Float[Array, ""],
        dt: Float[Array, ""] | None,
    ) -> Friction:
        """What the friction law makes of a touch at a surface point; the arguments are those of `Press`."""
        stiffness = self.stiffness if self.tangential_stiffness is None else self.tangential_stiffness
        return self.law().hold(
            Press(
                offset,
                stiffness,
                normal_force,
                viscous,
                travel,
                sliding,
                rounding,
                dt,
                lambda direction: self.static_at(near, direction),
                None if self.mu_kinetic is None else lambda direction: self.kinetic_at(near, direction),
            )
        )

    def static_at(self, near: SurfacePoint, direction: Float[Array, "3"]) -> Float[Array, ""]:
        """The mu of breaking away at a surface point, against a pull in a direction of its tangent plane."""
        return self._at(self.mu if self.mu_static is None else self.mu_static, near, direction)

    def kinetic_at(self, near: SurfacePoint, direction: Float[Array, "3"]) -> Float[Array, ""]:
        """The mu of sliding there, `mu` where it is no number of its own."""
        return self._at(self.mu if self.mu_kinetic is None else self.mu_kinetic, near, direction)

    def _at(self, mu: Any, near: SurfacePoint, direction: Float[Array, "3"]) -> Float[Array, ""]:
        """Each plane of a corner holds with its own mu and its share of the normal force, in its own plane."""
        corner = near.corner
        if corner is None:
            return self._along(_of_face(mu, near.face), near.normal, direction)
        unit = safe.normalise(direction)

        def one(face, normal, weight):
            inside = unit - jnp.sum(unit * normal) * normal
            return self._along(_of_face(mu, face), normal, inside) * weight * safe.norm(inside)

        share = jnp.sum(jax.vmap(one)(corner.faces, corner.normals, corner.weights))

        def left(face, weight):
            return self._along(_of_face(mu, face), near.normal, direction) * weight

        more = jnp.maximum(share, jnp.sum(jax.vmap(left)(corner.left_faces, corner.left_weights)))
        share = jnp.where(jnp.any(corner.left_weights > 0), more, share)
        return jnp.where(jnp.any(direction != 0), share, _of_face(mu, near.face))

    def _along(self, mu: Any, normal: Float[Array, "3"], direction: Float[Array, "3"]) -> Float[Array, ""]:
        """mu in a direction: the radius of an ellipse with mu along the grain and anisotropy times mu across it."""
        if self.anisotropy is None or self.grain is None:
            return mu
        along = safe.normalise(self.grain - jnp.sum(self.grain * normal) * normal)
        unit = safe.normalise(direction)
        cosine = jnp.sum(unit * along)
        sine = unit - cosine * along
        # 1 / sqrt(cos^2 + sin^2 / across^2); the sine on its own, since 1 - cos^2 would cancel.
        length = safe.norm(jnp.concatenate([(self.anisotropy * cosine)[None], sine]))
        return jnp.where(length == 0, mu, mu * safe.divide(self.anisotropy, length))


_CONE = Cone()


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
