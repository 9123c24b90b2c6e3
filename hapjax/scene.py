"""Scene: all that a step needs, as one pytree whose leaves are the physical parameters."""

import re
from collections import OrderedDict
from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ._validate import as_float, check_not_negative, check_number, flag, is_traced
from .body import Body
from .contact import Contact, check_shapes
from .errors import InputError, within
from .integrate import Integrator, SemiImplicit
from .shape import Shape
from .surface import Surface
from .torsion import Torsion


class Object(eqx.Module):
    """Something that can be touched.

    **Arguments:**

    - `shape`: what it looks like, in its own frame.
    - `surface`: what fingers feel. `None`: fingers pass through.
    - `body`: mass and inertia. `None`: fixed in space, no dynamics.
    - `position`: m, of the frame's origin; `orientation`: quaternion w x y z. Of a moving object, where it starts.
    """

    shape: Shape
    surface: Surface | None = None
    body: Body | None = None
    position: Float[Array, "3"] = eqx.field(converter=as_float, default=(0.0, 0.0, 0.0))
    orientation: Float[Array, "4"] = eqx.field(converter=as_float, default=(1.0, 0.0, 0.0, 0.0))

    def __check_init__(self):
        check_number("position", self.position, "three numbers in m", shape=(3,))
        check_number(
            "orientation", self.orientation, "four numbers w, x, y, z that are not all 0", shape=(4,)
        )
        if not is_traced(self.orientation):
            with np.errstate(over="ignore", under="ignore"):
                square = np.sum(np.asarray(self.orientation) ** 2)
            if not np.finfo(square.dtype).tiny <= square < np.inf:
                raise InputError(
                    f"orientation is {np.asarray(self.orientation).tolist()}; "
                    "allowed: four numbers w, x, y, z that are not all 0, of ordinary size"
                )
        if self.surface is not None:
            with within("surface."):
                self.surface.check_faces(self.shape.faces)
        if self.body is not None and self.shape.inertia_per_mass() is None:
            raise InputError(
                f"body is given, but a {type(self.shape).__name__.lower()} is unbounded; allowed: no body"
            )


class World(eqx.Module):
    """What acts on every moving object.

    **Arguments:** `gravity`, m/s^2, `None`: none; `gyroscopic`, whether Euler's w x J w counts (MHS leaves it out);
    `dead_band`, T_crit in N m, 0 or above: a residual finger torque up to it is none (MHS section 5), `None`: no
    dead band.
    """

    gravity: Float[Array, "3"] | None = eqx.field(converter=as_float, default=None)
    gyroscopic: bool = eqx.field(static=True, converter=flag("gyroscopic"), default=False)
    dead_band: Float[Array, ""] | None = eqx.field(converter=as_float, default=None)

    def __check_init__(self):
        if self.gravity is not None:
            check_number("gravity", self.gravity, "three numbers in m/s^2", shape=(3,))
        if self.dead_band is not None:
            check_not_negative("dead_band", self.dead_band, unit="N m")


def _ordered(mapping: Any) -> Any:
    # JAX sorts the keys of a dict when it takes a pytree apart; an OrderedDict keeps the scene's order.
    return OrderedDict(mapping) if isinstance(mapping, Mapping) else mapping


class Scene(eqx.Module):
    """Objects by name, the pairs of them that can collide, and what acts on them.

    **Arguments:**

    - `object`: each object by its name.
    - `contact`: each pair that can collide, by a name of its own; pairs not named pass through each other.
    - `torsion`: how a grasp resists turning, about the line of two fingers or about each finger. `None`: not at all.
    - `world`: gravity and the like.
    - `integrator`: how moving objects advance, and the time step.

    A part that is `None` costs nothing: no state, no arithmetic, no compile time.

    **Raises:** `InputError` for combinations that make no sense, naming the field and what is allowed.
    """

    object: dict[str, Object] = eqx.field(converter=_ordered)
    contact: dict[str, Contact] = eqx.field(converter=_ordered, default_factory=dict)
    torsion: Torsion | None = None
    world: World = eqx.field(default_factory=World)
    integrator: Integrator = eqx.field(default_factory=SemiImplicit)

    def __check_init__(self):
        if not isinstance(self.object, Mapping) or not self.object:
            raise InputError("object is empty; allowed: at least one object by name")
        for kind, parts in (("object", self.object), ("contact", self.contact)):
            for name in parts:
                if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name):
                    raise InputError(
                        f"{kind} has the name {name!r}; allowed: letters, digits and _, no digit first"
                    )
        for name, pair in self.contact.items():
            with within(f"contact.{name}."):
                _check_pair(pair, self.object)
        _check_distinct(self.contact)
        turning = [o for o in self.object.values() if o.body is not None and o.body.rotation]
        if self.torsion is not None and not any(o.surface is not None for o in turning):
            raise InputError(
                "torsion is given, but no object with surface and body can turn; allowed: no torsion"
            )
        if self.world.gyroscopic and not turning:
            raise InputError("world.gyroscopic is true, but no object has a body that turns; allowed: false")
        if self.world.dead_band is not None and not turning:
            raise InputError(
                "world.dead_band is given, but no object has a body that turns; allowed: no dead band"
            )

    def moving(self) -> list[str]:
        """Names of the objects that have a body, in the scene's order: the order of a recording's poses."""
        return [name for name, o in self.object.items() if o.body is not None]

    def touchable(self) -> list[str]:
        """Names of the objects that fingers feel, in the scene's order."""
        return [name for name, o in self.object.items() if o.surface is not None]


def cast(scene: Scene, dtype: Any) -> Scene:
    """The same scene with every number as `dtype` (float32 or float64)."""
    return jax.tree.map(lambda leaf: jnp.asarray(leaf, dtype), scene)


def dtype_of(scene: Scene) -> Any:
    """The one floating type of a scene's numbers. **Raises:** `InputError` where it has several."""
    kinds = sorted({str(leaf.dtype) for leaf in jax.tree.leaves(scene)})
    if len(kinds) != 1:
        raise InputError(
            f"the scene mixes the number types {', '.join(kinds)}; allowed: one (see hapjax.cast)"
        )
    return jnp.dtype(kinds[0])


def _check_pair(pair: Contact, objects: Mapping[str, Object]) -> None:
    for name in pair.between:
        if name not in objects:
            raise InputError(f"between names {name!r}, which is no object; allowed: {', '.join(objects)}")
    if pair.between[0] == pair.between[1]:
        raise InputError(f"between names {pair.between[0]!r} twice; allowed: two different objects")
    for name in ("mu", "mu_static", "mu_kinetic"):
        if getattr(pair, name) is not None:
            check_number(name, getattr(pair, name), "one number, since a contact has no faces")
    if pair.finger_mu is not None:
        raise InputError(
            "finger_mu is given, but no finger touches a contact; allowed: on the surface of an object"
        )
    first, second = (objects[name] for name in pair.between)
    check_shapes(first.shape, second.shape)
    if first.body is None and second.body is None:
        raise InputError(
            f"between pairs {pair.between[0]} and {pair.between[1]}, both without a body; allowed: one that moves"
        )


def _check_distinct(contacts: Mapping[str, Contact]) -> None:
    seen: dict[frozenset, str] = {}
    for name, pair in contacts.items():
        other = seen.setdefault(frozenset(pair.between), name)
        if other != name:
            raise InputError(
                f"contact.{name}.between names the pair of contact.{other} again; allowed: each pair once"
            )
