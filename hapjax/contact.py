"""Object against object: the points of one object that can enter the other, each with its own god-object (MHS 4).

A box touches a plane by its eight vertices, a ball by the point nearest to the plane.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from . import god_object, rotation
from .errors import InputError
from .god_object import GodObject, Touch
from .shape import Box, Plane, Shape, Sphere
from .surface import Surface


class Contact(Surface):
    """A pair of objects that can collide, with the friction, stiffness and loss of the pair.

    **Arguments:** `between`, the names of a box or sphere with a body and of a plane; the others as for `Surface`, mu
    being one number.
    """

    between: tuple[str, str] = eqx.field(static=True, kw_only=True, converter=lambda names: _pair(names))


def _pair(names) -> tuple[str, str]:
    if isinstance(names, (list, tuple)) and len(names) == 2 and all(isinstance(n, str) for n in names):
        return (names[0], names[1])
    raise InputError(f"between is {names!r}; allowed: the names of two objects")


class Placed(eqx.Module):
    """A shape at a place: position (m) of its origin and rotation matrix, world frame."""

    shape: Shape
    position: Float[Array, "3"]
    matrix: Float[Array, "3 3"]

    def to_local(self, points: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """World points (m) in the shape's frame."""
        return rotation.turn_back(self.matrix, points - self.position[None])

    def to_world(self, points: Float[Array, "n 3"]) -> Float[Array, "n 3"]:
        """The shape's points (m) in the world frame."""
        return self.position[None] + rotation.turn(self.matrix, points)


def contact_points(placed: Placed, plane: Placed) -> Float[Array, "V 3"]:
    """The points (m, world frame) by which a placed shape can touch a plane."""
    shape = placed.shape
    if isinstance(shape, Box):
        return placed.to_world(shape.vertices())
    if isinstance(shape, Sphere):
        return (placed.position - shape.radius * plane.matrix[:, 2])[None]
    raise InputError(
        f"a {type(shape).__name__.lower()} has no contact points with a plane; allowed: box, sphere"
    )


def touch_plane(
    contact: Contact,
    gods: GodObject,
    placed: Placed,
    plane: Placed,
    points: Float[Array, "V 3"],
    velocities: Float[Array, "V 3"],
    spin: Float[Array, "3"] | None,
    dt: Float[Array, ""],
) -> tuple[GodObject, Touch, Float[Array, "V 3"]]:
    """Push the contact points of an object out of a plane at rest.

    Returns the god-objects and touches in the plane's frame, and the forces on the object in the world frame (N).

    **Arguments:** `points` (m) and `velocities` (m/s) of the object's material there, world frame.
    """
    local = plane.to_local(points)
    slip = rotation.turn_back(plane.matrix, velocities)
    if isinstance(placed.shape, Sphere) and spin is not None:
        # The lowest point of a rolling ball travels with its centre while the material there stands still: the
        # god-object is held by the material, so it goes along by the difference.
        rolled = dt * jnp.cross(spin, placed.shape.radius * plane.matrix[:, 2])
        gods = eqx.tree_at(
            lambda g: g.point, gods, gods.point + rotation.turn_back(plane.matrix, rolled)[None]
        )
    gods, touch = jax.vmap(lambda g, p, v: god_object.touch(plane.shape, contact, g, p, v, dt))(
        gods, local, slip
    )
    return gods, touch, rotation.turn(plane.matrix, touch.force)


def start(contact: Contact, placed: Placed, plane: Placed) -> GodObject:
    """God-objects of an object that has not touched the plane yet."""
    return god_object.start(plane.shape, contact, plane.to_local(contact_points(placed, plane)))


def is_plane(shape: Shape) -> bool:
    """Whether the shape is the one that others are pushed out of."""
    return isinstance(shape, Plane)
