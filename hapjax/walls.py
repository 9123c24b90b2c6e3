"""Balls in a hollow of a mesh, as in a groove or a bowl: each touches up to three walls at once.

A wall is a place that is locally nearest to the ball's centre. Where two walls bend by little, the ball has in common
with both what lies at the line where their planes meet, as deep as there. So that nothing is counted twice, and no force
jumps where a wall begins, the springs' energy of a ball is

    k / 2 (sum of depths of walls^2 - sum of depths at lines of two^2 + depth at the point of three^2),

each place counted if it is locally nearest, farthest, or a saddle between (Morse): the ball's centre and the tangent planes
of its walls are all that is needed. Each force at a line or point is the sum of forces on its walls.
"""

import dataclasses
import itertools
from typing import TypeGuard

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from . import safe
from .god_object import GodObject
from .shape import Mesh, Shape, SurfacePoint

MOST = 3
_ORDERS = np.array(list(itertools.permutations(range(MOST))), np.int32)
_LATER = np.tri(MOST, dtype=bool)  # a wall against itself and those nearer
_SAME = 0.9  # the cosine of the angle by which a wall's direction may turn in a step
_FLAT = 1e-6  # the square of the sine below which planes are parallel


def are_many(shape: Shape) -> TypeGuard[Mesh]:
    """Whether a ball can touch several walls of a shape."""
    return isinstance(shape, Mesh) and shape.is_hollow


def start(gods: GodObject) -> GodObject:
    """The god-objects of balls that have touched nothing, one for each wall."""
    gods = jax.tree.map(lambda x: jnp.repeat(x, MOST, axis=0), gods)
    return dataclasses.replace(gods, own=jnp.zeros_like(gods.point))


def find(
    mesh: Mesh, centres: Float[Array, "n 3"], radius: Float[Array, ""], ahead: bool
) -> tuple[SurfacePoint, Bool[Array, "n 3"]]:
    """Of each ball about `centres` (m) its walls, the nearest first, with the depth that each has for itself; and
    which of the three there are. `ahead`: also those that are not yet touched."""
    reach = radius + mesh.sight() if ahead else radius
    near, found = jax.vmap(lambda centre: mesh.walls(centre, reach))(centres)
    depth, counts = jax.vmap(lambda n, d, f: _shared(n, d, f, radius))(
        near.normal, near.depth + radius, found
    )
    return dataclasses.replace(near, depth=jnp.where(counts, depth, 0)), counts


def about(mesh: Mesh, place: Float[Array, "3"], radius: Float[Array, ""]) -> SurfacePoint:
    """Three walls near a disc about a place (m); the nearest one again where they are fewer."""
    near, found = mesh.walls(place, 2 * radius)
    return jax.tree.map(lambda x: jnp.where(found.reshape(found.shape + (1,) * (x.ndim - 1)), x, x[:1]), near)


def goes_on(before: Float[Array, "P 3"], points: Float[Array, "P 3"]) -> Int[Array, "P"]:
    """`Shape.goes_on` of rims of four points, each right above a wall: in the order in which they come nearest to those
    before, however the walls take turns in being the nearest."""
    old, new = before.reshape(-1, 4, 3), points.reshape(-1, 4, 3)
    apart = [jnp.sum((jnp.roll(old, -i, axis=1) - new) ** 2, axis=(1, 2)) for i in range(4)]
    quarters = jnp.argmin(jnp.stack(apart), axis=0).astype(jnp.int32)
    rims = jnp.arange(points.shape[0], dtype=jnp.int32).reshape(-1, 4)
    return (4 * (rims // 4) + (rims + quarters[:, None]) % 4).reshape(-1)


def _shared(
    normals: Float[Array, "3 3"], depths: Float[Array, "3"], found: Bool[Array, "3"], radius: Float[Array, ""]
) -> tuple[Float[Array, "3"], Bool[Array, "3"]]:
    """The depth of each wall, less what another has as well; and which of them count."""
    to, far = -normals, radius - depths  # the planes: x . to = far, seen from the centre
    # What lies below a nearer wall's plane belongs to that wall.
    over = far[:, None] > far[None] * jnp.sum(to[:, None] * to[None], axis=-1)
    counts = found & jnp.all(over | ~found[:, None] | jnp.asarray(_LATER), axis=0)
    share, beyonds, spans = depths, [], []
    for i, j, k in ((0, 1, 2), (0, 2, 1), (1, 2, 0)):
        a, b, c = to[i], to[j], to[k]
        cosine, square = jnp.sum(a * b), jnp.sum(jnp.cross(a, b) ** 2)
        square = jnp.where(square > _FLAT, square, 0)
        x, y = (safe.divide(v, square) for v in (far[i] - far[j] * cosine, far[j] - far[i] * cosine))
        both = counts[i] & counts[j]
        line = x * a + y * b
        beyond = far[k] - jnp.sum(line * c)
        saddle = both & (x > 0) & (y > 0) & (~counts[k] | (beyond > 0))
        pull = jnp.where(saddle, _depth_at(line, radius), 0)
        share = share.at[i].add(-x * pull).at[j].add(-y * pull)
        beyonds.append(beyond)
        spans.append((line, x, y, a, b, cosine, square))
    line, x, y, a, b, cosine, square = spans[0]
    along = (jnp.sum(to[2] * a), jnp.sum(to[2] * b))
    p, q = (safe.divide(v, square) for v in (along[0] - along[1] * cosine, along[1] - along[0] * cosine))
    rest = to[2] - p * a - q * b
    height = jnp.sum(rest**2)
    z = safe.divide(beyonds[0], jnp.where(height > _FLAT, height, 0))
    peak = line + z * rest
    top = jnp.all(counts) & (square > 0) & (height > _FLAT) & jnp.all(jnp.stack(beyonds) > 0)
    pull = jnp.where(top, _depth_at(peak, radius), 0)
    share = share + pull * jnp.stack([x - p * z, y - q * z, z])
    return jnp.where(depths > 0, jnp.maximum(share, 0), depths), counts


def _depth_at(place: Float[Array, "3"], radius: Float[Array, ""]) -> Float[Array, ""]:
    """The depth (m) of a place seen from a ball's centre over its distance; 0 outside."""
    far = safe.norm(place)
    return safe.divide(jnp.maximum(radius - far, 0), far)


def match(
    gods: GodObject, near: SurfacePoint, counts: Bool[Array, "n 3"], radius: Float[Array, ""]
) -> tuple[GodObject, SurfacePoint, Bool[Array, "m"]]:
    """Each wall with the god-object that it had: the one in contact whose wall was in about the same direction.

    Returns the god-objects, their surface points, and which of them there are; a memory goes with no other wall.
    """
    assert gods.own is not None
    held = gods.depth.reshape(-1, MOST) > 0
    before = -gods.own.reshape(-1, MOST, 3) / radius
    alike = jnp.sum(before[:, :, None] * near.normal[:, None], axis=-1)
    worth = jnp.where(held[:, :, None] & (near.depth > 0)[:, None], 1 + alike, 0)

    def order(worth):
        total = jnp.sum(worth[jnp.arange(MOST, dtype=jnp.int32)[None], _ORDERS], axis=1)
        return jnp.asarray(_ORDERS)[jnp.argmax(total)]

    orders = jax.vmap(order)(jax.lax.stop_gradient(worth))
    placed, counts = jax.tree.map(
        lambda x: jax.vmap(lambda a, o: a[o])(x, orders).reshape(-1, *x.shape[2:]), (near, counts)
    )
    goes_on = jnp.sum(before.reshape(-1, 3) * placed.normal, axis=-1) > _SAME
    depth = jnp.where(goes_on, gods.depth, 0)
    sliding = None if gods.sliding is None else jnp.where(goes_on, gods.sliding, 0)
    gods = dataclasses.replace(gods, depth=depth, sliding=sliding)
    return gods, placed, counts
