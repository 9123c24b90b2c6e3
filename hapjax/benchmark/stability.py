"""Where each integrator settles, rings or blows up, and how stiff a wall a device can be pressed on."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from rich.console import Console

from ..errors import InputError
from ..extras import need
from ..files import check_makeable, write_json
from ..integrate import METHODS
from ..progress import Advance, following
from ..scene import Scene
from . import error_scene as moved
from . import stability_loop as loop
from . import stability_maps as plans
from . import stability_page as page
from . import stability_scene as own

LOOP = "loop"


def measure(
    scene: Scene | None,
    maps: Sequence[str],
    integrators: Sequence[str],
    quick: bool,
    rate: float,
    fingers: int,
    advance: Advance = lambda doing, steps: None,
    error: float | None = None,
    hip: Path | None = None,
) -> dict[str, Any]:
    """`maps`: what was drawn; `cells`, `loop`, `choices` and `walls`: what was found; needs 64-bit numbers on.

    **Arguments:** `scene` `None`: the built-in cases; else only that scene's own map, its choices at `rate` (Hz) with
    `fingers`, and its walls. `quick`: a coarse grid. `error`: m, within which a choice has to be of a truth that is known to
    `floor`, its fingers along the recording `hip`, or a virtual operator's; `None`: it has to settle, and no more.

    **Raises:** `InputError` for names, numbers or a scene that cannot be.
    """
    figures: dict[str, Any] = {"maps": {}, "cells": [], "loop": [], "choices": [], "walls": [], "floor": 0.0}
    if scene is not None:
        errors = None
        if error is not None:
            errors, figures["floor"] = moved.errors(scene, hip, fingers, integrators, rate, advance)
        scene = own.felt_alike(scene)
        figures["walls"] = own.walls(scene, rate)
        if scene.moving():
            one = own.scaled_map(
                scene
            )  # the recommendation needs all of it: the scene's own stiffness is one of its values
            figures["maps"] = {"scene": one.thinned() if quick else one}
            dts = _scene_steps(scene, quick)
            figures["cells"] = plans.measure(figures["maps"], integrators, dts, advance)
            figures["choices"] = own.recommend(
                scene, one, integrators, rate, fingers, advance, errors, np.inf if error is None else error
            )
        return figures
    built_in = [name for name in maps if name != LOOP]
    figures["maps"] = plans.chosen(built_in, quick) if built_in else {}
    dts = plans.QUICK_DTS if quick else plans.DTS
    figures["cells"] = plans.measure(figures["maps"], integrators, dts, advance)
    if LOOP in maps:
        figures["loop"] = loop.measure(_rates(quick), advance=advance)
    return figures


def report(
    scene: Scene | None,
    maps: Sequence[str],
    integrators: Sequence[str],
    quick: bool,
    rate: float,
    fingers: int,
    error: float | None,
    hip: Path | None,
    out: Path | None,
    file: Path | None,
) -> None:
    """Measure, print the tables, and write the figures as JSON, and a folder of pictures, where they are asked for.

    No `maps` and no `integrators` stand for all; see `measure` for `error` and `hip`.

    **Raises:** `InputError` for names, numbers or a scene that cannot be.
    """
    known = [*plans.MAPS, LOOP]
    maps, integrators = maps or known, integrators or list(METHODS)
    plans.check_names("maps", maps, known)
    plans.check_names("integrators", integrators, METHODS)
    if not 10 <= rate <= 1e5:
        raise InputError(f"rate is {rate:g} Hz; allowed: 10 to 100000")
    if not 1 <= fingers <= 100:
        raise InputError(f"fingers is {fingers}; allowed: 1 to 100")
    if error is None and hip is not None:
        raise InputError(f"hip is {hip} without error; allowed with stability: with --error")
    if error is not None and not 0 < error < np.inf:
        raise InputError(f"error is {error:g} m; allowed: above 0 and finite")
    if out is not None:
        need("matplotlib", "bench")
        check_makeable(out)
    console = Console()
    work = _work(scene, maps, integrators, quick, rate)
    with jax.enable_x64(True), following(work, apart=True) as advance:
        figures = measure(scene, maps, integrators, quick, rate, fingers, advance, error, hip)
    tables, sentences = _said(figures, rate, error)
    for title, (header, rows) in tables.items():
        console.print(page.table(title, header, rows))
    for sentence in sentences:
        console.print(sentence)
    if file is not None:
        asked = {"device": str(jax.devices()[0]), "rate": rate, "error": error}
        write_json(file, asked | _plain(figures))
    if out is not None:
        made = page.write(out, figures["maps"], figures["cells"], figures["loop"], tables, sentences)
        print(f"report: {made}")


def _said(figures: Mapping[str, Any], rate: float, error: float | None):
    """The tables by their titles, and the sentences below them."""
    tables, sentences = {}, []
    if figures["cells"]:
        tables["settled / ringing / blown up"] = page.counts(figures["cells"])
        sentences += [page.WHAT] if "scene" in figures["maps"] else [page.WHAT, page.BASE_CASE]
    if figures["loop"]:
        tables["the closed loop"] = page.loop_rows(figures["loop"])
        sentences.append(page.LOOP)
    if figures["walls"]:
        tables["what fingers feel, by Colgate's bound b > K T / 2"] = page.wall_rows(figures["walls"])
    if figures["choices"]:
        tables["the scene's integrators"] = page.choice_rows(figures["choices"], rate)
        if any(choice.pressed for choice in figures["choices"]):
            sentences.append(page.PRESSED)
        sentences.append(page.advice(figures["choices"], rate, error, figures["floor"]))
    return tables, sentences


def _plain(figures: Mapping[str, Any]) -> dict[str, Any]:
    names = ("cells", "loop", "choices", "walls")
    found = {n: [row._asdict() for row in figures[n]] for n in names}
    return {"maps": list(figures["maps"]), "floor": figures["floor"]} | found


def _scene_steps(scene: Scene, quick: bool) -> list[float]:
    """From 0.1 to 20 times the scene's own step, s, as the built-in maps around 1 ms."""
    return [float(scene.integrator.dt) * dt / 1e-3 for dt in (plans.QUICK_DTS if quick else plans.DTS)]


def _rates(quick: bool) -> tuple[float, ...]:
    return loop.RATES[:2] if quick else loop.RATES


def _work(scene: Scene | None, maps, integrators, quick: bool, rate: float) -> float:
    if scene is not None:
        if not scene.moving():
            return 0.0
        one = {"scene": own.scaled_map(scene)}
        return plans.work(one, integrators, _scene_steps(scene, quick)) + own.recommend_work(
            integrators, rate
        )
    total = plans.work(
        {name: plans.MAPS[name] for name in maps if name != LOOP},
        integrators,
        plans.QUICK_DTS if quick else plans.DTS,
    )
    return total + (loop.work(_rates(quick)) if LOOP in maps else 0.0)
