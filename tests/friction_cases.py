"""Friction laws and ways over a plane that several tests share."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import hapjax

TWO = dict(mu_static=0.5, mu_kinetic=0.3)
LAWS = {
    "cone": (hapjax.Cone(), TWO),
    "viscous": (hapjax.Viscous(0.7), TWO),
    "stribeck": (hapjax.Stribeck(0.02, 0.7), TWO),
    "karnopp": (hapjax.Karnopp(1e-3), TWO),
    "dahl": (hapjax.Dahl(), dict(mu=0.4)),
    "lugre": (hapjax.LuGre(0.02, 0.7, 0.02), TWO),
}

drag = jax.jit(hapjax.drag)


def surface(name, stiffness: Any = 2000.0, **changes: Any) -> hapjax.Surface:
    """A surface with a law; `changes` are other numbers of it."""
    law, mu = LAWS[name]
    return hapjax.Surface(stiffness, friction=law, **mu | changes)


def as_type(law: hapjax.Surface, dtype) -> hapjax.Surface:
    """The surface with all its numbers of one precision."""
    return jax.tree.map(lambda x: x.astype(dtype), law)


def line(x):
    """Places x (T,) or (T, V) m on the x axis as a path (T, V, 3)."""
    x = np.asarray(x, float).reshape(len(x), -1)
    return jnp.asarray(np.stack([x, 0 * x, 0 * x], axis=-1))


def steady(law, speeds, load=1.5, dt=1e-3, steps=3000):
    """The force against motion (V,) N after a long slide at constant speeds (V,) m/s, and its largest on the way."""
    way = np.arange(steps)[:, None] * dt * np.asarray(speeds)
    force = -np.asarray(drag(law, line(way), jnp.full(len(speeds), load), dt))[..., 0]
    return force[-1], force.max(axis=0)


def pressed(law: hapjax.Surface, offset, velocity, sliding, viscous, dt, load=None):
    """What a law does to a point under a load of 1 N that has gone on for one step at a velocity (m/s) along x."""
    unit = jnp.array([1, 0, 0], dt.dtype)
    travel = velocity * dt * unit
    load = jnp.ones_like(dt) if load is None else load
    near = hapjax.Plane().closest(jnp.zeros_like(unit))
    offset = offset * unit - travel
    held = law.hold(near, offset, load, viscous * unit, travel, sliding, jnp.zeros_like(dt), dt)
    return held.offset[0], held.force[0], held.sliding
