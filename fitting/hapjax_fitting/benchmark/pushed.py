"""A block that a finger pushes over a plane, and leaves to come to rest: its motion in closed form.

The finger is a spring between where it is led, at constant speed and then not at all, and the block. While the spring
pushes with less than mu m g the block holds; then it slides as a mass on a spring does, less mu m g, and once it has come
to rest it stays there. That is Coulomb's and Newton's law alone, of no program's contact.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hapjax import Body, Box, Contact, Object, Plane, Recording, Scene, SemiImplicit, Surface, World

MU, MASS = 0.5, 0.2  # -, kg
TRUTH = (MU, MASS)
STIFFNESS, SPEED, G, HALF = 800.0, 0.05, 9.81, 0.03  # N/m, m/s, m/s^2, m
LED, SECONDS, RATE = 0.2, 0.3, 1000  # s for which the finger is led, s of recording, samples/s
NOISE = {"force": 0.02, "position": 1e-4}  # N, m
FREE = ("contact.block_on_floor.mu", "object.block.body.mass")
DT = 5e-4  # s, of both programs
_HEIGHT = 0.02  # m, of the finger


def law(
    numbers: Float[Array, "2"], times: Float[np.ndarray, " T"]
) -> tuple[Float[Array, " T"], Float[Array, " T"]]:
    """How far the block is (m), and the force on it (N), for mu and mass, with the block as first at rest.

    The spring is pressed in by v t until it pushes with mu m g, and by mu m g / k + (v / w) sin(w s) after that, with
    w^2 = k / m. With the finger at rest it is mu m g / k + A cos(w s) + B sin(w s) until that no longer changes. For numbers
    with which the spring is pressed all the time: the finger does not pull.
    """
    mu, mass = numbers
    rate = jnp.sqrt(STIFFNESS / mass)
    enough = mu * mass * G / STIFFNESS
    begins = enough / SPEED
    slid = jnp.clip(times - begins, 0, LED - begins)
    led = jnp.where(times < begins, SPEED * times, enough + SPEED / rate * jnp.sin(rate * slid))
    phase = rate * (LED - begins)
    along, across = SPEED / rate * jnp.sin(phase), SPEED / rate * (jnp.cos(phase) - 1)
    rests = jnp.mod(jnp.arctan2(across, along), jnp.pi) / rate
    left = rate * jnp.clip(times - LED, 0, rests)
    depth = jnp.where(times < LED, led, enough + along * jnp.cos(left) + across * jnp.sin(left))
    return SPEED * jnp.minimum(times, LED) - depth, STIFFNESS * depth


def recorded(seed: int) -> Recording:
    """The finger's path, and the force and the block's place with white noise."""
    random, t = np.random.default_rng(seed), np.arange(round(SECONDS * RATE)) / RATE
    place, force = (np.asarray(x) for x in law(jnp.array(TRUTH), t))
    hip, pushed, pose = np.zeros((len(t), 1, 3)), np.zeros((len(t), 1, 3)), np.zeros((len(t), 1, 7))
    hip[:, 0, 0], hip[:, 0, 2] = SPEED * np.minimum(t, LED) - HALF, _HEIGHT
    pushed[:, 0, 0] = -force  # on the finger
    pose[:, 0, 0], pose[:, 0, 2], pose[:, 0, 3] = place, HALF, 1
    pose[..., :3] += NOISE["position"] * random.standard_normal((len(t), 1, 3))
    pushed += NOISE["force"] * random.standard_normal(pushed.shape)
    return Recording(hip=hip, hip_t=t, force=pushed, force_t=t, pose=pose, pose_t=t)


def least_errors() -> Float[np.ndarray, "2"]:
    """The bound of Cramer and Rao on the standard errors of mu and mass (kg), from the closed form."""
    t = np.arange(round(SECONDS * RATE)) / RATE
    by_place, by_force = jax.jacfwd(lambda numbers: law(numbers, t))(jnp.array(TRUTH))
    slopes = np.concatenate([by_place / NOISE["position"], by_force / NOISE["force"]])
    return np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)))


def scene(mu: float, mass: float) -> Scene:
    """The block on four corners, at its resting depth, as stiff as half of what the step bears (dt w = 1)."""
    stiffness = MASS / (4 * DT**2)
    sunk = MASS * G / (4 * stiffness)
    block = Object(
        Box((2 * HALF,) * 3), Surface(STIFFNESS, mu=0.5), Body(mass, rotation=False), (0, 0, HALF - sunk)
    )
    pair = Contact(stiffness, mu=mu, damping=20.0, between=("block", "floor"))
    return Scene(
        {"block": block, "floor": Object(Plane())},
        {"block_on_floor": pair},
        world=World(gravity=(0.0, 0.0, -G)),
        integrator=SemiImplicit(DT),
    )
