"""Plots of the parameters: intervals, correlations, and how the starts went."""

from collections.abc import Mapping

import numpy as np

from .canvas import BLUE, GREY, ORANGE, RED, WIDTH, Image, dress, finish, rows
from .posterior import Posterior
from .profile import CHI95, CHI99, Profile
from .result import Estimate, FitResult


def of_fit(result: FitResult, truth: Mapping[str, float] | None) -> list[Image]:
    """All plots that concern the fit as a whole."""
    known = [name for name, p in result.parameters.items() if p.identified]
    images = [_intervals(result, known, truth or {})] if known else []
    if len(known) > 1:
        images.append(_correlations(result, known))
    return [*images, _costs(result)]


def _intervals(result: FitResult, known: list[str], truth: Mapping[str, float]) -> Image:
    figure, grid = rows(1, 0.6 + 0.35 * len(known))
    axes = grid[0, 0]
    for i, name in enumerate(known):
        p = result.parameters[name]
        centre = float(p.estimate or 0)
        size = abs(centre) or 1.0
        percent = [100 * (x - centre) / size for x in _ends(p)]
        axes.plot(percent[2:], [i, i], color=BLUE, lw=2, alpha=0.4, label="99 % interval" if i == 0 else None)
        axes.plot(percent[:2], [i, i], color=BLUE, lw=6, label="95 % interval" if i == 0 else None)
        axes.plot(0, i, "o", color="white", mec=BLUE, label="estimate" if i == 0 else None)
        if name in truth:
            place = 100 * (truth[name] - centre) / size
            axes.plot(place, i, "x", color=RED, ms=9, mew=2, label="truth" if i == 0 else None)
    axes.set_yticks(range(len(known)), known)
    axes.set_ylim(len(known) - 0.5, -0.5)
    dress(axes, x="difference from the estimate (%)")
    return finish(figure, axes, "Intervals relative to the estimates")


def _ends(p: Estimate) -> list[float]:
    """The ends of the 95 % and of the 99 % interval."""
    return [float(x) for x in (*p.interval95, *(p.interval99 or p.interval95)) if x is not None]


def _correlations(result: FitResult, known: list[str]) -> Image:
    names = list(result.parameters)
    places = [names.index(name) for name in known]
    matrix = result.correlation[np.ix_(places, places)]
    figure, grid = rows(1, 1.6 + 0.5 * len(known))
    axes = grid[0, 0]
    picture = axes.imshow(matrix, cmap="RdBu_r", vmin=-1, vmax=1)
    for i, j in np.ndindex(*matrix.shape):
        colour = "white" if abs(matrix[i, j]) > 0.6 else "black"
        axes.text(j, i, f"{matrix[i, j]:.2f}", ha="center", va="center", color=colour, fontsize=8)
    axes.set_xticks(range(len(known)), [str(i + 1) for i in range(len(known))])
    axes.set_yticks(range(len(known)), [f"{name} ({i + 1})" for i, name in enumerate(known)])
    axes.set_xlabel("parameter, by its number")
    figure.colorbar(picture, ax=axes, label="correlation (1)", shrink=min(1.0, 5 / WIDTH + 0.3))
    return finish(figure, None, "Correlations of the identified parameters")


def _costs(result: FitResult) -> Image:
    figure, grid = rows(1, 3.2)
    axes = grid[0, 0]
    best = min((min(losses.values()) for losses in result.trace.values()), default=np.inf)
    for losses in result.trace.values():
        steps = sorted(losses)
        near = min(losses.values()) <= 1.01 * best
        label = "start that ended near the best loss" if near else "start that ended elsewhere"
        colour = BLUE if near else RED
        lowest = np.minimum.accumulate([losses[s] for s in steps])  # steps that were not taken left out
        axes.plot(steps, lowest, color=colour, lw=1, marker=".", alpha=0.7, label=label)
    axes.set_yscale("log")
    dress(axes, x="step of the solver", y="loss (1)")
    _once(axes)
    return finish(figure, axes, f"Cost of each of {len(result.trace)} starts by the solver's steps")


def of_profile(profile: Profile) -> Image:
    """The deviance over the number, with the thresholds of its intervals."""
    figure, grid = rows(1, 3.2)
    axes = grid[0, 0]
    axes.plot(profile.values, profile.deviance, color=BLUE, marker=".", label="others fitted anew")
    for level, style in ((CHI95, "--"), (CHI99, ":")):
        axes.axhline(level, color=GREY, ls=style, lw=1, label="95 %" if level == CHI95 else "99 %")
    low, high = profile.local95
    if low is not None and high is not None:
        axes.axvspan(low, high, color=BLUE, alpha=0.12, lw=0, label="95 % by the covariance")
    axes.axvline(profile.estimate, color=GREY, lw=1)
    axes.set_ylim(-0.3, 3 * CHI99)
    near = profile.values[profile.deviance < 3 * CHI99]
    if profile.values[-1] > 20 * max(profile.estimate, profile.values[0]) > 0:
        axes.set_xscale("log")
    elif len(near) > 2:
        axes.set_xlim(near[0], near[-1])
    dress(axes, x=profile.name, y="deviance (1)")
    return finish(figure, axes, f"Profile likelihood of {profile.name}")


def of_posterior(posterior: Posterior) -> Image:
    """A histogram of each number's draws, a colour for each chain."""
    figure, grid = rows(len(posterior.draws), 1.8)
    for axes, (name, draws) in zip(grid[:, 0], posterior.draws.items(), strict=True):
        edges = np.histogram_bin_edges(draws, 40)
        for i, (chain, colour) in enumerate(zip(draws, (BLUE, ORANGE), strict=False), 1):
            axes.hist(chain, edges, histtype="step", color=colour, label=f"chain {i}")
        dress(axes, x=name, y="draws")
    return finish(figure, grid[0, 0], "Posterior of the parameters")


def _once(axes) -> None:
    """Keep one legend entry of each label."""
    seen: set[str] = set()
    for line in axes.get_lines():
        if line.get_label() in seen:
            line.set_label("_")
        seen.add(line.get_label())
