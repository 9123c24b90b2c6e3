"""How near estimates come to the truth, beside the least error that is possible, and how often intervals hold it."""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hapjax import Scene
from hapjax.progress import Advance

from ..fit import fit
from ..parameters import Parameter, free_parameters, values_of, with_values
from .cases import CASES, Case, answer

_HALVINGS, _SAME = 40, 1e-9  # N
_OFF = 0.03  # how far the start is off, as a share of the number


def measure(
    name: str, draws: int, seed: int = 0, advance: Advance = lambda doing, steps: None
) -> tuple[dict[str, Any], Float[np.ndarray, "n p 3"]]:
    """Fit so many recordings of a case, and compare; also each fit's estimates, and ends of 95 % intervals.

    Of each number: `truth`; `rmse`, root mean square error; `bound`, the least that an estimator without bias can
    have; `ratio` of the two; `cover`, the share of 95 % intervals that hold the truth; `identified`, in how many fits.
    The bound of a number by which the forces change smoothly is Cramer and Rao's, from the Fisher information at
    the truth. Of mu_static, by which they jump, it is the error of the middle of all values that give the very same
    forces, between which nothing can tell: their width over the square root of 12.
    """
    case = CASES[name]
    truth = case.truth()
    parameters = free_parameters(truth, case.free)
    values = np.asarray(values_of(truth, parameters))
    rows, bounds = [], []
    for draw in range(draws):
        recording = case.recorded(seed + draw)
        off = 1 + _OFF * np.random.default_rng(draw).uniform(-1, 1, len(values))
        start = with_values(truth, parameters, jnp.asarray(values * off))
        result = fit(start, recording, case.free, noise=case.noise, starts=1)
        rows.append([_row(estimate) for estimate in result.parameters.values()])
        bounds.append(least_variance(case, parameters, jnp.asarray(recording.hip)))
        advance(name, 1.0)
    estimates, variances = np.array(rows), np.array(bounds)
    numbers = [
        {"name": p.name, "held_against": "uniform" if _jumps(p) else "Cramer-Rao"}
        | _figures(values[i], estimates[:, i], variances[:, i])
        for i, p in enumerate(parameters)
    ]
    return {"case": name, "draws": draws, "parameters": numbers}, estimates


def _row(estimate) -> list[float]:
    if not estimate.identified:
        return [np.nan] * 3
    return [estimate.estimate, *estimate.interval95]


def _figures(
    truth: float, rows: Float[np.ndarray, "n 3"], variances: Float[np.ndarray, " n"]
) -> dict[str, Any]:
    """Of a fit that gives no estimate, none counts; how many did is said."""
    known = np.isfinite(rows).all(axis=1)
    value, low, high = rows[known].T
    rmse, bound = np.sqrt(np.mean((value - truth) ** 2)), np.sqrt(np.mean(variances[known]))
    return {
        "truth": float(truth),
        "rmse": float(rmse),
        "bound": float(bound),
        "ratio": float(rmse / bound),
        "cover": float(np.mean((low <= truth) & (truth <= high))),
        "identified": int(known.sum()),
    }


def _jumps(parameter: Parameter) -> bool:
    return parameter.path.endswith(".mu_static")


def least_variance(
    case: Case, parameters: tuple[Parameter, ...], path: Float[Array, "T F 3"]
) -> Float[np.ndarray, " p"]:
    """The least variance of each number's estimate, for one motion and the case's noise."""
    truth, smooth = case.truth(), np.array([not _jumps(p) for p in parameters])
    values = values_of(truth, parameters)
    changes = _changes(truth, values, path, parameters)
    slopes = np.concatenate(
        [np.asarray(x) / case.noise[key] for key, x in changes.items() if key in case.noise]
    )
    found = np.empty(len(parameters))
    found[smooth] = np.diag(np.linalg.inv(slopes[:, smooth].T @ slopes[:, smooth]))
    for i in np.flatnonzero(~smooth):
        low, high = _alike(truth, values, path, parameters, int(i))
        found[i] = float(high - low) ** 2 / 12
    return found


@partial(jax.jit, static_argnums=3)
def _changes(truth: Scene, values, path, parameters: tuple[Parameter, ...]) -> dict[str, Float[Array, "n p"]]:
    """What a change of each number does to force (N), position (m) and angle (rad)."""

    def said(values):
        force, pose = answer(with_values(truth, parameters, values), path)
        return force, pose

    _, pose = said(values)
    by_force, by_pose = jax.jacfwd(said)(values)
    w, v = pose[..., 3:4, None], pose[..., 4:, None]
    dw, dv = by_pose[..., 3:4, :], by_pose[..., 4:, :]
    # Twice the vector part of the conjugate times the change: the rotation vector in the object's frame.
    angle = 2 * (w * dv - dw * v - jnp.cross(v, dv, axis=-2))
    flat = {"force": by_force, "position": by_pose[..., :3, :], "angle": angle}
    return {key: x.reshape(-1, values.shape[0]) for key, x in flat.items()}


@partial(jax.jit, static_argnums=(3, 4))
def _alike(truth: Scene, values, path, parameters: tuple[Parameter, ...], i: int):
    """The lowest and highest value of a number that give the very forces that the truth gives, by bisection."""
    force, _ = answer(with_values(truth, parameters, values), path)

    def edge(outside):
        def halved(_, ends):
            inside, outside = ends
            middle = (inside + outside) / 2
            other, _ = answer(with_values(truth, parameters, values.at[i].set(middle)), path)
            same = jnp.max(jnp.abs(other - force)) < _SAME
            return jnp.where(same, middle, inside), jnp.where(same, outside, middle)

        return jax.lax.fori_loop(0, _HALVINGS, halved, (values[i], outside))[1]

    return edge(values[i] / 2), edge(values[i] * 2)
