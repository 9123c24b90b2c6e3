"""The posterior of the free numbers, by NUTS: what is left where no parabola describes the likelihood."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from hapjax import InputError
from hapjax.extras import need
from hapjax.progress import Advance, following

from .breakaway import is_unseen
from .problem import Problem, stacked_residuals
from .report import digits
from .result import FitResult
from .section import Images, Section
from .solve import jacobian

_CHAINS = 2
_WARMUP = 300  # draws of each chain in which the step size and the scales are found
_APART = 1.0  # standard errors by which the chains' beginnings are scattered
_MIXED = 1.05


@dataclass(frozen=True)
class Posterior:
    """Draws from the posterior: `draws` by parameter, (chains, samples) in its own unit; `mean`, `deviation`,
    `interval95` (the middle 95 % of the draws), `rhat` (Gelman and Rubin's, 1 where the chains agree) and `effective`
    (how many independent draws they are worth), by parameter; `divergent`, the draws whose trajectory went astray."""

    draws: Mapping[str, np.ndarray]
    mean: Mapping[str, float]
    deviation: Mapping[str, float]
    interval95: Mapping[str, tuple[float, float]]
    rhat: Mapping[str, float]
    effective: Mapping[str, float]
    divergent: int

    def to_dict(self) -> dict[str, Any]:
        """The figures, ready for JSON, without the draws."""
        keys = ("mean", "deviation", "interval95", "rhat", "effective")
        parameters = {name: {key: getattr(self, key)[name] for key in keys} for name in self.draws}
        return {"parameters": parameters, "divergent": self.divergent}

    def section(self) -> Section:
        """The table and the histograms."""
        words = []
        if max(self.rhat.values()) > _MIXED:
            words.append("The chains do not agree: draw more samples.")
        if self.divergent:
            words.append(
                f"{self.divergent} trajectories went astray: the draws may miss a part of the posterior."
            )
        rows = []
        for name, error in self.deviation.items():
            low, high = (digits(end, error) for end in self.interval95[name])
            mean, counts = digits(self.mean[name], error), f"{self.effective[name]:.0f}"
            rows.append((name, mean, f"{error:.2g}", f"{low} to {high}", f"{self.rhat[name]:.3f}", counts))
        headings = ("parameter", "mean", "standard deviation", "95 % interval", "R-hat", "worth")
        return Section("Posterior", tuple(words), headings, tuple(rows), self._draw)

    def _draw(self) -> Images:
        from .plots_of_fit import of_posterior  # matplotlib takes long to import

        return [of_posterior(self)]


def check_numbers(samples: int, seed: int) -> None:
    """Refuse what no draws can be made with, before a fit has been waited for. **Raises:** `InputError`."""
    for name, value, low, high in (("samples", samples, 50, 100_000), ("seed", seed, 0, 2**63 - 1)):
        if isinstance(value, bool) or not isinstance(value, int) or not low <= value <= high:
            raise InputError(f"{name} is {value!r}; allowed: a whole number from {low} to {high}")
    need("blackjax", "posterior")


def posterior(result: FitResult, samples: int = 1000, seed: int = 0, *, progress: bool = False) -> Posterior:
    """Draw from the posterior with the fit's own likelihood, by NUTS (Hoffman and Gelman 2014; blackjax).

    The log density is minus the fit's loss, over the variance that the residuals turned out to have; priors are those of
    the fit, and flat in the transformed numbers (logarithms) else. Two chains begin about the estimate; steps are taken in
    numbers that the covariance makes round. A sample takes some 3 to 15 gradients. It needs the extra `posterior`.

    **Arguments:** `samples` of each chain, 50 to 100000, after a warm-up of 300; `seed`, 0 or above;
    `progress`: show on the terminal how far it is.

    **Raises:** `InputError` where blackjax is missing, and where a number is not identified, since a flat prior then has no
    posterior, or is one whose likelihood has no gradient, such as a `mu_static`.
    """
    check_numbers(samples, seed)
    problem, names = result.problem, list(result.parameters)
    for i, (name, estimate) in enumerate(result.parameters.items()):
        if not estimate.identified:
            raise InputError(
                f"posterior needs identified numbers, and {name} is not ({estimate.reason}); "
                "allowed: numbers that the data or a prior fix"
            )
        if is_unseen(problem, i):
            raise InputError(f"posterior needs gradients, and {name} has none; allowed: a fit without it")
    free = jnp.asarray(result.free)
    back = problem.by_reported(free)
    spread = result.covariance if back is None else back @ result.covariance @ back.T
    root = jnp.asarray(np.linalg.cholesky(spread), free.dtype)
    variance = jnp.asarray(result.variance, free.dtype)
    total = float(_CHAINS * (_WARMUP + samples))
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        with following(total, shown=progress) as advance:
            told = advance if progress else None
            drawn = _chains(jax.random.key(seed), free, root, variance, problem, samples, told)
            round_, diverged = jax.block_until_ready(drawn)
        with following(None, doing="comparing the chains", shown=progress):
            rhat, effective = _mixing(round_)
    found = free[None, None] + jnp.einsum("csi,ji->csj", round_, root)
    found, best = jax.vmap(jax.vmap(problem.report))(found), problem.report(free)[None, None]
    found = best + (found - best) * jnp.asarray(result.widened, free.dtype)[None, None]
    draws = {
        name: np.asarray(p.transform.value(found[..., i]), np.float64)
        for i, (name, p) in enumerate(zip(names, problem.reported, strict=True))
    }
    return Posterior(
        draws,
        {name: float(d.mean()) for name, d in draws.items()},
        {name: float(d.std()) for name, d in draws.items()},
        {name: tuple(np.quantile(d, [0.025, 0.975]).tolist()) for name, d in draws.items()},
        dict(zip(names, rhat, strict=True)),
        dict(zip(names, effective, strict=True)),
        int(np.sum(diverged)),
    )


def _mixing(draws: Array) -> tuple[list[float], list[float]]:
    """R-hat and the effective number of draws, of each number."""
    import blackjax.diagnostics as diagnostics

    both = diagnostics.potential_scale_reduction(draws), diagnostics.effective_sample_size(draws)
    rhat, effective = (np.asarray(x, np.float64).ravel().tolist() for x in both)
    return rhat, effective


@partial(jax.jit, static_argnames=("samples", "advance"))
def _chains(key, free, root, variance, problem: Problem, samples: int, advance: Advance | None):
    """Draws (chains, samples, p) in numbers of about unit variance, and which diverged; `advance` is told of each."""
    import blackjax

    def logdensity(x):
        return _logdensity(free + root @ x, variance, problem)

    def tell(count: int, drawn: Array) -> None:
        if advance is not None:
            jax.debug.callback(partial(_tell, advance, float(count)), drawn)

    def chain(key):
        start, warm, run = jax.random.split(key, 3)
        begin = _APART * jax.random.normal(start, free.shape, free.dtype)
        adapt: Any = blackjax.window_adaptation(blackjax.nuts, logdensity)
        (state, tuned), _ = adapt.run(warm, begin, num_steps=_WARMUP)
        tell(_WARMUP, state.position)
        kernel: Any = blackjax.nuts(logdensity, **tuned)

        def one(state, key):
            state, info = kernel.step(key, state)
            tell(1, state.position)
            return state, (state.position, info.is_divergent)

        return jax.lax.scan(one, state, jax.random.split(run, samples))[1]

    return jax.lax.map(chain, jax.random.split(key, _CHAINS))


def _tell(advance: Advance, count: float, drawn: Any) -> None:
    """Tell of draws; `drawn` is not looked at, but without it nothing would wait for it to be drawn."""
    advance("drawing", count)


@jax.custom_vjp
def _logdensity(free: Float[Array, " p"], variance: Array, problem: Problem) -> Array:
    return -0.5 * jnp.sum(_rows(free, (variance, problem)) ** 2)


def _forward(free, variance, problem):
    # The numbers are few: forward mode needs no memory of the rollouts.
    matrix, found = jacobian(_rows, free, (variance, problem))
    return -0.5 * jnp.sum(found**2), (-found @ matrix, variance, problem)


def _backward(kept, cotangent):
    gradient, *others = kept
    return cotangent * gradient, *(jax.tree.map(jnp.zeros_like, other) for other in others)


_logdensity.defvjp(_forward, _backward)


def _rows(free: Float[Array, " p"], args: Any) -> Float[Array, " n"]:
    """The residuals in standard deviations of what they turned out to be; those of priors are scaled by them."""
    variance, problem = args
    return stacked_residuals(free, problem) / jnp.sqrt(variance)
