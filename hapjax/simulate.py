"""init, step, rollout: a scene felt by fingers."""

import dataclasses
from collections import OrderedDict
from collections.abc import Callable
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from . import body as rigid
from . import contact as pairs
from . import god_object, grasp, rotation, safe
from ._flat_step import Traced, flat_step
from ._one_function import is_tried
from ._segments import computed_again, scan_in_segments
from ._stand_in import stand_in
from ._state import SENSE, flat, in_sense
from ._state import Reply as Reply
from ._state import State as State
from .body import Body, Motion, Wrench
from .contact import Mover, Placed
from .errors import InputError, within
from .god_object import GodObject, Touch
from .integrate import Bodies
from .link import Link, join
from .scene import Scene, dtype_of
from .shape import Shape
from .torsion import Grip, Held, Torsion, Twist


def init(scene: Scene, hip: Float[Any, "F 3"], gimbal: Float[Any, "..."] | None = None) -> State:
    """The state before the first step: objects at rest where the scene puts them, fingers at `hip` (F, 3) m, world.

    **Arguments:** `gimbal` (F,) rad, the angles of the fingers' gimbals, where the scene's torsion is a `Gimbal`.

    **Raises:** `InputError` where `hip` is not (F, 3) or its numbers are of another type than the scene's, where a
    surface's `finger_mu` is not one factor for each finger, and where `gimbal` is missing, not (F,), or given to a scene
    that does not read it.
    """
    hip = _as_hip(scene, hip)
    return _init(scene, hip, _as_gimbal(scene, gimbal, hip))


@jax.jit
def _init(scene: Scene, hip: Float[Array, "F 3"], gimbal: Float[Array, "F"] | None) -> State:
    placed = {name: _placed(scene, {}, name) for name in scene.object}
    motion = OrderedDict((name, _at_rest(scene, name)) for name in scene.moving())
    finger = OrderedDict()
    for name in scene.touchable():
        finger[name] = god_object.start(placed[name].shape, _surface(scene, name), placed[name].to_local(hip))
    contact = OrderedDict(
        (name, pairs.start(pair, *(_mover(scene, motion, placed, which) for which in pair.between)))
        for name, pair in scene.contact.items()
    )
    angles = OrderedDict()
    for name in motion:
        if name in finger and _resists(scene, motion[name].spin, hip):
            angles[name] = _torsion(scene).start(hip)
    angles = OrderedDict((name, angle) for name, angle in angles.items() if angle is not None)
    return State(hip if _needs_hip(scene) else None, motion, finger, contact, angles, gimbal)


@jax.jit
def step(
    scene: Scene,
    state: State,
    hip: Float[Any, "F 3"],
    dt: Any = None,
    gimbal: Float[Any, "..."] | None = None,
) -> tuple[State, Reply]:
    """Advance a scene by `dt` seconds with the fingers at `hip` (F, 3) m, world frame.

    The forces are those of the objects where they were against the fingers where they are now; then the objects move.
    With substeps the fingers travel straight from where they were, so that `hip` is where they are at the end of the
    step, and the reply is the last substep's. Without, `LieMidpoint` reads `hip` as that of the middle of the step.

    **Arguments:** `dt` in s, above 0; `None`: the scene's integrator's. `gimbal` (F,) rad as for `init`.
    """
    return step_known(known(scene), state, hip, dt, gimbal)


def step_known(
    given: tuple[Scene, dict[str, Placed]], state: State, hip: Any, dt: Any, gimbal: Any
) -> tuple[State, Reply]:
    """`step`, of what is `known` of a scene."""
    scene, fixed = given
    # Still far beyond sense, so that the step is lost; but its squares are finite, and so are its derivatives.
    hip = jnp.clip(_as_hip(scene, hip), -10 * SENSE, 10 * SENSE)
    gimbal = _as_gimbal(scene, gimbal, hip)
    dt = scene.integrator.dt if dt is None else jnp.asarray(dt, hip.dtype)
    turning = None if gimbal is None else (gimbal - state.gimbal) / dt
    state = dataclasses.replace(state, gimbal=gimbal)
    count = scene.integrator.substeps
    drive = None if state.hip is None else (hip - state.hip) / dt
    if count == 1:
        return _substep(scene, fixed, state, hip, drive, turning, dt)
    if state.hip is None:
        raise InputError(
            "the state was made for a scene without substeps; allowed: a state from init of this scene"
        )
    start, short = state.hip, dt / count
    part = 0.5 if scene.integrator.reads_middle else 1.0  # of a substep, at which its forces are read

    def body(carry: State, fraction: Float[Array, ""]):
        return _substep(scene, fixed, carry, start + fraction * (hip - start), drive, turning, short)

    state, replies = jax.lax.scan(body, state, (jnp.arange(count, dtype=hip.dtype) + part) / count)
    state = dataclasses.replace(state, hip=jnp.where(jnp.abs(hip) <= SENSE, hip, start))
    lost, reply = jnp.any(replies.lost), jax.tree.map(lambda x: x[-1], replies)
    return state, dataclasses.replace(reply, force=jnp.where(lost, 0, reply.force), lost=lost)


@partial(jax.jit, static_argnames="checkpoint")
def rollout(
    scene: Scene,
    state: State,
    hips: Float[Any, "T F 3"],
    dt: Any = None,
    gimbals: Float[Any, "..."] | None = None,
    *,
    checkpoint: bool = False,
) -> tuple[State, Reply]:
    """`step` for each of `hips` (T, F, 3) m; returns the last state and every reply, stacked along a first axis T.

    **Arguments:** `gimbals` (T, F) rad, where the scene's torsion is a `Gimbal`. `checkpoint`: a reverse-mode gradient
    remembers the states between about sqrt(T) segments of about sqrt(T) steps, and computes the rest again (Griewank and
    Walther 2008, Evaluating Derivatives, chapter 12), so that its memory grows as sqrt(T) and not as T, but for
    what goes in and comes out at each step. Results are the same.
    """
    hips = jnp.asarray(hips)
    gimbals = None if gimbals is None else jnp.asarray(gimbals)
    if gimbals is not None and gimbals.shape != hips.shape[:2]:
        raise InputError(
            f"gimbals has the shape {gimbals.shape}; allowed: {hips.shape[:2]}, an angle for each of hips"
        )
    dt = None if dt is None else jnp.asarray(dt, dtype_of(scene))
    given, scan = known(scene), scan_in_segments if checkpoint else jax.lax.scan
    if not is_tried(given, dt, state, hips, gimbals):
        return _steps(step_known, scan, given, dt, state, hips, gimbals)
    fingers = [None if x is None else jax.ShapeDtypeStruct(x.shape[1:], x.dtype) for x in (hips, gimbals)]
    step = Traced(step_known, given, state, fingers[0], dt, fingers[1])
    steps = partial(_steps, step, scan)

    def in_one(given, dt, state, hips, gimbals):
        parts = flat_step(step, given, state, fingers[0], dt, fingers[1])
        return (parts.rollout if parts.in_one else steps)(given, dt, state, hips, gimbals)

    # Gradients and batches are cheaper of a step that XLA can take apart.
    return stand_in(steps, in_one, given, dt, state, hips, gimbals)


def _steps(
    step: Callable[..., Any],
    scan: Callable[..., Any],
    given: Any,
    dt: Any,
    state: State,
    hips: Array,
    gimbals: Array | None,
):
    """A rollout, step after step."""
    numbers, build = flat(state)

    def one(carry, x):
        # Tied to what changes, or XLA does outside of the loop what it can of a step; a product that is then no longer
        # rounded together with its sum has other last bits than in the servo loop's step.
        parts, period, hip = jax.lax.optimization_barrier((given, dt, x[0]))
        after, reply = step(parts, build(*carry), hip, period, x[1])
        return (flat(after)[0], after.hip), reply

    carry, replies = scan(computed_again(one), (numbers, state.hip), (hips, gimbals))
    return build(*carry), replies


def known(scene: Scene) -> tuple[Scene, dict[str, Placed]]:
    """The scene with its bodies' inertias, and where fixed objects are: what a loop of steps need not find anew in each."""
    turning = [name for name in scene.moving() if _parts(scene, name)[0].rotation]

    def where(scene: Scene):
        return [_parts(scene, name)[0].inertia for name in turning]

    inertias = [rigid.inertia_of(*_parts(scene, name)) for name in turning]
    fixed = {name: _placed(scene, {}, name) for name in scene.object if name not in scene.moving()}
    return eqx.tree_at(where, scene, inertias, is_leaf=lambda x: x is None), fixed


def _substep(
    scene: Scene,
    fixed: dict[str, Placed],
    state: State,
    hip: Float[Array, "F 3"],
    drive: Float[Array, "F 3"] | None,
    turning: Float[Array, "F"] | None,
    dt: Float[Array, ""],
) -> tuple[State, Reply]:
    motions = OrderedDict(
        (name, scene.integrator.drift(*_parts(scene, name), motion, scene.world.gyroscopic, dt))
        for name, motion in state.motion.items()
    )
    placed = fixed | {name: _placed(scene, motions, name) for name in motions}
    centres = {name: _centre(scene, placed[name], name) for name in motions}
    rates = {name: (motion.velocity, motion.spin) for name, motion in motions.items()}

    # In order: an integrator that foresees takes them apart as pytrees, which would sort a dict's names.
    fingers = OrderedDict(
        (name, _fingers_on(scene, state, placed[name], name, hip, drive, rates, centres))
        for name in scene.touchable()
    )
    pairs_of = OrderedDict(
        (name, _contacts(scene, state, motions, placed, name, dt)) for name in scene.contact
    )
    bodies = _bodies(scene, placed, motions, centres)
    (fingers, pairs_of), foreseen = scene.integrator.foresee((fingers, pairs_of), bodies, dt)

    felt = {name: god_object.press(link.meeting, dt) for name, link in fingers.items()}
    gods = OrderedDict((name, link.keep(felt[name])) for name, link in fingers.items())
    answers = {
        name: [god_object.press(link.meeting, dt) for link in found] for name, found in pairs_of.items()
    }
    grasped = {name: fingers[name].wrenches(felt[name], centres)[name] for name in motions if name in fingers}

    def hold(rates) -> dict[str, Held]:
        return {
            name: _grasp(
                scene, state, rates[name][1], fingers[name], gods[name], felt[name].touch, wrench, turning, dt
            )
            for name, wrench in grasped.items()
        }

    def total(held) -> dict[str, Wrench]:
        pushes = {name: Wrench(grasped[name].force, found.torque) for name, found in held.items()}
        for name, found in pairs_of.items():
            for link, answer in zip(found, answers[name], strict=True):
                pushes = join(pushes, link.wrenches(answer, centres))
        return pushes

    held = hold(rates)
    if scene.torsion is not None and scene.integrator.reads_middle:
        held = hold(bodies.pushed(rates, total(held), dt / 2))
    if foreseen is None:
        pushes = total(held)
    else:  # what torsion changes is all that is left to do
        pushes = {
            name: Wrench(jnp.zeros_like(found.torque), found.torque - grasped[name].torque)
            for name, found in held.items()
        }

    after = OrderedDict()
    for name, motion in (motions if foreseen is None else foreseen).items():
        push = pushes.get(name, Wrench(jnp.zeros_like(hip[0]), jnp.zeros_like(hip[0])))
        twist, pivot = held[name].twist if name in held else None, None
        if scene.integrator.needs_pivot and name in gods:
            points = placed[name].to_world(gods[name].point)
            pivot = grasp.pivot(points, gods[name].depth > 0, centres[name])
        after[name] = _move(scene, motion, name, push, twist, dt, pivot, foreseen is not None)
    contacts = OrderedDict(
        (name, tuple(link.keep(answer) for link, answer in zip(found, answers[name], strict=True)))
        for name, found in pairs_of.items()
    )
    angles = OrderedDict((name, found.angle) for name, found in held.items() if found.angle is not None)
    kept = State(None if state.hip is None else hip, after, gods, contacts, angles, state.gimbal)
    return in_sense(state, kept, _reply(hip, after, fingers, felt, answers))


def _reply(hip, after: dict[str, Motion], fingers: dict[str, Link], felt, answers) -> Reply:
    """What the touches of a step say."""
    force = jnp.zeros_like(hip)
    for name, link in fingers.items():
        force = force + rotation.turn(link.matrix, felt[name].touch.force)
    pose = [jnp.concatenate([m.position, m.orientation]) for m in after.values()]
    poses = jnp.stack(pose) if pose else jnp.zeros((0, 7), hip.dtype)
    touches = OrderedDict((name, answer.touch) for name, answer in felt.items())
    collisions = OrderedDict(
        (name, jax.tree.map(lambda *x: jnp.concatenate(x), *(a.touch for a in found)))
        for name, found in answers.items()
    )
    return Reply(force, poses, touches, collisions, jnp.zeros((), bool))


def _fingers_on(scene, state, placed: Placed, name: str, hip, drive, rates, centres) -> Link:
    """All fingers on one object."""
    surface, gods = _surface(scene, name), state.finger[name]
    local = placed.to_local(hip)
    track, near = jax.vmap(placed.shape.follow)(gods.track, local)
    faces = None
    if scene.integrator.looks_ahead:
        near, faces = god_object.or_apart(placed.shape, near, local)
    meeting = god_object.meet(surface, gods, near, local, None)
    link = Link(meeting, local, hip, placed.matrix, track, gods.depth, drive, None, faces, None, name)
    return link.read(rates, centres) if surface.needs_velocity() else link


def _contacts(scene, state, motions, placed, name: str, dt) -> list[Link]:
    pair = scene.contact[name]
    first, second = (_mover(scene, motions, placed, which) for which in pair.between)
    return pairs.meet(pair, state.contact[name], first, second, dt, scene.integrator.looks_ahead)


def _bodies(scene: Scene, placed: dict[str, Placed], motions: dict[str, Motion], centres) -> Bodies:
    """What an integrator that looks ahead must know of the moving objects."""
    return Bodies(
        {name: _parts(scene, name) for name in motions},
        motions,
        {name: placed[name].matrix for name in motions},
        centres,
        scene.world.gravity,
        scene.world.gyroscopic,
    )


def _grasp(
    scene, state, spin, link: Link, gods: GodObject, touch: Touch, wrench: Wrench, turning, dt
) -> Held:
    """What torsion and the dead band make of the fingers' wrench on a moving object."""
    held = Held(wrench.torque)
    if spin is not None and _resists(scene, spin, link.point):
        grip = Grip(
            rotation.turn(link.matrix, gods.point),
            rotation.turn(link.matrix, safe.normalise(touch.force - touch.friction_force)),
            touch.normal_force,
            touch.circle,
            gods.depth > 0,
            link.before > 0,
        )
        angle = state.god_angle.get(link.on)
        held = _torsion(scene).hold(grip, angle, wrench.torque, spin, turning, dt)
    if scene.world.dead_band is not None and spin is not None:
        held = dataclasses.replace(held, torque=grasp.dead_band(held.torque, scene.world.dead_band))
    return held


def _resists(scene: Scene, spin: Float[Array, "3"] | None, hip: Float[Array, "F 3"]) -> bool:
    """Whether torsion acts on an object under these fingers."""
    torsion = scene.torsion
    return torsion is not None and spin is not None and hip.shape[0] >= torsion.least_fingers


def _torsion(scene: Scene) -> Torsion:
    assert scene.torsion is not None
    return scene.torsion


def _move(
    scene, motion: Motion, name: str, wrench: Wrench, twist: Twist | None, dt, pivot, foreseen: bool
) -> Motion:
    body, shape = _parts(scene, name)
    if scene.world.gravity is not None and not foreseen:
        wrench = Wrench(wrench.force + body.mass * scene.world.gravity, wrench.torque)
    gyroscopic = scene.world.gyroscopic and not foreseen
    return scene.integrator.advance(body, shape, motion, wrench, gyroscopic, twist, dt, pivot)


def _parts(scene: Scene, name: str) -> tuple[Body, Shape]:
    thing = scene.object[name]
    assert thing.body is not None
    return thing.body, thing.shape


def _placed(scene: Scene, motion: dict[str, Motion], name: str) -> Placed:
    thing = scene.object[name]
    if name in motion:
        return Placed(thing.shape, motion[name].position, rotation.to_matrix(motion[name].orientation))
    return Placed(thing.shape, thing.position, rotation.to_matrix(rotation.normalise(thing.orientation)))


def _mover(scene: Scene, motion: dict[str, Motion], placed: dict[str, Placed], name: str) -> Mover:
    if name not in motion:
        return Mover(placed[name], None, None)
    return Mover(placed[name], motion[name], _centre(scene, placed[name], name))


def _centre(scene: Scene, placed: Placed, name: str) -> Float[Array, "3"]:
    return rigid.centre_of(*_parts(scene, name), placed.position, placed.matrix)


def _surface(scene: Scene, name: str):
    surface = scene.object[name].surface
    assert surface is not None
    return surface


def _at_rest(scene: Scene, name: str) -> Motion:
    thing = scene.object[name]
    assert thing.body is not None
    # No array is shared, within the state or with the scene: a shared one could not be donated to a compiled step.
    velocity, spin = jnp.zeros_like(thing.position), jnp.zeros_like(thing.position)
    position = thing.position + velocity
    return Motion(
        position, rotation.normalise(thing.orientation), velocity, spin if thing.body.rotation else None
    )


def _needs_hip(scene: Scene) -> bool:
    hurried = any(_surface(scene, name).needs_velocity() for name in scene.touchable())
    return hurried or scene.integrator.substeps > 1 or scene.integrator.looks_ahead


def _as_hip(scene: Scene, hip: Any) -> Float[Array, "F 3"]:
    dtype = dtype_of(scene)
    if not isinstance(hip, jax.Array):
        hip = jnp.asarray(hip, dtype)
    if hip.ndim != 2 or hip.shape[1] != 3 or hip.shape[0] == 0:
        raise InputError(f"hip has the shape {tuple(hip.shape)}; allowed: (F, 3) with at least one finger")
    if hip.dtype != dtype:
        raise InputError(
            f"hip is {hip.dtype} but the scene is {dtype}; allowed: one type for both (see hapjax.cast)"
        )
    for name in scene.touchable():
        with within(f"object.{name}.surface."):
            _surface(scene, name).check_fingers(len(hip))
    return hip


def _as_gimbal(scene: Scene, gimbal: Any, hip: Float[Array, "F 3"]) -> Float[Array, "F"] | None:
    needed = scene.torsion is not None and scene.torsion.needs_gimbal
    if gimbal is None and not needed:
        return None
    if not needed:
        raise InputError("gimbal is given, but the scene's torsion reads none; allowed: no gimbal")
    if gimbal is None:
        raise InputError(
            "gimbal is missing; allowed: an angle in rad for each finger, for a scene whose torsion is a gimbal"
        )
    gimbal = jnp.asarray(gimbal, hip.dtype)
    if gimbal.shape != hip.shape[:1]:
        raise InputError(
            f"gimbal has the shape {tuple(gimbal.shape)}; allowed: {hip.shape[:1]}, an angle for each finger"
        )
    return gimbal
