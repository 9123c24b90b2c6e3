"""Losses that outliers pull on less than on the squares: Huber's and Student's."""

import warnings
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from .noise import correlation_time
from .solve import Solutions, jacobian

LOSSES = ("squares", "huber", "student")
_HUBER = 1.345  # standard deviations: 95 % efficient where the noise is Gaussian (Huber 1981, section 4.3)
_STUDENT = 4.0  # degrees of freedom (Lange, Little, Taylor 1989)
_BOX = 3.0  # how far the last solver may go, in transformed numbers


def rooted(residuals: Float[Array, "*n"], loss: str) -> Float[Array, "*n"]:
    """Numbers of the residuals' sign, half the square of which is the loss: what a least-squares solver minimises."""
    if loss == "squares":
        return residuals
    size = jnp.abs(residuals)
    if loss == "huber":
        beyond = jnp.sqrt(_HUBER * (2 * jnp.maximum(size, _HUBER) - _HUBER))
        return jnp.where(size <= _HUBER, residuals, jnp.sign(residuals) * beyond)
    square = residuals**2 / _STUDENT
    # log(1 + x) / x, by its series where x is so small that the quotient has no derivative.
    tiny = square < 1e-6
    quotient = jnp.where(tiny, 1 - square / 2, jnp.log1p(square) / jnp.where(tiny, 1, square))
    return residuals * jnp.sqrt((_STUDENT + 1) / _STUDENT * quotient)


def unrooted(rooted: Float[np.ndarray, "*n"], loss: str) -> Float[np.ndarray, "*n"]:
    """The residuals again."""
    if loss == "squares":
        return rooted
    if loss == "huber":
        beyond = np.sign(rooted) * (rooted**2 + _HUBER**2) / (2 * _HUBER)
        return np.where(np.abs(rooted) <= _HUBER, rooted, beyond)
    return np.sign(rooted) * np.sqrt(_STUDENT * np.expm1(rooted**2 / (_STUDENT + 1)))


def slope(residuals: Float[np.ndarray, "*n"], loss: str) -> Float[np.ndarray, "*n"]:
    """psi: the derivative of the loss."""
    if loss == "huber":
        return np.clip(residuals, -_HUBER, _HUBER)
    return (_STUDENT + 1) * residuals / (_STUDENT + residuals**2)


def spread(residuals: Float[np.ndarray, "*n"], loss: str) -> tuple[float, float]:
    """mean psi^2 over mean psi', and over its square: what stands for the variance of a residual in the loss, and in the
    covariance of an estimate (Huber 1981, section 7.6)."""
    if loss == "huber":
        curvature = np.mean(np.abs(residuals) <= _HUBER)
    else:
        square = residuals**2
        curvature = np.mean((_STUDENT + 1) * (_STUDENT - square) / (_STUDENT + square) ** 2)
    curvature = max(float(curvature), 1e-3)  # the model explains next to nothing
    square = float(np.mean(slope(residuals, loss) ** 2))
    return square / curvature, square / curvature**2


def spreads(
    channels: Sequence[tuple[str, Float[np.ndarray, "_ _ _"]]], given: Mapping[str, float] | None, loss: str
) -> tuple[float, Float[np.ndarray, " n"]]:
    """What stands for the variance of a residual in the loss, on average, and for each in the covariance.

    Where noise was estimated, times how many neighbours err alike.
    """
    typical, rows = [], []
    for key, r in channels:
        in_loss, in_covariance = spread(r, loss)
        alike = 1.0 if key in (given or {}) else correlation_time([slope(r, loss)])
        typical.append(np.full(r.size, in_loss * alike))
        rows.append(np.full(r.size, in_covariance * alike))
    return float(np.mean(np.concatenate(typical))), np.concatenate(rows)


def straight(
    matrix: Float[np.ndarray, "n p"], rooted_: Float[np.ndarray, " n"], measured: int, loss: str
) -> Float[np.ndarray, "n p"]:
    """The Jacobian of the residuals, from that of their roots; the rows after the `measured` ones are priors."""
    data = rooted_[:measured]
    raw = unrooted(data, loss)
    at_0 = 1.0 if loss == "huber" else np.sqrt((_STUDENT + 1) / _STUDENT)
    near = np.abs(data) < 1e-6
    rate = np.where(near, at_0, slope(raw, loss) / np.where(near, 1, data))
    return np.concatenate([matrix[:measured] / rate[:, None], matrix[measured:]])


def polished(residuals: Any, ends: Solutions, args: Any) -> Solutions:
    """The best end, brought to the minimum of the loss itself by L-BFGS-B (jaxopt).

    Levenberg-Marquardt takes the curvature of `rooted` residuals for that of their squares, and may stop short.
    """
    best = ends.best
    free, loss = _descended(residuals, ends.free[best], args)
    if not float(loss) < float(ends.loss[best]):
        return ends
    matrix, found = _jacobian(residuals, free, args)
    return Solutions(
        ends.free.at[best].set(free),
        ends.loss.at[best].set(loss),
        ends.converged,
        ends.steps,
        found,
        matrix,
    )


_jacobian = jax.jit(jacobian, static_argnums=0)


@partial(jax.jit, static_argnums=0)
def _descended(residuals: Any, begin: Float[Array, " p"], args: Any) -> tuple[Array, Array]:
    with warnings.catch_warnings():
        warnings.filterwarnings(
            "ignore", message=".*JAXopt is no longer maintained.*", category=DeprecationWarning
        )
        import jaxopt

    def loss(free, args):
        matrix, found = jacobian(residuals, free, args)  # forward mode: the numbers are few
        return 0.5 * jnp.sum(found**2), found @ matrix

    box = (begin - _BOX, begin + _BOX)
    tolerance = 1e-6 if begin.dtype == jnp.float64 else 1e-3
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        solver = jaxopt.LBFGSB(loss, value_and_grad=True, maxiter=50, tol=tolerance)
        end = solver.run(begin, bounds=box, args=args).params
    return end, loss(end, args)[0]
