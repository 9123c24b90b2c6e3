"""What several test files share."""

import contextlib
import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

import hapjax

G = 9.81
# For the few programs that run for longer than they compile: tests/conftest.py has all others compiled in haste.
well_compiled = functools.partial(jax.jit, compiler_options={"xla_backend_optimization_level": 3})


def followed(monkeypatch, *modules) -> list[dict[str, float]]:
    """The bars that the modules show while the test runs: of each the total, how much was told, and if it is drawn apart."""
    bars = []

    @contextlib.contextmanager
    def following(total, apart=False, **_):
        bar = {"total": total, "told": 0.0, "apart": apart}
        bars.append(bar)

        def advance(doing, steps):
            bar["told"] += steps

        yield advance

    for module in modules:
        monkeypatch.setattr(module, "following", following)
    return bars


def matrix(wxyz) -> np.ndarray:
    """The rotation matrix of a quaternion w x y z, by SciPy."""
    return Rotation.from_quat(np.asarray(wxyz, float), scalar_first=True).as_matrix()


def quaternion(axis, angle) -> tuple[float, ...]:
    """The quaternion w x y z of a turn by `angle` rad about `axis`."""
    axis = np.asarray(axis, float) / np.linalg.norm(axis)
    return (float(np.cos(angle / 2)), *(np.sin(angle / 2) * axis).tolist())


def angle_between(p, q) -> float:
    """The angle in rad between two orientations w x y z."""
    p, q = (Rotation.from_quat(np.asarray(x, float), scalar_first=True) for x in (p, q))
    return float((p * q.inv()).magnitude())


def order(steps, errors) -> float:
    """The order of convergence: the slope of log error over log step."""
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


def moving(state: hapjax.State, name: str, **changes) -> hapjax.State:
    """The state with other velocity, spin, position or orientation of one object."""
    for field, value in changes.items():
        old = getattr(state.motion[name], field)
        new = jnp.asarray(value, old.dtype)
        state = eqx.tree_at(lambda s, f=field: getattr(s.motion[name], f), state, new)
    return state


def away(steps: int, fingers: int = 1) -> jax.Array:
    """Fingers that rest out of reach: (steps, fingers, 3) m."""
    return jnp.full((steps, fingers, 3), 10.0)


def at_rest(hip, steps: int) -> jax.Array:
    """Fingers that stay where they are: (steps, F, 3) m."""
    hip = jnp.asarray(hip)
    return jnp.broadcast_to(hip, (steps, *hip.shape))
