"""Sets of points that may touch, between fingers and objects and between objects: what a step knows of them all at once.

An integrator that looks ahead is given them before the laws of touch are read.
"""

import dataclasses
from collections.abc import Mapping

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from . import god_object, grasp, rotation
from .body import Wrench
from .god_object import GodObject, Grip, Meeting, Pressed
from .shape import Track

Rates = dict[str, tuple[Float[Array, "3"], Float[Array, "3"] | None]]
"""Of each moving object by name: the velocity of its centre of mass (m/s), and its spin (rad/s) if it turns."""


class Link(eqx.Module):
    """Points of one thing at the surface of an object `on`: of the object `of`, or fingers where that is `None`.

    - `meeting`: in the frame of `on`, as are the other vectors but `place`.
    - `point` (m): the points, and `place` (m) where they are in the world; `matrix` turns the frame into the world's.
    - `track`: what the shape remembers of them.
    - `before` (m): their depths in the step before.
    - `drive` (m/s): the fingers' own velocity in the world, where it is known.
    - `carried` (m): how far the material passed through the points in this step, which the offset knows already.
      `None`: they are fixed in it, or the god-objects went along when they were read.
    - `own` (m): where these are in the frame of `of`.
    - `faces`: which of them have a surface before them that they could run into. `None`: all.
    - `wanders`: where they are goes over the material, and a god-object is kept as its offset.
    """

    meeting: Meeting
    point: Float[Array, "n 3"]
    place: Float[Array, "n 3"]
    matrix: Float[Array, "3 3"]
    track: Track | None
    before: Float[Array, "n"]
    drive: Float[Array, "n 3"] | None
    carried: Float[Array, "n 3"] | None
    faces: Bool[Array, "n"] | None
    of: str | None = eqx.field(static=True)
    on: str = eqx.field(static=True)
    wanders: bool = eqx.field(static=True, default=False)
    own: Float[Array, "n 3"] | None = None

    def keep(self, pressed: Pressed) -> GodObject:
        """The god-objects after the step."""
        if self.wanders:
            depth = self.meeting.near.depth  # below 0: they lie apart
            offset = jnp.where((depth > 0)[:, None], pressed.offset, 0)
            return GodObject(offset, depth, pressed.sliding, None, self.own)
        kept = god_object.keep(self.meeting, pressed, self.point, self.track)
        return kept if self.own is None else dataclasses.replace(kept, own=self.own)

    def wrenches(self, pressed: Pressed, centres: Mapping[str, Array]) -> dict[str, Wrench]:
        """What the touches do to the moving objects, by name; `centres` (m) are their centres of mass."""
        force = rotation.turn(self.matrix, pressed.touch.force)
        sides = ((self.of, force), (self.on, -force))
        return {
            name: grasp.residual(side, self.place - centres[name][None])
            for name, side in sides
            if name is not None and name in centres
        }

    def slip(self, rates: Rates, centres: Mapping[str, Array]) -> Float[Array, "n 3"]:
        """The velocity (m/s) of the points against the surface that objects moving at `rates` give them."""
        return rotation.turn_back(self.matrix, self._passing(rates, centres))

    def read(self, rates: Rates, centres: Mapping[str, Array]) -> "Link":
        """The same touch read where the objects move at `rates`."""
        velocity = self._passing(rates, centres)
        velocity = velocity if self.drive is None else velocity + self.drive
        return self._with(velocity=rotation.turn_back(self.matrix, velocity))

    def _passing(self, rates: Rates, centres: Mapping[str, Array]) -> Float[Array, "n 3"]:
        """The velocity (m/s) of the points against the surface, but for the fingers' own, in the world frame."""
        velocity = jnp.zeros_like(self.place)
        for name, sign in ((self.of, 1), (self.on, -1)):
            if name is not None and name in centres:
                straight, spin = rates[name]
                velocity = velocity + sign * straight[None]
                if spin is not None:
                    arms = self.place - centres[name][None]
                    velocity = velocity + sign * rotation.turn(rotation.cross_matrix(spin), arms)
        return velocity

    def at(self, slip: Float[Array, "n 3"]) -> "Link":
        """The same touch read at another velocity of the objects."""
        if self.drive is not None:
            slip = slip + rotation.turn_back(self.matrix, self.drive)
        return self._with(velocity=slip)

    def ahead(self, slip: Float[Array, "n 3"], grip: Grip, dt: Float[Array, ""]) -> "Link":
        """The touch `dt` s on, if the objects move by `slip` (m/s) all the while; fingers stay where they are."""
        near, offset = self.meeting.near, self.meeting.offset
        deepening = -jnp.sum(near.normal * slip, axis=-1)
        along = dt * (slip + deepening[:, None] * near.normal)
        moved = along if self.carried is None else along - self.carried
        depth = near.depth + dt * deepening
        if self.faces is not None:
            depth = jnp.where(self.faces, depth, near.depth)
        near = dataclasses.replace(near, depth=depth, point=near.point + moved)
        needed = self.meeting.surface.needs_velocity()
        link = self.at(slip) if needed else self
        return link._with(near=near, offset=offset - moved, grip=grip)

    def grip(self) -> Grip:
        """The normal forces of the step before, at the velocity of now; of points that are new here, those of now."""
        surface, velocity = self.meeting.surface, self.meeting.velocity
        # Not `maximum`, which has half the derivative at 0: that of neither side, where a thing is put exactly on a floor.
        new = jnp.where(self.meeting.near.depth > 0, self.meeting.near.depth, 0)
        depth = jnp.where(self.before > 0, self.before, new)
        spring = surface.stiffness * depth
        if surface.damping is None or velocity is None:
            return Grip(spring, spring)
        deepening = -jnp.sum(self.meeting.near.normal * velocity, axis=-1)
        return Grip(spring, spring * jnp.maximum(1 + surface.damping * deepening, 0))

    def _with(self, **changes) -> "Link":
        return dataclasses.replace(self, meeting=dataclasses.replace(self.meeting, **changes))


def join(first: dict[str, Wrench], second: dict[str, Wrench]) -> dict[str, Wrench]:
    """Wrenches by name, added where a name is in both."""
    both = dict(first)
    for name, wrench in second.items():
        both[name] = wrench if name not in both else jax.tree.map(jnp.add, both[name], wrench)
    return both
