"""The closed haptic loop: how stiff a virtual wall can be before a device that presses on it shakes.

J. E. Colgate and G. G. Schenkel, Passivity of a class of sampled-data systems: application to haptic interfaces,
Journal of Robotic Systems 14, 1997.
"""

from collections.abc import Callable, Sequence
from itertools import product
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..scene import Object, Scene, cast
from ..shape import Plane
from ..simulate import init, step
from ..surface import Surface

RATES = (500.0, 1000.0, 2000.0, 4000.0)  # Hz
MASSES = (0.05, 0.15, 0.5)  # kg
DAMPINGS = tuple(10.0 ** np.linspace(-1.5, 1, 6))  # N s/m
DELAYS = (0, 1, 2)  # samples
SECONDS = 3.0
PUSH = 1.0  # N, with which the device is pressed on the wall
DISTURBANCE = 0.01  # of the depth at rest
LONGEST = 16  # samples of delay
SOFTEST, STIFFEST, HALVINGS = 1.0, 1e7, 16  # N/m; of the decades between: to 0.03 %


class Limit(NamedTuple):
    """Of a device (`mass` kg, `damping` N s/m) in a loop (`rate` Hz, `delay` in samples): stiffnesses in N/m.

    `stable`: the largest that simulation finds stable; `passive`: the largest that is passive, whoever holds the device.
    """

    mass: float
    damping: float
    rate: float
    delay: int
    stable: float
    passive: float


def passive_stiffness(damping: float, rate: float, delay: int = 0) -> float:
    """The largest passive stiffness of a wall, N/m: b > K T / 2 (Colgate and Schenkel 1997), and with a delay of d samples
    b > K T (1/2 + d).

    Their condition is b > T/2 Re[(1 - e^-jwT) H] / (1 - cos wT) at all frequencies. With H = K e^-jwTd its right side
    is K T/2 sin((2 d + 1) wT/2) / sin(wT/2), a Dirichlet kernel, whose largest value is that at w = 0.
    """
    return damping * rate / (0.5 + delay)


def measure(
    rates: Sequence[float] = RATES,
    masses: Sequence[float] = MASSES,
    dampings: Sequence[float] = DAMPINGS,
    delays: Sequence[int] = DELAYS,
    advance: Callable[[str, float], object] = lambda doing, steps: None,
) -> list[Limit]:
    """The largest stable stiffness of every device in every loop, by bisection; needs 64-bit numbers on.

    A device is pressed on the wall with a constant force, and put off its place of rest by a hundredth of the depth. It is
    stable where the largest swing in the last third of 3 s is smaller than in the first third, and than at the start.
    """
    limits = []
    for rate in rates:
        grid = list(product(masses, dampings, delays))
        mass, damping, delay = (np.array(column) for column in zip(*grid, strict=True))
        low, high = np.full(len(grid), np.log(SOFTEST)), np.full(len(grid), np.log(STIFFEST))
        for _ in range(HALVINGS):
            advance(f"closed loop at {rate:g} Hz", 0.0)
            middle = (low + high) / 2
            calm = np.asarray(_calm(np.exp(middle), mass, damping, delay, 1 / rate, round(SECONDS * rate)))
            low, high = np.where(calm, middle, low), np.where(calm, high, middle)
            advance(f"closed loop at {rate:g} Hz", SECONDS * rate)
        limits += [
            Limit(m, float(b), rate, d, float(np.exp(k)), passive_stiffness(float(b), rate, d))
            for (m, b, d), k in zip(grid, low, strict=True)
        ]
    return limits


def work(rates: Sequence[float] = RATES) -> float:
    """The sum of the steps that `measure` tells `advance` of."""
    return sum(HALVINGS * SECONDS * rate for rate in rates)


def _calm(stiffness, mass, damping, delay, period: float, count: int) -> Array:
    numbers = (jnp.asarray(x, jnp.float64) for x in (stiffness, mass, damping))
    return _many(
        *numbers,
        jnp.asarray(delay, jnp.int32),
        jnp.asarray(period, jnp.float64),
        jnp.asarray(count, jnp.int32),
    )


def _one(
    stiffness: Float[Array, ""],
    mass: Float[Array, ""],
    damping: Float[Array, ""],
    delay: Int[Array, ""],
    period: Float[Array, ""],
    count: Int[Array, ""],
) -> Array:
    """Whether a device's swing dies away."""
    wall = Object(Plane(), Surface(stiffness, mu=jnp.zeros_like(stiffness)))
    scene = cast(Scene({"wall": wall}), stiffness.dtype)
    rest = -PUSH / stiffness
    first = rest * (1 + DISTURBANCE)
    decay = jnp.exp(-damping * period / mass)
    where = jnp.zeros((LONGEST + 1, 3), stiffness.dtype).at[:, 2].set(first)  # the last samples, a ring

    def body(i, carry):
        state, seen, x, v, early, late = carry
        seen = seen.at[i % (LONGEST + 1), 2].set(x)
        state, reply = step(scene, state, seen[(i - delay) % (LONGEST + 1)][None], period)
        pace = (reply.force[0, 2] - PUSH) / damping  # at which it would go in the end under this force
        # Exact for a force that is held: m x'' = f - b x'.
        x, v = x + pace * period + (v - pace) * (1 - decay) * mass / damping, pace + (v - pace) * decay
        swing = jnp.abs(x - rest)
        early = jnp.where(3 * i < count, jnp.maximum(early, swing), early)
        late = jnp.where(3 * i >= 2 * count, jnp.maximum(late, swing), late)
        return state, seen, x, v, early, late

    nothing = jnp.zeros_like(stiffness)
    start = (init(scene, where[:1]), where, first, nothing, nothing, nothing)
    *_, early, late = jax.lax.fori_loop(0, count, body, start)
    # A shaking that has left the wall has an even swing, far larger than at the start. NaN is not calm.
    return (late < early) & (late < jnp.abs(first - rest))


_many = jax.jit(jax.vmap(_one, in_axes=(0, 0, 0, 0, None, None)))
