"""Synthetic recordings that several tests of fitting share."""

import jax.numpy as jnp
import numpy as np

from hapjax import Body, Box, Contact, Object, Plane, Recording, Scene, Surface, World, init, rollout
from hapjax_fitting.noise import noise_of
from hapjax_fitting.parameters import free_parameters
from hapjax_fitting.priors import priors_of
from hapjax_fitting.problem import Problem, grouped
from hapjax_fitting.sensors import Sensors, Setup, explicit

MU, STIFFNESS = "object.floor.surface.mu", "object.floor.surface.stiffness"
BOTH = [MU, STIFFNESS]
TRUTH = {MU: 0.6, STIFFNESS: 800.0}
SIGMA = 0.02  # N


def floor(mu=0.6, stiffness=800.0, **kinds) -> Scene:
    """A fixed floor; `kinds` are other numbers of its surface."""
    friction = {} if "mu_static" in kinds else {"mu": mu}
    return Scene(object={"floor": Object(Plane(), Surface(stiffness, **friction, **kinds))})


def stroke(steps=400, length=0.02, depth=0.0025, dt=1e-3):
    """One finger comes down on the floor, presses, and moves to and fro: times (T,) s and path (T, 1, 3) m."""
    t = dt * np.arange(steps)
    z = 0.001 - np.minimum(t / 0.05, 1) * (depth + 0.001) * (1 + 0.2 * np.sin(25 * t))
    x = length / 2 * (1 - np.cos(2 * np.pi * t / t[-1]))
    return t, np.stack([x, np.zeros_like(x), z], axis=-1)[:, None]


def forces(scene, path):
    """The scene's noiseless forces (T, F, 3) N."""
    path = jnp.asarray(path, scene.integrator.dt.dtype)
    return np.asarray(rollout(scene, init(scene, path[0]), path)[1].force)


def recorded(scene, seed=0, sigma=SIGMA, every=1, **way) -> Recording:
    """A stroke over a scene, with white noise on the force."""
    t, path = stroke(**way)
    clean = forces(scene, path)[::every]
    noise = sigma * np.random.default_rng(seed).standard_normal(clean.shape)
    return Recording(hip=path, hip_t=t, force=clean + noise, force_t=t[::every])


def held_cube(mass=0.2, stiffness=800.0) -> Scene:
    """A cube on a floor that two fingers can take hold of."""
    cube = Object(
        Box((0.06,) * 3),
        Surface(stiffness, mu=0.6, damping=1.0),
        Body(mass, inertia=(1.2e-4,) * 3),
        position=(0.0, 0.0, 0.03),
    )
    return Scene(
        object={"cube": cube, "floor": Object(Plane())},
        contact={"cube_on_floor": Contact(5000.0, mu=0.3, damping=0.5, between=("cube", "floor"))},
        world=World(gravity=(0.0, 0.0, -9.81)),
    )


def shaken_cube(seed=0, steps=400) -> Recording:
    """Two fingers squeeze the cube and shake it to and fro; forces and poses with noise."""
    t = 1e-3 * np.arange(steps)
    squeeze = np.interp(t, [0.0, 0.1], [0.0305, 0.026])
    shake = np.where(t > 0.1, 0.003 * np.sin(40 * (t - 0.1)) ** 2, 0)
    ends = [np.stack([side * squeeze + shake, 0 * t, 0.03 + 0.5 * shake], axis=-1) for side in (-1, 1)]
    path, scene = np.stack(ends, axis=1), held_cube()
    _, reply = rollout(scene, init(scene, path[0]), path)
    random = np.random.default_rng(seed)
    pose = np.asarray(reply.pose)[4::5].copy()
    pose[..., :3] += 1e-4 * random.standard_normal(pose[..., :3].shape)
    force = np.asarray(reply.force)
    return Recording(
        hip=path,
        hip_t=t,
        force=force + SIGMA * random.standard_normal(force.shape),
        force_t=t,
        pose=pose,
        pose_t=t[4::5] + 1e-3,  # a step's pose belongs to its end
    )


def problem_for(scene, recordings, free, each=(), known=None, loss="squares") -> Problem:
    """The problem of a fit, with noise that is given and priors that are `known`."""
    names = [f"r{i}" for i in range(len(recordings))]
    sensors = explicit(Sensors(), free, jnp.float64)
    parameters = free_parameters(Setup(scene, sensors), free, None, each, names)
    groups = grouped(scene, recordings, ("force", "pose"), names, parameters, sensors)
    noise = noise_of(recordings, {"force": SIGMA, "position": 1e-4, "angle": 2e-3}, jnp.float64)
    priors = priors_of(known, parameters, jnp.float64)
    return Problem(scene, groups, noise, parameters, sensors, priors, loss=loss)


def products(matrix, found):
    """The inner products of the columns of residuals and Jacobian."""
    rows = np.concatenate([np.asarray(found)[:, None], np.asarray(matrix)], axis=1)
    return rows.T @ rows
