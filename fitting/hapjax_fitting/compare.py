"""Several models of the same recordings, compared by information criteria and by what they were not fitted to."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import jax
import numpy as np

from hapjax import InputError, Recording, Scene
from hapjax.progress import following

from .fit import fit
from .noise import lost
from .parameters import Selector
from .problem import channels_of, grouped, numbers_in, stacked_residuals
from .result import FitResult
from .section import Section

_FOLDS, _PIECES = 4, 4  # parts that are held out in turn; of a single recording, pieces in time of each part
CRITERIA = {"aic": "AIC", "aicc": "AICc", "bic": "BIC", "held_out": "held-out error"}


@dataclass(frozen=True)
class Model:
    """One of the models that were compared.

    `result`, its fit to all recordings; `numbers`, how many were fitted, noises that were estimated included; `aic`,
    `aicc`, `bic`: information criteria, of which only differences between models have a meaning; `held_out`: root mean
    square of the residuals, over the noise, of parts that it was not fitted to, `None` where none could be held out, or the
    model left the range of sense there.
    """

    result: FitResult
    numbers: int
    aic: float
    aicc: float
    bic: float
    held_out: float | None


@dataclass(frozen=True)
class Comparison:
    """Models by name, and which is `best` by each of `aic`, `aicc`, `bic`, `held_out`; `interrupted`: Ctrl-C ended it, and
    these are the models so far."""

    models: Mapping[str, Model]
    best: Mapping[str, str]
    interrupted: bool = False

    def to_dict(self) -> dict[str, Any]:
        """The figures, ready for JSON."""
        figures = {
            name: {
                "loss": model.result.loss,
                "numbers": model.numbers,
                **{key: getattr(model, key) for key in CRITERIA},
                "converged": model.result.converged,
                "parameters": model.result.to_dict()["parameters"],
            }
            for name, model in self.models.items()
        }
        return {"models": figures, "best": dict(self.best), "interrupted": self.interrupted}

    def section(self) -> Section:
        """The table, and which model is best by what."""
        least = {
            key: min(getattr(model, key) for model in self.models.values()) for key in ("aic", "aicc", "bic")
        }
        rows = [
            (
                name,
                f"{model.result.loss:.6g}",
                str(model.numbers),
                *(f"{getattr(model, key) - low:+.1f}" for key, low in least.items()),
                "" if model.held_out is None else f"{model.held_out:.4g}",
                "yes" if model.result.converged else "no",
            )
            for name, model in self.models.items()
        ]
        headings = ("loss", "numbers", "AIC", "AICc", "BIC", "held-out error", "converged")
        return Section("Models compared", (self._in_words(),), ("model", *headings), tuple(rows))

    def _in_words(self) -> str:
        by_model = {
            name: [CRITERIA[key] for key, best in self.best.items() if best == name] for name in self.models
        }
        said = [f"{name} by {', '.join(criteria)}" for name, criteria in by_model.items() if criteria]
        stopped = "Interrupted: these are the models so far. " if self.interrupted else ""
        how = "AIC, AICc and BIC are above the lowest one's; held-out error is in noises."
        return f"{stopped}Best: {'; '.join(said)}. {how}"


def compare(
    models: Mapping[str, Scene],
    recordings: Recording | Sequence[Recording],
    free: Selector | Mapping[str, Selector],
    **options: Any,
) -> Comparison:
    """Fit several models to the same recordings, and say which explains them best.

    Each model is fitted to all recordings, for the information criteria, and again without one part of them after the
    other, for the error of what was held out: of several recordings a quarter of them (one by one, where there are fewer
    than four), of a single one a quarter of its samples, in four pieces spread over its time; the fingers' path is an input
    and stays whole.

    The criteria are those of Gaussian residuals (Burnham and Anderson 2002, sections 2.2, 2.4 and 6.4): with L the
    likelihood, K numbers, n measured ones, AIC = -2 log L + 2 K, AICc = AIC + 2 K (K + 1) / (n - K - 1),
    BIC = -2 log L + K log n. Of a channel whose noise is not given, -2 log L is n log of its mean square, and the
    noise counts among the numbers.

    **Arguments:**

    - `models`: scenes by name.
    - `free`: as for `fit`, one for all models or one for each by name.
    - `options`: other arguments of `fit`.

    Ctrl-C ends it: the models that were fitted so far are compared, with `interrupted` true; where there is none yet, it
    raises `KeyboardInterrupt`.

    **Raises:** `InputError` as `fit`, and where `models` are fewer than two or `free` lacks one.
    """
    recordings = [recordings] if isinstance(recordings, Recording) else list(recordings)
    if len(models) < 2:
        raise InputError(f"models has {len(models)}; allowed: at least two")
    if options.get("loss", "squares") != "squares":
        raise InputError(
            f"loss is {options['loss']!r}; allowed with compare: squares, of which its criteria are"
        )
    chosen = dict(free) if isinstance(free, Mapping) else {name: free for name in models}
    for name in models:
        if name not in chosen:
            raise InputError(f"free lacks the model {name}; allowed: {', '.join(models)}, each once")
    results, held = _fitted(models, recordings, chosen, options)
    found = {name: _model(result, held.get(name), options) for name, result in results.items()}
    best = {}
    for key in CRITERIA:
        values = {name: getattr(model, key) for name, model in found.items()}
        if None not in values.values():
            best[key] = min(values, key=lambda name, values=values: values[name])
    return Comparison(found, best, interrupted=len(held) < len(models))


def _fitted(
    models: Mapping[str, Scene],
    recordings: Sequence[Recording],
    free: Mapping[str, Selector],
    options: Mapping[str, Any],
) -> tuple[dict[str, FitResult], dict[str, float | None]]:
    """The fit of each model, and its error of what was held out; as far as they got until Ctrl-C."""
    results, held = {}, {}
    try:
        for name, scene in models.items():
            results[name] = fit(scene, recordings, free[name], **options)
            if results[name].interrupted:
                return results, held
        shown = options.get("progress", False)
        with following(float(len(models)), doing="held-out error", shown=shown) as advance:
            for name, result in results.items():
                told = partial(advance, f"held-out error of {name}")
                held[name] = _held_out(result, recordings, free[name], options, told)
    except KeyboardInterrupt:
        if not results:
            raise
    return results, held


def _model(result: FitResult, held_out: float | None, options: Mapping[str, Any]) -> Model:
    numbers, deviance = len(result.parameters), 0.0 if result.measured else np.inf
    for key, size in result.measured.items():
        square = (result.residual_rms["pose" if key == "position" else key] / result.noise[key]) ** 2
        if key in (options.get("noise") or {}):
            deviance += size * square
        else:
            deviance, numbers = deviance + size * np.log(max(square, 1e-300)), numbers + 1
    count = sum(result.measured.values())
    aic = deviance + 2 * numbers
    small = 2 * numbers * (numbers + 1) / (count - numbers - 1) if count > numbers + 1 else np.inf
    return Model(
        result,
        numbers,
        float(aic),
        float(aic + small),
        float(deviance + numbers * np.log(count)) if count else np.inf,
        held_out,
    )


def _held_out(
    result: FitResult,
    recordings: Sequence[Recording],
    free: Selector,
    options: Mapping[str, Any],
    advance: Callable[[float], Any],
) -> float | None:
    """The root mean square, over the noise, of residuals of what each of several fits was not fitted to.

    `advance` is told which share of them is done.
    """
    if options.get("each"):
        return None  # of what was held out, its own numbers are not known
    square, count = 0.0, 0
    observe = options.get("observe", ("force", "pose"))
    channels = (observe,) if isinstance(observe, str) else tuple(observe)
    quick = {k: v for k, v in options.items() if k not in ("names", "starts", "spread", "seed", "progress")}
    parts = _parts(recordings, channels)
    for kept, left in parts:
        told = quick | {"noise": dict(result.noise), "starts": 1, "sensors": result.sensors}
        part = fit(result.scene, kept, free, **told)
        if part.interrupted:
            raise KeyboardInterrupt
        names = [f"held-out part {i + 1}" for i in range(len(left))]
        groups = grouped(part.scene, left, channels, names, part.problem.parameters, part.problem.sensors)
        held = replace(part.problem, groups=groups, priors=None)
        found = _residuals(part.free, held)
        if any(lost(r).any() for _, r in channels_of(found, held)):
            return None
        square, count = square + float(np.sum(np.asarray(found) ** 2)), count + numbers_in(groups)
        advance(1 / len(parts))
    return float(np.sqrt(square / count)) if count else None


_residuals = jax.jit(stacked_residuals)


def _parts(
    recordings: Sequence[Recording], channels: Sequence[str]
) -> list[tuple[list[Recording], list[Recording]]]:
    """What is fitted to, and what is held out from it, in turn."""
    if len(recordings) > 1:
        folds = min(_FOLDS, len(recordings))
        place = np.arange(len(recordings)) % folds
        return [
            ([r for r, p in zip(recordings, place, strict=True) if p != fold],
             [r for r, p in zip(recordings, place, strict=True) if p == fold])
            for fold in range(folds)
        ]  # fmt: skip
    (recording,) = recordings
    sizes = [len(times) for c in channels if (times := getattr(recording, f"{c}_t")) is not None]
    if min(sizes) < 2 * _FOLDS * _PIECES:
        return []
    return [
        (_of_time(recording, channels, fold, True), _of_time(recording, channels, fold, False))
        for fold in range(_FOLDS)
    ]


def _of_time(recording: Recording, channels: Sequence[str], fold: int, kept: bool) -> list[Recording]:
    """The recording without the pieces of one part, or with them alone; all parts are of the same size."""
    changes = {}
    for channel in channels:
        values, times = getattr(recording, channel), getattr(recording, f"{channel}_t")
        if values is None:
            continue
        length = len(times) // (_FOLDS * _PIECES)
        part = np.arange(length * _FOLDS * _PIECES) // length % _FOLDS
        rows = np.flatnonzero((part != fold) == kept)
        changes |= {channel: values[rows], f"{channel}_t": times[rows]}
    return [replace(recording, **changes)]
