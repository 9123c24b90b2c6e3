"""The command `hapjax`: arguments, exit codes, and the shortest way from each command to the library."""

import inspect
import os
import sys
from collections import Counter
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, NoReturn

import jax
import numpy as np
import tyro
from rich.console import Console
from tyro import _errors as parse_errors
from tyro.conf import FlagCreatePairsOff, Positional

from .errors import InputError, within
from .extras import need
from .files import check_makeable, check_writable
from .processes import agreed, together
from .recording import Recording, load_recording
from .recording.ros_topics import parsed
from .scene_file import load_scene
from .simulate import init, rollout


def demo(out: Path = Path("hapjax-demo"), seed: int = 0) -> int:
    """Grasp a cube with virtual fingers in real time, record it, and find its numbers again from the recording.

    A three-finger lift and a two-finger swing at 1 kHz, 13 s; then a fit of mu, stiffness, A_crit, mass and
    principal inertia from starts a factor 2 off. Example: hapjax demo --out hapjax-demo

    Args:
        out: Folder for the recordings, the scenes, the figures and the report.
        seed: Of the sensors' noise and of the starts, 0 or above.
    """
    from .demo import run_demo

    return run_demo(out, seed)


def simulate(scene: Positional[Path], *, hip: Path, out: Path, topic: tuple[str, ...] = ()) -> None:
    """Replay a path of fingertips through a scene, and write the forces (N) and poses (m) it answers with.

    Example: hapjax simulate cube.toml --hip lift.npz --out answer.csv

    Args:
        scene: Scene file (TOML).
        hip: Recording (.npz, .csv, .mcap, .parquet) whose channel hip (m, world frame) is replayed at the scene's time
            step, and, where the scene's torsion is a gimbal, its channel gimbal (rad).
        out: Recording to write (.npz, .csv, .mcap, .parquet): hip, force on the fingers, pose of the moving objects.
        topic: Of a ROS 2 bag: the topics of hip, one a finger, such as hip=/left/tip,/right/tip.
    """
    topics = parsed(topic)
    Recording.check_writable(out)
    with jax.enable_x64(True):
        loaded = load_scene(scene)
        dt = float(loaded.integrator.dt)
        recording = _loaded(hip, topics)
        with within(f"{hip}: "):
            path = recording.hip_every(dt)
            assert recording.hip_t is not None
            times = recording.hip_t[0] + dt * np.arange(len(path))
            turned = loaded.torsion is not None and loaded.torsion.needs_gimbal
            gimbals = recording.gimbal_at(times) if turned else None
        first = None if gimbals is None else gimbals[0]
        _, reply = rollout(loaded, init(loaded, path[0], first), path, gimbals=gimbals)
    channels: dict[str, Any] = {
        "hip": path,
        "hip_t": times,
        "force": np.asarray(reply.force),
        "force_t": times,
    }
    if gimbals is not None:
        channels |= {"gimbal": gimbals, "gimbal_t": times}
    if loaded.moving():
        channels |= {"pose": np.asarray(reply.pose), "pose_t": times + dt}  # a step's poses belong to its end
    with within(f"{scene} with {hip}: the simulation ended with "):
        answer = Recording(**channels)
    answer.save(out)


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
        json: File for the figures.
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
    fitting, topics = need("hapjax_fitting", "fitting"), parsed(topic)
    with jax.enable_x64(True), together(distributed, process):
        first = jax.process_index() == 0
        json, report = (json, report) if first else (None, None)
        if json is not None:
            check_writable(json)
        if report is not None:
            check_makeable(report)
        if profile and not compare:
            need("hapjax_fitting.profile", "fitting").check_names(profile, free)
        loaded, read = agreed(lambda: ([load_recording(p, topics) for p in recordings], load_scene(scene)))
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
        asked = _asked(fitting, result, profile, posterior, seed, suggest)
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
            print(f"report: {fitting.write_report(result, report, sections=sections)}")
    if refused is not None:
        raise refused
    return 130 if stopped else 0


def _asked(fitting, result, profile: tuple[str, ...], posterior: int | None, seed: int, suggest: bool):
    """What was asked for beside the fit, one after the other: what it is called in the figures, of which number, and it."""
    for name in profile:
        yield "profiles", name, lambda name=name: fitting.profile(result, name)
    if posterior is not None:
        yield "posterior", None, lambda: fitting.posterior(result, posterior, seed)
    if suggest:
        yield "suggestion", None, lambda: fitting.suggest(result)


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


def benchmark(
    kind: Positional[Literal["latency", "scene", "stability", "error", "gradient", "batch", "fit"]],
    scene: Path | None = None,
    fingers: int = 3,
    seconds: float = 5.0,
    integrators: tuple[str, ...] = (),
    maps: tuple[str, ...] = (),
    rate: float = 1000.0,
    quick: FlagCreatePairsOff[bool] = False,
    cases: tuple[str, ...] = (),
    hip: Path | None = None,
    error: float = 1e-4,
    out: Path | None = None,
    json: Path | None = None,
) -> None:
    """Measure on this machine.

    latency: one step inside a compiled loop, one packed call beside an empty one, the servo loop's lateness and
    missed ticks at 1 kHz, compile time. scene: equations, floating-point operations and time of a step of the scene,
    and of the scene with each part switched off in turn. stability: where each integrator settles, rings or blows up, and
    how stiff a wall a device can press on. error: error against run time of each integrator, beside MuJoCo's, on cases
    with a known truth. gradient: time and memory of gradients beside the forward pass. batch: steps and gradients a second
    of batches of rollouts, and how far a held object creeps, beside MuJoCo's. fit: errors of estimates beside the least
    possible, how often 95 % intervals hold the truth, how long fits take. Example: hapjax benchmark latency --json l.json

    Args:
        kind: Which measurement.
        scene: Scene file (TOML); absent: the demo's, and of stability, error and gradient the built-in cases. Not of batch
            and fit.
        fingers: Number of fingers, 1 to 100.
        seconds: How long the servo loop of latency runs, above 0 to 3600 s.
        integrators: Of stability and error: names as in scene files; none: all.
        maps: Of stability: stiffness mass mass_ratio mu penetration spin inertia loop; none: all.
        rate: Of stability and error: Hz at which --scene is to run, 10 to 100000.
        quick: Of stability: a coarse grid. Of error: fewer time steps, each run once, no gradients. Of fit: a fiftieth.
        cases: Of error: names of built-in cases; none: all.
        hip: Of error with --scene: recording (.npz, .csv) whose channel hip the fingers follow; absent: a virtual
            operator grips and lifts the first object that moves.
        error: Of error with --scene: m that the recommended integrator may be off at the end, above 0.
        out: Of stability and error: folder for the page, the pictures and the CSV files. Of fit: for all estimates as CSV.
        json: File for the figures.
    """
    options = locals()
    from .benchmark import _options, batch, gradient, latency, stability
    from .benchmark import error as errors
    from .benchmark import scene as parts

    defaults = {name: each.default for name, each in inspect.signature(benchmark).parameters.items()}
    given = {name: value for name, value in options.items() if value != defaults[name]}
    _options.check_options(kind, scene is not None, given)
    if json is not None:
        check_writable(json)
    with jax.enable_x64(kind == "error" or jax.config.read("jax_enable_x64")):
        loaded = None if scene is None else load_scene(scene)
    if kind == "latency":
        latency.report(loaded, fingers, seconds, json)
    elif kind == "stability":
        stability.report(loaded, maps, integrators, quick, rate, fingers, out, json)
    elif kind == "error":
        errors.report(loaded, hip, fingers, cases, integrators, quick, error, rate, out, json)
    elif kind == "gradient":
        gradient.report(loaded, fingers, json)
    elif kind == "batch":
        batch.report(loaded, fingers, json)
    elif kind == "fit":
        need("hapjax_fitting.benchmark.report", "fitting").report(loaded, quick, out, json)
    else:
        parts.report(loaded, fingers, json)


def recover(recording: Positional[Path], *, out: Path | None = None) -> None:
    """Make a whole file of a recording (.mcap) that was cut short or is damaged, and say what is lost.

    The recording stays as it is. Example: hapjax recover lift.mcap --out whole.mcap

    Args:
        recording: MCAP file, of any recorder.
        out: File to write, which must not exist; absent: the recording's name with -recovered.
    """
    from .recording.recovering import recover as recovering

    target = recording.with_name(f"{recording.stem}-recovered.mcap") if out is None else out
    found = recovering(recording, target)
    for sentence in found.lost:
        print(f"hapjax: {recording}: lost: {sentence}", file=sys.stderr)
    each = ", ".join(f"{topic} {count}" for topic, count in sorted(found.messages.items())) or "none"
    whole = "; the file was whole" if found.whole else ""
    print(f"{target}: {found.messages.total()} messages ({each}){whole}")


def doctor(rate: float = 1000.0, seconds: float = 2.0, json: Path | None = None) -> None:
    """Say what rate this machine can hold, and what to change: privileges, kernel, processors, shared memory, USB.

    Looks at the settings, then runs three loops: an idle one as any program, one with real-time priority where that is
    granted, and one that steps the demo's scene. Example: hapjax doctor --json doctor.json

    Args:
        rate: Hz of the loops, 100 to 4000.
        seconds: How long each loop runs, 0.1 to 600 s.
        json: File for all that is said, with its figures.
    """
    if json is not None:
        check_writable(json)
    need("hapjax_devices.doctor.examine", "devices").report(rate, seconds, json)


def _by_path(option: str, given: tuple[tuple[str, float, float], ...]) -> dict[str, tuple[float, float]]:
    """The two numbers of each path. **Raises:** `InputError` where one is named twice."""
    found: dict[str, tuple[float, float]] = {}
    for path, one, other in given:
        if path in found:
            raise InputError(f"{option} names {path} twice; allowed: each path once")
        found[path] = (one, other)
    return found


def _loaded(path: Path, topics) -> Recording:
    """A recording, cleaned; what was found is said on stderr."""
    recording = load_recording(path, topics)
    for finding in recording.findings:
        print(f"hapjax: {path}: {finding}", file=sys.stderr)
    return recording


_SHELLS = ("bash", "zsh", "tcsh")
_COMMANDS = {
    "demo": demo,
    "simulate": simulate,
    "fit": fit,
    "benchmark": benchmark,
    "recover": recover,
    "doctor": doctor,
}


def main(arguments: list[str] | None = None) -> int:
    """Run the command line. Bad input ends with one sentence on stderr and the exit code 2.

    1: the system failed (a full disk, say), or the demo missed a truth; 130: interrupted.
    """
    try:
        return _run(sys.argv[1:] if arguments is None else arguments) or 0
    except InputError as error:
        return _say(str(error), 2)
    except KeyboardInterrupt:
        return _say("interrupted", 130)
    except OSError as error:
        return _say(f"{error.filename or 'output'}: {error.strerror or error}", 1)


def run() -> NoReturn:
    """The program: `main`, and its end.

    What compiled code does when it is interrupted goes on in threads of its own, and would fail in the middle of taking
    everything down. So an interrupted program ends at once.
    """
    code = main()
    if code == 130:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)
    sys.exit(code)


def _run(arguments: list[str]) -> int | None:
    _check_completion(arguments)
    _check_once(arguments)
    with parse_errors.on_parse_error(_refuse):
        result = tyro.extras.subcommand_cli_from_dict(
            _COMMANDS,
            prog="hapjax",
            description="Touch, hold and identify virtual objects: friction, stiffness, torsional grip, inertia.",
            args=arguments,
        )
    sys.stdout.flush()
    return result


def _say(sentence: str, code: int) -> int:
    print(f"hapjax: {' '.join(sentence.split())}", file=sys.stderr)
    return code


def _check_once(arguments: list[str]) -> None:
    """Refuse an option that is given twice: of all but the last nothing would be left."""
    options = [a.split("=")[0].replace("_", "-") for a in arguments if a.startswith("--")]
    for option, times in Counter(options).items():
        if times > 1:
            raise InputError(
                f"{option} is given {times} times; allowed: once, with all of its values after it"
            )


def _check_completion(arguments: list[str]) -> None:
    """Refuse shells that tyro has no completion for; it would end in a traceback."""
    for flag, shell in pairwise([*arguments, ""]):
        if flag in ("--tyro-print-completion", "--tyro-write-completion") and shell not in _SHELLS:
            raise InputError(f"{flag} is {shell!r}; allowed: {', '.join(_SHELLS)}")


def _refuse(event: parse_errors.ParseErrorEvent) -> None:
    """Say in one sentence why the arguments are refused, in place of tyro's box of many lines."""
    raise InputError(f"{_reason(event)}; see {event.prog} --help")


def _reason(event: parse_errors.ParseErrorEvent) -> str:
    match event:
        case parse_errors.MissingArgs(missing_arguments=missing):
            return f"missing: {', '.join(_flag(m.arg) for m in missing)}"
        case parse_errors.MissingSubcommand(found_token=found):
            return f"{'no command' if found is None else repr(found)} given; allowed: {', '.join(_COMMANDS)}"
        case parse_errors.InvalidChoice(argument=argument, value=value, choices=choices):
            return f"{_flag(argument)} is {value!r}; allowed: {', '.join(choices)}"
        case parse_errors.UnrecognizedArgs(tokens=tokens):
            return f"unknown: {' '.join(tokens)}"
        case parse_errors.BadValue(argument=argument, offending_value=value):
            return f"{_flag(argument)} has " + (
                "too few values" if value is None else f"the value {value!r} too many"
            )
        case parse_errors.InstantiationFailure(argument=argument, message=message):
            return f"{'arguments' if argument is None else _flag(argument)}: {' '.join(message.split())}"
    return "the arguments are not understood"


def _flag(argument: Any) -> str:
    return str(argument.lowered.metavar) if argument.is_positional() else argument.lowered.name_or_flags[-1]
