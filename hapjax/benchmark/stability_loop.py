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
from scipy.linalg import expm

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


class Hand(NamedTuple):
    """A hand that moves with the device: its `mass` (kg), `stiffness` (N/m) and `damping` (N s/m)."""

    mass: float = 0.0
    stiffness: float = 0.0
    damping: float = 0.0


ALONE, HELD = Hand(), Hand(0.15, 400.0, 2 * np.sqrt(400.0 * 0.15))  # the second is a virtual operator's


class Limit(NamedTuple):
    """Of a device (`mass` kg, `damping` N s/m) in a loop (`rate` Hz, `delay` in samples): stiffnesses in N/m.

    `stable`: the largest that simulation finds stable with the device alone, and `held` with it in a hand (`HELD`).
    `passive`: the largest that is passive, whoever holds the device; `passive_held`: whoever else holds it beside that
    hand, whose damping counts as the device's.
    """

    mass: float
    damping: float
    rate: float
    delay: int
    stable: float
    passive: float
    held: float
    passive_held: float


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

    A device, alone and in a hand, is pressed on the wall with a constant force, and put off its place of rest by a
    hundredth of the depth. It is stable where the largest swing in the last third of 3 s is smaller than in the first
    third, and than at the start.
    """
    limits = []
    for rate in rates:
        grid = list(product(masses, dampings, delays))
        delay = np.array([d for _, _, d in grid])
        border = {}
        for hand in (ALONE, HELD):
            motion = [_motion(m + hand.mass, hand.stiffness, b + hand.damping, 1 / rate) for m, b, _ in grid]
            border[hand] = _stiffest(np.stack(motion), delay, rate, advance).tolist()
        for (m, b, d), alone, held in zip(grid, border[ALONE], border[HELD], strict=True):
            passive, beside = (passive_stiffness(float(b + hand.damping), rate, d) for hand in (ALONE, HELD))
            limits.append(Limit(m, float(b), rate, d, alone, passive, held, beside))
    return limits


def work(rates: Sequence[float] = RATES) -> float:
    """The sum of the steps that `measure` tells `advance` of."""
    return sum(2 * HALVINGS * SECONDS * rate for rate in rates)


def _stiffest(motion: np.ndarray, delay: np.ndarray, rate: float, advance) -> np.ndarray:
    """The stiffest walls (N/m) that are stable at `rate` (Hz), by bisection of their logarithms."""
    low, high = np.full(len(motion), np.log(SOFTEST)), np.full(len(motion), np.log(STIFFEST))
    period, count = jnp.asarray(1 / rate, jnp.float64), jnp.asarray(round(SECONDS * rate), jnp.int32)
    for _ in range(HALVINGS):
        advance(f"closed loop at {rate:g} Hz", 0.0)
        middle = (low + high) / 2
        stiffness = jnp.asarray(np.exp(middle))
        calm = np.asarray(_many(stiffness, jnp.asarray(motion), jnp.asarray(delay, jnp.int32), period, count))
        low, high = np.where(calm, middle, low), np.where(calm, high, middle)
        advance(f"closed loop at {rate:g} Hz", SECONDS * rate)
    return np.exp(low)


def _motion(mass: float, stiffness: float, damping: float, period: float) -> Float[np.ndarray, "2 3"]:
    """What place and speed become in `period` s of place, speed and a force that is held: exact."""
    # m x'' = f - b x' - k x
    rates = np.array([[0, 1, 0], [-stiffness / mass, -damping / mass, 1 / mass], [0, 0, 0]])
    return expm(period * rates)[:2]


def _one(
    stiffness: Float[Array, ""],
    motion: Float[Array, "2 3"],
    delay: Int[Array, ""],
    period: Float[Array, ""],
    count: Int[Array, ""],
) -> Array:
    """Whether a device's swing dies away."""
    wall = Object(Plane(), Surface(stiffness, mu=jnp.zeros_like(stiffness)))
    scene = cast(Scene({"wall": wall}), stiffness.dtype)
    rest = -PUSH / stiffness
    first = rest * (1 + DISTURBANCE)
    where = jnp.zeros((LONGEST + 1, 3), stiffness.dtype).at[:, 2].set(first)  # the last samples, a ring

    def body(i, carry):
        state, seen, x, v, early, late = carry
        seen = seen.at[i % (LONGEST + 1), 2].set(x)
        state, reply = step(scene, state, seen[(i - delay) % (LONGEST + 1)][None], period)
        # The hand's spring is slack where the device is to rest, and the push its own.
        x, v = motion @ jnp.stack([x - rest, v, reply.force[0, 2] - PUSH])
        x = x + rest
        swing = jnp.abs(x - rest)
        early = jnp.where(3 * i < count, jnp.maximum(early, swing), early)
        late = jnp.where(3 * i >= 2 * count, jnp.maximum(late, swing), late)
        return state, seen, x, v, early, late

    nothing = jnp.zeros_like(stiffness)
    start = (init(scene, where[:1]), where, first, nothing, nothing, nothing)
    *_, early, late = jax.lax.fori_loop(0, count, body, start)
    # A shaking that has left the wall has an even swing, far larger than at the start. NaN is not calm.
    return (late < early) & (late < jnp.abs(first - rest))


_many = jax.jit(jax.vmap(_one, in_axes=(0, 0, 0, None, None)))
