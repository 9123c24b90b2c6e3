"""What recordings say of a mu: whether anything slipped, and if not, how large mu is at least."""

from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from hapjax import Scene, rotation, safe

from .observation import Observation, played
from .parameters import Parameter
from .problem import NOTICEABLE, Problem, loss_at, losses_of, residuals_at
from .sharding import Layout, each, gathered
from .start import Starts
from .transform import Logit

_OF_FINGER = "finger_mu"


class Grip(eqx.Module):
    """Touches over time: normal and tangential force (N), the face touched, the static mu there, by what factor the finger
    makes it larger, and the normal in the world frame, which is `None` for contacts."""

    normal_force: Float[Array, "*r n"]
    friction_force: Float[Array, "*r n"]
    face: Int[Array, "*r n"]
    mu: Float[Array, "*r n"]
    factor: Float[Array, "*r n"]
    direction: Float[Array, "*r n 3"] | None


def is_mu(parameter: Parameter) -> bool:
    """Whether a parameter is a coefficient of friction, or a finger's factor of it."""
    return parameter.path.rsplit(".", 1)[-1] in ("mu", "mu_static", "mu_kinetic", _OF_FINGER)


def _is_of_finger(parameter: Parameter) -> bool:
    return parameter.path.endswith(f".{_OF_FINGER}")


def cost_of_grip(free: Float[Array, " p"], problem: Problem) -> Float[np.ndarray, " p"]:
    """For each free number that is a mu, by how much twice the loss grows if it is a thousand times larger.

    Where nothing slips, any larger mu explains the data as well, and the solver stops at some value on its
    way. Infinite for what is no mu.
    """
    cost = np.full(len(problem.parameters), np.inf)
    loss, residuals = float(loss_at(free, problem)), None
    for stem in problem.stems():
        first = problem.parameters[stem[0]]
        if not is_mu(first):
            continue
        if first.place is None or problem.known():
            for i in stem:
                larger = raised(free, problem.parameters[i], i)
                cost[i] = 2 * (float(loss_at(larger, problem)) - loss)
            continue
        # Each of them belongs to another recording: all are tried at once.
        residuals = residuals_at(free, problem) if residuals is None else residuals
        larger = free
        for i in stem:
            larger = raised(larger, problem.parameters[i], i)
        grown = losses_of(residuals_at(larger, problem), problem) - losses_of(residuals, problem)
        cost[stem] = 2 * grown[[problem.parameters[i].place or 0 for i in stem]]
    return cost


def raised(free: Float[Array, " p"], parameter: Parameter, i: int) -> Float[Array, " p"]:
    """The free numbers with one mu a thousand times larger, or all but at its upper bound."""
    transform, value = parameter.transform, parameter.transform.value(free[i])
    larger = 1e3 * value
    if isinstance(transform, Logit):
        larger = value + 0.999 * (transform.high - value)
    return free.at[i].set(transform.free(larger))


def slipping_instead(
    free: Float[Array, " p"], problem: Problem, flat: Bool[np.ndarray, " p"], variance: float
) -> Float[Array, " p"] | None:
    """Free numbers with smaller mu that explain the data better than a fit in which nothing slips, if there
    are any.

    From a mu so large that nothing slips the solver cannot find down again: the loss is flat there. So
    smaller ones are tried, from the largest |f_t| / f_n down to a thousandth, all `flat` ones of an object
    or contact at once, but those of fingers on their own.
    """
    found = None
    lowest = float(loss_at(free, problem)) - NOTICEABLE * variance / 2
    kind = {i: (_part(p), _is_of_finger(p)) for i, p in enumerate(problem.parameters) if flat[i]}
    for part in sorted(set(kind.values())):
        places = [i for i in kind if kind[i] == part]
        top = max(largest_ratio(free, problem, problem.parameters[i]) for i in places)
        base = free if found is None else found
        for factor in 0.98 * 1.5 ** -np.arange(18.0):
            trial = base
            for i in places:
                trial = trial.at[i].set(value_near(problem.parameters[i], factor * top, free))
            loss = float(loss_at(trial, problem)) if top > 0 else np.inf
            if loss < lowest:
                lowest, found = loss, trial
    return found


def holding_instead(
    free: Float[Array, " p"], problem: Problem, low: Bool[np.ndarray, " p"], variance: float
) -> Float[Array, " p"] | None:
    """Free numbers with a larger mu, just enough that nothing slips, that explain the data better, if there
    are any.

    Where all starts slip in what was recorded without slip, the other numbers make up for a mu that is too
    small, and the solver may end before it reaches one that holds. A `mu_kinetic` is left alone, as it
    cannot be above its `mu_static`, which is searched by its loss.
    """
    found = None
    lowest = float(loss_at(free, problem)) - NOTICEABLE * variance / 2
    for i in np.flatnonzero(low).tolist():
        parameter, base = problem.parameters[i], free if found is None else found
        if not parameter.path.endswith((".mu", f".{_OF_FINGER}")):
            continue
        enough = 1.02 * largest_ratio(raised(base, parameter, i), problem, parameter)
        trial = base.at[i].set(value_near(parameter, enough, base)) if enough > 0 else base
        loss = float(loss_at(trial, problem))
        if loss < lowest:
            lowest, found = loss, trial
    return found


def is_needed(bound: float, free: Float[Array, " p"], problem: Problem, i: int, variance: float) -> bool:
    """Whether the data need a mu of about `bound`: with a tenth of it they are explained noticeably worse.

    Fingers on a surface whose forces are all below the noise need none, whatever the model has them do. A kinetic
    mu is lowered with its static one, which it is never above.
    """
    kinetic = problem.parameters[i].path.replace("mu_static", "mu_kinetic")
    less = free
    for j, parameter in enumerate(problem.parameters):
        own = (parameter.index, parameter.place) == (problem.parameters[i].index, problem.parameters[i].place)
        if j == i or (parameter.path == kinetic and own):
            less = less.at[j].set(value_near(parameter, bound / 10, free))
    enough = free.at[i].set(value_near(problem.parameters[i], 1.02 * bound, free))
    grown = 2 * (float(loss_at(less, problem)) - float(loss_at(enough, problem)))
    return grown > NOTICEABLE * variance


def value_near(parameter: Parameter, value: Any, like: Any) -> Array:
    """The unconstrained number of a value, or of several, moved between the parameter's bounds where it is not."""
    transform = parameter.transform
    if isinstance(transform, Logit):
        margin = 1e-3 * (transform.high - transform.low)
        value = np.clip(value, transform.low + margin, transform.high - margin)
    return transform.free(jnp.asarray(value, like.dtype))


def largest_ratio(free: Float[Array, " p"], problem: Problem, parameter: Parameter) -> float:
    """The mu, or factor of a finger, that the largest ratio of tangential to normal force in the model of the recordings
    asks for; 0 where nothing touches.

    Of a mu of one face, only touches on that face count, of a factor those of its finger. Touches of less than a
    thousandth of the firmest one are left out: their ratio is a quotient of rounding errors.
    """
    largest = 0.0
    for group in problem.groups:
        own = np.flatnonzero((group.places == parameter.place) | (parameter.place is None))
        if not len(own):
            continue
        grip = _grips_in(free, problem, group, own)[_part(parameter)]
        normal, tangential = gathered(grip.normal_force), gathered(grip.friction_force)
        if group.steps is not None:  # beyond, nothing was recorded
            steps = gathered(group.steps)[own][:, None, None]
            normal = np.where(np.arange(normal.shape[1])[:, None] < steps, normal, 0)
        firm = normal > 1e-3 * normal.max(initial=0)
        beside, index = gathered(grip.factor), parameter.index
        if _is_of_finger(parameter):
            beside = gathered(grip.mu)
            firm &= np.arange(firm.shape[-1]) == index
        elif index is not None:
            firm &= gathered(grip.face) == index
        firm &= beside > 0
        largest = max(largest, float(np.max(tangential[firm] / (normal * beside)[firm], initial=0)))
    return largest


def _grips_in(
    free: Float[Array, " p"], problem: Problem, group: Observation, some: Int[np.ndarray, " R"]
) -> dict[str, Grip]:
    """The grip in some of a group's recordings: in all, unless each has numbers of its own."""
    if not (problem.apart or problem.starts):
        setup = problem.setup_at(free)
        return grips(setup.scene, setup.sensor.turned(group.hips), group.gimbals, layout=group.layout)
    found = []
    for i in some.tolist():
        setup, gimbals = problem.setup_at(free, int(group.places[i])), group.gimbals
        own = None if gimbals is None else gimbals[i][None]
        found.append(grips(setup.scene, setup.sensor.turned(group.hips[i])[None], own, setup.start))
    return jax.tree.map(lambda *x: jnp.concatenate(x), *found)


@partial(jax.jit, static_argnames="layout")
def grips(
    scene: Scene,
    hips: Float[Array, "R T F 3"],
    gimbals: Float[Array, "R T F"] | None,
    starts: Starts | None = None,
    layout: Layout | None = None,
) -> dict[str, Grip]:
    """The grip of every finger on every object, and of every contact's points, by path, over time, of recordings that begin
    alike."""

    def one(shared, recording):
        (scene, starts), (path, angles) = shared, recording
        state, reply = played(scene, path, angles, starts=starts or {})
        found, lost = {}, reply.lost[:, None]

        def grip_of(touch, surface, face, direction):
            normal, friction = touch.normal_force, safe.norm(touch.friction_force)
            mu = surface.mu if surface.mu_static is None else surface.mu_static
            mu = jnp.broadcast_to(mu[face] if mu.ndim else mu, face.shape)
            factor = jnp.ones_like(normal[0]) if surface.finger_mu is None else surface.finger_mu
            factor = jnp.broadcast_to(factor, normal.shape)
            return Grip(jnp.where(lost, 0, normal), jnp.where(lost, 0, friction), face, mu, factor, direction)

        for name, touch in reply.touch.items():
            thing = scene.object[name]
            position, orientation = thing.position[None], rotation.normalise(thing.orientation)[None]
            if name in state.motion:  # where it was at the start of each step
                first, pose = state.motion[name], reply.pose[:, scene.moving().index(name)]
                position = jnp.concatenate([first.position[None], pose[:-1, :3]])
                orientation = jnp.concatenate([first.orientation[None], pose[:-1, 3:]])
            matrix = jnp.broadcast_to(jax.vmap(rotation.to_matrix)(orientation), (len(path), 3, 3))
            local = jax.vmap(rotation.turn_back)(matrix, path - position[:, None, :])
            near = jax.vmap(jax.vmap(thing.shape.closest))(local)
            direction = jax.vmap(rotation.turn)(matrix, near.normal)
            found[f"object.{name}"] = grip_of(touch, thing.surface, near.face, direction)
        for name, touch in reply.contact.items():
            face = jnp.zeros(touch.normal_force.shape, jnp.int32)
            found[f"contact.{name}"] = grip_of(touch, scene.contact[name], face, None)
        return found

    return each(one, (scene, starts), (hips, gimbals), layout)


def _part(parameter: Parameter) -> str:
    return ".".join(parameter.path.split(".")[:2])
