"""`hapjax fit`."""

from pathlib import Path
from typing import Any, Literal

import jax
from rich.console import Console
from tyro.conf import FlagCreatePairsOff, Positional

from ..errors import InputError
from ..extras import need
from ..files import check_apart, check_makeable, check_writable, place_of
from ..processes import agreed, together
from ..progress import following
from ..recording import load_recording
from ..recording.ros_topics import parsed
from ..scene_file import load_scene


def fit(
    recordings: Positional[tuple[Path, ...]],
    *,
    scene: Path,
    free: tuple[str, ...],
    observe: tuple[Literal["force", "pose"], ...] = ("force", "pose"),
    starts: int = 8,
    spread: float = 2.0,
    seed: int = 0,
    loss: Literal["squares", "huber", "student"] = "squares",
    bounds: tuple[tuple[str, float, float], ...] = (),
    prior: tuple[tuple[str, float, float], ...] = (),
    each: tuple[str, ...] = (),
    json: Path | None = None,
    report: Path | None = None,
    topic: tuple[str, ...] = (),
    compare: tuple[str, ...] = (),
    profile: tuple[str, ...] = (),
    suggest: FlagCreatePairsOff[bool] = False,
    posterior: int | None = None,
    distributed: FlagCreatePairsOff[bool] = False,
    process: tuple[int, int, str] | None = None,
) -> int:
    """Find numbers of a scene from recordings, with 95 % intervals.

    Example: hapjax fit lift.npz --scene cube.toml --free object.cube.surface.mu object.cube.surface.stiffness
    --json fit.json

    Args:
        recordings: Files (.npz, .csv, .mcap, .parquet) with hip (m) and force (N, on the finger) or pose (m).
        scene: Scene file (TOML); its free numbers are the first start.
        free: Paths of the free numbers, as in the scene file, such as object.cube.body.mass; of sensors too:
            sensor.force_bias (N), sensor.force_gain, sensor.force_delay and sensor.pose_delay (s),
            sensor.hip_rotation (rad); of how an object begins: start.NAME.position (m), .rotation (rad), .velocity (m/s)
            and .spin (rad/s), usually in --each.
        observe: What is compared with the model, of what was recorded.
        starts: Number of starts, 1 to 10000; the results of all are compared.
        spread: The other starts are off by random factors up to this, 1 or above.
        seed: Of the starts, 0 or above.
        loss: What is minimised of the residuals; huber or student where some samples are outliers.
        bounds: PATH LOW HIGH of free numbers that are to stay between bounds.
        prior: PATH MEAN SD of free numbers of which something is known; of one above 0 the median, and the standard
            deviation of its logarithm.
        each: Of the free paths those that have a number of their own for each recording.
        json: File for the figures; - is standard output.
        report: Folder for the report, an HTML page.
        topic: Of ROS 2 bags: the topics of each channel, one a finger or object, such as hip=/left/tip,/right/tip
            force=/left/sensor,/right/sensor pose=/cube.
        compare: Friction laws to put in the place of that of each surface whose mu is free, of cone viscous stribeck karnopp
            dahl lugre; what is reported is the fit with the lowest BIC.
        profile: Names of free numbers whose profile likelihood is to be walked: intervals that need not be symmetric.
        posterior: Number of draws from the posterior, 50 to 100000, in each of two chains (extra posterior).
        suggest: Say which motion to record next, to shrink the standard errors most.
        distributed: Share the work with the other processes of this job (SLURM, Open MPI), all with the same arguments.
        process: I N HOST:PORT, to share it outside such a job: this is process I of N, which meet where process 0 runs.
    """
    topics = parsed(topic)
    _check_once(recordings)
    with jax.enable_x64(True), together(distributed, process):
        first = jax.process_index() == 0
        with following(None, doing="loading the library", shown=first):
            fitting = need("hapjax_fitting", "fitting")
        json, report = (json, report) if first else (None, None)
        check_apart([json], [scene, *recordings])
        if json is not None:
            check_writable(json)
        if report is not None:
            check_makeable(report)
        if profile and not compare:
            need("hapjax_fitting.profile", "fitting").check_names(profile, free, each)
        if posterior is not None:
            need("hapjax_fitting.posterior", "fitting").check_numbers(posterior, seed)
        with following(None, doing="reading", shown=first):
            loaded, read = agreed(
                lambda: ([load_recording(p, topics) for p in recordings], load_scene(scene))
            )
        options: dict[str, Any] = {
            "observe": observe,
            "starts": starts,
            "spread": spread,
            "seed": seed,
            "loss": loss,
        }
        options |= {"progress": first, "names": [str(path) for path in recordings]}
        options["bounds"] = _by_path("--bounds", bounds)
        options["each"] = each
        options["priors"] = _by_path("--prior", prior)
        said: list[Any] = []  # beside the fit
        figures: dict[str, Any] = {}
        if compare:
            scenes, chosen = fitting.with_laws(read, compare, free)
            compared = fitting.compare(scenes, loaded, chosen, **options)
            said, figures["comparison"] = [compared], compared.to_dict()
            result, stopped = compared.models[compared.best["bic"]].result, compared.interrupted
        else:
            result = fitting.fit(read, loaded, free, **options)
            stopped = result.interrupted
        Console().print(fitting.table(result))
        for finding in result.findings:
            print(f"finding: {finding}")
        asked = _asked(fitting, result, profile, posterior, seed, suggest, first)
        found, stopped, refused = _as_far_as_it_goes(asked) if not stopped else ([], True, None)
        for kind, name, part in found:
            said.append(part)
            if name is None:
                figures[kind] = part.to_dict()
            else:
                figures.setdefault(kind, {})[name] = part.to_dict()
        sections = [part.section() for part in said]
        for section in sections:
            Console().print(section)
        if json is not None:
            result.save_json(json, figures)
        if report is not None:
            with following(None, doing="drawing the report"):
                written = fitting.write_report(result, report, sections=sections)
            print(f"report: {written}")
    if refused is not None:
        raise refused
    return 130 if stopped else 0


def _check_once(recordings: tuple[Path, ...]) -> None:
    """Refuse a recording that is named twice: what it says would count twice. **Raises:** `InputError`."""
    seen: set[str] = set()
    for path in recordings:
        if place_of(path) in seen:
            raise InputError(f"{path}: is named twice; allowed: each recording once")
        seen.add(place_of(path))


def _asked(
    fitting, result, profile: tuple[str, ...], posterior: int | None, seed: int, suggest: bool, progress: bool
):
    """What was asked for beside the fit, one after the other: what it is called in the figures, of which number, and it."""
    for name in profile:
        yield "profiles", name, lambda name=name: fitting.profile(result, name, progress=progress)
    if posterior is not None:
        yield "posterior", None, lambda: fitting.posterior(result, posterior, seed, progress=progress)
    if suggest:
        yield "suggestion", None, lambda: _suggested(fitting, result, progress)


def _suggested(fitting, result, progress: bool):
    with following(None, doing="trying motions", shown=progress):
        return fitting.suggest(result)


def _as_far_as_it_goes(asked) -> tuple[list[tuple[str, str | None, Any]], bool, InputError | None]:
    """What was found, whether it was stopped by Ctrl-C, and the first refusal: none of it throws the fit away."""
    found, refused = [], None
    for kind, name, find in asked:
        try:
            found.append((kind, name, find()))
        except InputError as error:
            refused = error if refused is None else refused
        except KeyboardInterrupt:
            return found, True, refused
    return found, False, refused


def _by_path(option: str, given: tuple[tuple[str, float, float], ...]) -> dict[str, tuple[float, float]]:
    """The two numbers of each path. **Raises:** `InputError` where one is named twice."""
    found: dict[str, tuple[float, float]] = {}
    for path, one, other in given:
        if path in found:
            raise InputError(f"{option} names {path} twice; allowed: each path once")
        found[path] = (one, other)
    return found
