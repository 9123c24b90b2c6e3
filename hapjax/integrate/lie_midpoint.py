"""Drift, kick, drift: second order, and the angular momentum is carried."""

import jax
from jaxtyping import Array, Float

from .. import body as rigid
from .. import god_object, rotation
from ..body import Body, Motion, Wrench
from ..link import Link, join
from ..shape import Shape
from ..torsion import Twist, lock
from ._bodies import Bodies
from ._integrator import Integrator, Links

# Parts of each half: the rule's error at a step of 1 ms is then below 1e-5 rad in 2 s at 1 turn a second.
_PARTS = 2
# Each round brings the midpoint's spin nearer by a factor of about the angle turned in half a part.
_ROUNDS = 3


class LieMidpoint(Integrator):
    """Half a step of free motion, the forces there, half a step of free motion (Strang 1968). Second order.

    Free rotation is the Lie midpoint rule: it goes by the spin of its own middle, and the angular momentum is the same
    at its end as at its start. Forces are read half-way, so `hip` is where the fingers are at the middle of the step; with
    substeps it is where they are at the end, as with every integrator, and each substep reads them at its own middle.
    Forces that depend on velocity are read twice, the second time at the velocity of the middle.
    """

    reads_middle = True

    def drift(
        self, body: Body, shape: Shape, motion: Motion, gyroscopic: bool, dt: Float[Array, ""]
    ) -> Motion:
        """The free motion of the first half of a step."""
        return _free(body, shape, motion, gyroscopic, dt / 2)

    def foresee(self, links: Links, bodies: Bodies, dt: Float[Array, ""]) -> tuple[Links, None]:
        """Touches at the velocities of the middle of the step."""
        every = jax.tree.leaves(links, is_leaf=lambda x: isinstance(x, Link))
        if all(link.meeting.velocity is None for link in every):
            return links, None
        wrenches = bodies.weights()
        for link in every:
            wrenches = join(wrenches, link.wrenches(god_object.press(link.meeting, dt), bodies.centre))
        rates = bodies.pushed(bodies.rates(), wrenches, dt / 2)

        def read(link: Link) -> Link:
            known = link.meeting.velocity is not None
            return link.read(rates, bodies.centre) if known else link

        return jax.tree.map(read, links, is_leaf=lambda x: isinstance(x, Link)), None

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
        """The whole step's forces at once, then the free motion of its second half; see `Integrator.advance`."""
        velocity, spin = motion.velocity + dt * wrench.force / body.mass, motion.spin
        if spin is not None:
            inertia, matrix = rigid.inertia_of(body, shape), rotation.to_matrix(motion.orientation)
            spin = spin + dt * rigid.angular_acceleration(inertia, matrix, spin, wrench.torque, False)
            spin = spin if twist is None else lock(twist, spin)
        kicked = Motion(motion.position, motion.orientation, velocity, spin)
        return _free(body, shape, kicked, gyroscopic, dt / 2)


def _free(body: Body, shape: Shape, motion: Motion, gyroscopic: bool, dt: Float[Array, ""]) -> Motion:
    """Free motion for `dt` s."""
    position, spin = motion.position + dt * motion.velocity, motion.spin
    if spin is None:
        return Motion(position, motion.orientation, motion.velocity, None)
    orientation = motion.orientation
    if gyroscopic:
        inertia, matrix = rigid.inertia_of(body, shape), rotation.to_matrix(orientation)
        momentum = rotation.turn(matrix, rigid.momentum(inertia, rotation.turn_back(matrix, spin)))
        for _ in range(_PARTS):
            orientation, spin = _spun(inertia, momentum, orientation, dt / _PARTS)
    else:
        orientation = _turned(orientation, spin, dt)
    centre = rigid.centre_within(body, shape)
    if centre is not None:  # it is the centre of mass that moves straight on
        change = rotation.to_matrix(motion.orientation) - rotation.to_matrix(orientation)
        position = position + rotation.turn(change, centre)
    return Motion(position, orientation, motion.velocity, spin)


def _spun(inertia: Array, momentum: Float[Array, "3"], orientation: Float[Array, "4"], dt: Float[Array, ""]):
    """The Lie midpoint rule at a constant angular momentum (world frame): the orientation and spin `dt` s on."""
    spin = _spin(inertia, momentum, orientation)
    for _ in range(_ROUNDS):
        spin = _spin(inertia, momentum, _turned(orientation, spin, dt / 2))
    after = _turned(orientation, spin, dt)
    return after, _spin(inertia, momentum, after)


def _spin(inertia: Array, momentum: Float[Array, "3"], orientation: Float[Array, "4"]) -> Float[Array, "3"]:
    matrix = rotation.to_matrix(orientation)
    return rotation.turn(matrix, rigid.spin_of(inertia, rotation.turn_back(matrix, momentum)))


def _turned(
    orientation: Float[Array, "4"], spin: Float[Array, "3"], dt: Float[Array, ""]
) -> Float[Array, "4"]:
    return rotation.normalise(rotation.product(rotation.from_rotation_vector(spin * dt), orientation))
