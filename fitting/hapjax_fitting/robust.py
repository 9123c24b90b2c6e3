"""Losses that outliers pull on less than on the squares: Huber's and Student's."""

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
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
    if loss == "squares":
        return residuals
    if loss == "huber":
        return np.clip(residuals, -_HUBER, _HUBER)
    return (_STUDENT + 1) * residuals / (_STUDENT + residuals**2)


def curvature(residuals: Float[np.ndarray, "*n"], loss: str) -> Float[np.ndarray, "*n"]:
    """psi': the second derivative of a robust loss."""
    if loss == "huber":
        return (np.abs(residuals) <= _HUBER).astype(np.float64)
    square = residuals**2
    return (_STUDENT + 1) * (_STUDENT - square) / (_STUDENT + square) ** 2


def spread(residuals: Float[np.ndarray, "*n"], loss: str) -> tuple[float, float]:
    """mean psi^2 over mean psi', and over its square: what stands for the variance of a residual in the loss, and in the
    covariance of an estimate (Huber 1981, section 7.6)."""
    bend = max(float(np.mean(curvature(residuals, loss))), 1e-3)  # the model explains next to nothing
    square = float(np.mean(slope(residuals, loss) ** 2))
    return square / bend, square / bend**2


def spreads(
    channels: Sequence[tuple[str, Float[np.ndarray, "_ _ _"]]], given: Mapping[str, float] | None, loss: str
) -> tuple[float, Float[np.ndarray, " n"]]:
    """What stands for the variance of a residual in the loss, on average, and for each in the covariance.

    Where noise was estimated, times how many neighbours err alike.
    """
    typical, rows = [], {}
    parts: dict[str, list[np.ndarray]] = {}
    for key, r in channels:
        parts.setdefault(key, []).append(r)
    for key, of_channel in parts.items():
        in_loss, in_covariance = spread(np.concatenate([r.ravel() for r in of_channel]), loss)
        alike = 1.0 if key in (given or {}) else correlation_time([slope(r, loss) for r in of_channel])
        typical.append(np.full(sum(r.size for r in of_channel), in_loss * alike))
        rows[key] = in_covariance * alike
    return float(np.mean(np.concatenate(typical))), np.concatenate(
        [np.full(r.size, rows[k]) for k, r in channels]
    )


def polished(residuals: Any, reduced: Any, ends: Solutions, args: Any) -> Solutions:
    """The best end, brought to the minimum of the loss itself by L-BFGS-B (jaxopt); its Jacobian is that of the residuals
    themselves.

    Levenberg-Marquardt takes the curvature of `rooted` residuals for that of their squares, and may stop short.
    """
    best = ends.best
    free, loss = _descended(residuals, ends.free[best], args)
    if float(loss) < float(ends.loss[best]):
        ends = replace(ends, free=ends.free.at[best].set(free), loss=ends.loss.at[best].set(loss))
    return replace(ends, jacobian=_reduced(reduced, ends.free[best], replace(args, loss="squares")))


@partial(jax.jit, static_argnums=0)
def _reduced(reduced: Any, free: Float[Array, " p"], args: Any) -> Array:
    return reduced(free, args)[0]


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
