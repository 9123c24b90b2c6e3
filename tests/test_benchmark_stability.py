"""Stability maps and the closed loop against formulas: explicit limits, discrete-time eigenvalues, Colgate's bound."""

import csv
import io
import json
from functools import partial
from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from rich.console import Console

import hapjax
from hapjax import Body, Box, Contact, InputError, Object, Plane, Scene, Sphere, Surface, World
from hapjax.benchmark import _sweep
from hapjax.benchmark import error_scene as moved
from hapjax.benchmark import stability_loop as loop
from hapjax.benchmark import stability_maps as maps
from hapjax.benchmark import stability_page as page
from hapjax.benchmark import stability_press as touch
from hapjax.benchmark import stability_scene as own
from hapjax.benchmark.stability_cells import BASE, BLOWN_UP, RINGING, SETTLED, programs
from hapjax.benchmark.stability_maps import MAPS, Map, explicit_limit, unsettled
from hapjax.cli import main

SCENE = """
[object.cube]
shape = "box"
size = [0.04, 0.04, 0.04]
position = [0.0, 0.0, 0.02]
[object.cube.body]
mass = 0.05
[object.floor]
shape = "plane"
[contact.on_floor]
between = ["cube", "floor"]
stiffness = 1e5
mu = 0.5
damping = 1.0
[world]
gravity = [0.0, 0.0, -9.81]
"""
PLATE = """
[object.plate]
shape = "plane"
[object.plate.surface]
mu = 0.5
stiffness = 800.0
"""


# Cells ------------------------------------------------------------------------------------------------------


def test_an_explicit_integrator_settles_up_to_2_over_w():
    """Four springs k at half an edge from the axis turn a uniform cube of m edge^2 / 6: w^2 = 6 k / m."""
    dt = 1e-3
    for mass in (0.05, 0.5):
        assert explicit_limit(stiffness=4 * mass / (6 * dt**2), mass=mass) == pytest.approx(dt)
    grid = [
        BASE | {"mass": m, "stiffness": 4 * m / 6 * (x / dt) ** 2} for m in (0.05, 0.5) for x in (0.6, 1.1)
    ]
    found = programs(MAPS["stiffness"].build, "semi_implicit", "float64").run(grid, dt)
    assert found.verdict[::2] == [SETTLED] * 2 and SETTLED not in found.verdict[1::2]


def test_the_check_returns_the_cells_that_do_not_settle():
    bad = unsettled("semi_implicit", stiffness=(1e3, 1e7), dts=(1e-3,), masses=(0.05,), mus=(0.0, 0.5))
    assert [(c["stiffness"], c["mu"], c["verdict"]) for c in bad] == [
        (1e7, mu, BLOWN_UP) for mu in (0.0, 0.5)
    ]


def test_a_ball_that_loses_nothing_bounces_on():
    def ball(method, numbers):
        thing = Object(Sphere(0.02), body=Body(0.05), position=(0.0, 0.0, 0.04))
        floor = Contact(1e4, mu=0.5, between=("ball", "floor"))
        world = World(gravity=(0.0, 0.0, -9.81))
        scene = Scene({"ball": thing, "floor": Object(Plane())}, {"floor": floor}, world=world)
        return scene, hapjax.init(scene, jnp.full((1, 3), 10.0))

    found = programs(ball, "semi_implicit", "float64").run([BASE], 2e-4)
    assert found.verdict == [RINGING] and found.quiet_after[0] > 1.9
    assert (
        found.peak[0] < 0.05
    )  # never more energy than at the start, but for the swing of semi-implicit Euler


# The closed loop --------------------------------------------------------------------------------------------


def eigenvalue_limit(mass, damping, period, delay, spring=0.0):
    """The stiffness at which the sampled loop, a linear map of place, speed and the last places, reaches radius 1."""
    # A spring of next to nothing stands for none: what a held force does is then found by one formula.
    rates = np.array([[0.0, 1.0], [-max(spring, 1e-3) / mass, -damping / mass]])
    speeds, shapes = np.linalg.eig(rates)
    moved = np.real(shapes @ np.diag(np.exp(speeds * period)) @ np.linalg.inv(shapes))
    pushed = np.linalg.solve(rates, (moved - np.eye(2))[:, 1] / mass)

    def radius(stiffness):
        step = np.eye(2 + delay, k=-1)
        step[:2] = 0
        if delay:
            step[2] = 0
            step[2, 0] = 1
        step[:2, :2] = moved
        step[:2, 0 if delay == 0 else 1 + delay] -= stiffness * pushed
        return np.max(np.abs(np.linalg.eigvals(step)))

    low, high = 1.0, 1e7
    for _ in range(60):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if radius(middle) < 1 else (low, middle)
    return low


def test_the_stiffest_wall_is_that_of_the_eigenvalues():
    hand = loop.HELD
    found = loop.measure(rates=(500.0,), masses=(0.05,), dampings=(0.5, 5.0), delays=(0, 2))
    for limit in found:
        period = 1 / limit.rate
        truth = eigenvalue_limit(limit.mass, limit.damping, period, limit.delay)
        assert limit.stable == pytest.approx(truth, rel=2e-3)
        assert limit.stable >= limit.passive * (1 - 1e-3)  # a passive wall is stable with any device
        held = limit.mass + hand.mass, limit.damping + hand.damping
        truth = eigenvalue_limit(*held, period, limit.delay, hand.stiffness)
        assert limit.held == pytest.approx(truth, rel=2e-3)
        assert limit.held >= limit.passive_held * (1 - 1e-3) > limit.passive
    assert found[-1].stable > 1.05 * found[-1].passive


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_the_passive_stiffness_is_colgates_bound(delay):
    """b > T/2 Re[(1 - e^-jwT) H] / (1 - cos wT) at all w, on a grid of frequencies."""
    period, damping = 1e-3, 2.0
    stiffness = loop.passive_stiffness(damping, 1 / period, delay)
    angle = np.linspace(1e-4, np.pi, 20_000)
    wall = stiffness * np.exp(-1j * angle * delay)
    needed = period / 2 * np.real((1 - np.exp(-1j * angle)) * wall) / (1 - np.cos(angle))
    assert np.max(needed) == pytest.approx(damping, rel=1e-6)


# A user's own scene -----------------------------------------------------------------------------------------


def test_what_a_device_needs_for_the_scenes_surfaces(tmp_path):
    (tmp_path / "plate.toml").write_text(PLATE)
    (wall,) = own.walls(hapjax.load_scene(tmp_path / "plate.toml"), 1000.0)
    assert wall == pytest.approx(("object.plate.surface", 800.0, 0.4, 1.2))


def scene_of(**changes):
    parts = {
        "object": {"cube": Object(Box((0.04,) * 3), body=Body(0.05)), "floor": Object(Plane())},
        "contact": {"on_floor": Contact(1e4, mu=0.5, between=("cube", "floor"))},
        "world": World(gravity=(0.0, 0.0, -9.81)),
    }
    return Scene(**parts | changes)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"world": World()}, "world.gravity is none"),
        ({"contact": {}}, "object.cube has a body and no contact"),
    ],
)
def test_scenes_that_cannot_come_to_rest_are_refused(change, said):
    with pytest.raises(InputError, match=said):
        own.scaled_map(scene_of(**change))


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--maps", "stifness"], "maps has 'stifness'"),
        (["--integrators", "euler"], "integrators has 'euler'"),
        (["--scene", "{scene}", "--rate", "1"], "rate is 1 Hz"),
        (["--scene", "{scene}", "--fingers", "0"], "fingers is 0"),
        (["--out", "{file}"], "cannot be made a folder"),
        (["--out", "/proc/x"], "cannot be made a folder"),
        (["--fingers", "2"], "fingers is 2 without a scene; allowed: with --scene"),
        (["--scene", "{scene}", "--maps", "spin"], "maps is spin with a scene; allowed: without --scene"),
        (["--error", "1e-5"], "error is 1e-05 without a scene; allowed: with --scene"),
        (["--scene", "{scene}", "--error", "-5"], "error is -5 m; allowed: above 0 and finite"),
        (["--scene", "{scene}", "--error", "inf"], "error is inf m; allowed: above 0 and finite"),
        (
            ["--scene", "{scene}", "--hip", "lift.npz"],
            "hip is lift.npz without error; allowed with stability",
        ),
        (["--scene", "{scene}", "--error", "1e-5"], "no object with a body has a surface for fingers"),
    ],
)
def test_bad_input_is_refused_in_a_sentence(arguments, said, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    (tmp_path / "plate.toml").write_text(PLATE)
    arguments = [a.format(file=tmp_path / "file", scene=tmp_path / "plate.toml") for a in arguments]
    assert main(["benchmark", "stability", *arguments]) == 2
    assert said in capsys.readouterr().err


def table(path):
    """The rows of a CSV file, by the names of its columns."""
    return list(csv.DictReader(path.read_text().splitlines()))


@pytest.mark.slow
def test_a_quick_run_leaves_everything(tmp_path, capsys):
    arguments = ["--quick", "--maps", "stiffness", "loop", "--integrators", "semi_implicit"]
    out, figures = tmp_path / "report", tmp_path / "figures.json"
    assert main(["benchmark", "stability", *arguments, "--out", str(out), "--json", str(figures)]) == 0
    assert "semi_implicit" in capsys.readouterr().out
    rows = table(out / "stability.csv")
    assert len(rows) == 2 * 3 * 5  # precisions, time steps, values
    soft = [r for r in rows if (r["value"], r["dt"]) == ("100.0", "0.001")]
    assert [r["verdict"] for r in soft] == [SETTLED] * 2
    assert len(json.loads(figures.read_text())["loop"]) == len(table(out / "loop.csv"))
    html = (out / "stability.html").read_text()
    assert html.count("data:image/png;base64,") == 2 and "://" not in html  # "http" base64 may hold
    assert all(png.stat().st_size < 100_000 for png in out.glob("*.png"))


@pytest.mark.slow
def test_the_recommendation_is_the_substeps_that_the_explicit_limit_asks_for(tmp_path, capsys):
    """A cube of 50 g on 100 kN/m a corner: 2 / w is 0.58 ms, so 1 kHz takes 2 substeps at least, and 8 are too many."""
    (tmp_path / "cube.toml").write_text(SCENE)
    figures = tmp_path / "figures.json"
    arguments = ["--scene", str(tmp_path / "cube.toml"), "--quick", "--integrators", "semi_implicit"]
    assert main(["benchmark", "stability", *arguments, "--json", str(figures)]) == 0
    choices = json.loads(figures.read_text())["choices"]
    assert choices[0]["substeps"] == 1 and choices[0]["margin"] < 1
    best = next(c for c in choices if c["margin"] >= 1)
    assert best["substeps"] in (2, 4)
    assert f"substeps = {best['substeps']}" in " ".join(capsys.readouterr().out.split())


@pytest.mark.slow
def test_the_recommendation_bears_the_press_of_two_fingers(monkeypatch):
    """On soft contacts a cube of 10 g needs no substeps. Between two fingers of k = 1e6 N/m it swings by w^2 = 2 k / m, so
    steps have to be below 2 / w = 141 us: 8 substeps of 1 ms at the least."""
    surface = hapjax.Surface(1e6, mu=0.6)
    cube = Object(Box((0.04,) * 3), surface, Body(0.01), position=(0.0, 0.0, 0.02))
    floor = Contact(500.0, mu=0.5, damping=1.0, between=("cube", "floor"))
    scene = hapjax.cast(
        scene_of(object={"cube": cube, "floor": Object(Plane())}, contact={"on_floor": floor}), jnp.float64
    )
    begin, end = touch.fingers(scene)
    np.testing.assert_allclose(begin[:, 0], [-0.021, 0.021], atol=1e-6)
    np.testing.assert_allclose(np.abs(end[:, 0]), 0.02 - 1e-6, atol=1e-8)  # 1 N
    monkeypatch.setattr(own, "DTYPES", ("float64",))
    monkeypatch.setattr(touch, "rested", lambda scene: scene)  # as it is, near enough
    found = own.recommend(scene, own.scaled_map(scene), ["semi_implicit"], 1000.0, 2)
    assert [c.pressed for c in found[:3]] == [BLOWN_UP] * 3 and found[0].margin >= 1
    assert own.cheapest(found) == found[-1] and found[-1].substeps in (8, 16)


def test_a_step_is_timed_where_fingers_press(monkeypatch):
    parts = {"cube": Object(Box((0.04,) * 3), Surface(800.0, mu=0.6, damping=1.0), Body(0.05))}
    scene = scene_of(object=parts, contact={}, world=World())
    ends = []
    monkeypatch.setattr(own, "step_us", lambda loops, runs: [ends.append(loops[0]()) or 1.0])
    assert own._step_us(scene, scene, "semi_implicit", 2, 500.0) == 1.0
    pressed = np.asarray(ends[0][1].touch["cube"].normal_force)
    assert not pressed[:50].any()
    np.testing.assert_allclose(pressed[-1], touch.FORCE, rtol=0.05)


def test_the_recommendation_is_within_an_error_where_one_is_asked_for():
    choices = [
        own.Choice("semi_implicit", 1, 1.0, 0.5, "", 1e-3),
        own.Choice("lie_midpoint", 1, 2.0, 3.0, SETTLED, 3e-5),
        own.Choice("lie_midpoint", 2, 4.0, 3.0, BLOWN_UP, 2e-6),
        own.Choice("lie_midpoint", 4, 8.0, 3.0, SETTLED, 1e-6),
    ]
    assert [own.cheapest(choices, e) for e in (1e-2, 1e-4, 1e-5, 1e-7)] == [choices[i] for i in (1, 1, 3)] + [
        None
    ]
    said = page.advice(choices, 500.0, 1e-5, 1e-9)
    assert said == (
        "At 500 Hz the cheapest that settles and stays within 1e-05 m is lie_midpoint with substeps = 4: 8.0 us a step, "
        "1.0e-06 m off at the end, also between two fingers, and contacts up to 3 times as stiff settle too."
    )
    said = page.advice(choices, 500.0, 1e-7, 2e-7)
    assert said.startswith(
        "At 500 Hz nothing that settles stays within 1e-07 m; the cheapest that settles is lie_midp"
    )
    assert "3.0e-05 m off at the end" in said and said.endswith(
        "known to 2e-07 m, so errors below that say nothing."
    )
    assert "m off" not in page.advice([choices[1]._replace(error=None)], 500.0)
    with io.StringIO() as narrow:
        row = choices[2]._replace(integrator="semi_implicit_matrix")
        Console(file=narrow, width=80).print(page.table("", *page.choice_rows([row], 500.0)))
        assert narrow.getvalue().splitlines()[-2].split() == [
            *("semi_implicit_matrix", "2", "4.0", "no", "3", "blown", "up", "2.0e-06")
        ]


def test_substeps_go_on_until_the_error_is_met_too(monkeypatch):
    """All settle from 2 substeps on; 4 are too far off, and are not run."""
    tried = []

    def run(grid, dt):
        tried.append(round(1 / (1000 * dt)))
        return SimpleNamespace(verdict=[SETTLED if tried[-1] > 1 else RINGING])

    monkeypatch.setattr(own, "programs", lambda *_: SimpleNamespace(run=run))
    monkeypatch.setattr(own, "_step_us", lambda *_: 3.0)
    monkeypatch.setattr(own, "DTYPES", ("float64",))
    one = Map("stiffness_factor", "", "", (1.0,), partial(own._scaled, scene_of()))
    errors = {("implicit", n): e for n, e in ((1, np.inf), (2, 1e-3), (4, 1e-3), (8, 1e-6), (16, 1e-7))}
    found = own.recommend(scene_of(), one, ["implicit"], 1000.0, 1, errors=errors, within=1e-5)
    assert tried == [c.substeps for c in found] == [1, 2, 8]
    assert [c.error for c in found] == [np.inf, 1e-3, 1e-6] and own.cheapest(found, 1e-5) == found[-1]
    assert page.choice_rows(found, 1000.0)[1][0][-1] == "blown up"
    assert [c.substeps for c in own.recommend(scene_of(), one, ["implicit"], 1000.0, 1)] == [1, 2]


@pytest.mark.slow
def test_a_recommendation_with_an_error_is_the_one_of_the_error_itself(tmp_path, capsys, monkeypatch):
    """A ball that stands softly and is lifted: it settles with any substeps, and takes 8 to be within 1e-5 m."""
    surface = Surface(800.0, mu=0.6, damping=1.0)
    ball = Object(Sphere(0.02), surface, Body(0.05, rotation=False), position=(0.0, 0.0, 0.02))
    floor = Contact(1e3, mu=0.5, damping=1.0, between=("ball", "floor"))
    scene = scene_of(object={"ball": ball, "floor": Object(Plane())}, contact={"on_floor": floor})
    hapjax.save_scene(scene, tmp_path / "ball.toml")
    hips = moved.operator(scene, 2, 1000.0)[:400]
    hapjax.Recording(hip=hips, hip_t=np.arange(400) / 1000).save(tmp_path / "lift.npz")
    monkeypatch.setattr(maps, "measure", lambda *_: [])
    monkeypatch.setattr(touch, "touched", lambda scene: [])
    monkeypatch.setattr(_sweep, "LONGEST", 0.5)
    monkeypatch.setattr(_sweep, "WITNESSES", ("lie_midpoint", "semi_implicit"))
    for module in (own, moved):
        monkeypatch.setattr(module, "SUBSTEPS", (1, 8))
    monkeypatch.setattr(own, "DTYPES", ("float64",))
    options = [
        "--integrators",
        "semi_implicit",
        "--quick",
        "--error",
        "1e-5",
        "--hip",
        str(tmp_path / "lift.npz"),
    ]
    options += ["--json", str(tmp_path / "stability.json")]
    assert main(["benchmark", "stability", "--scene", str(tmp_path / "ball.toml"), *options]) == 0
    figures, printed = json.loads((tmp_path / "stability.json").read_text()), capsys.readouterr().out
    assert figures["error"] == 1e-5 and 0 < figures["floor"] < 1e-5
    first, last = figures["choices"]
    assert (first["substeps"], last["substeps"]) == (1, 8) and first["margin"] >= 1 and last["margin"] >= 1
    assert first["error"] > 1e-5 > last["error"] > 0
    assert first["error"] / last["error"] == pytest.approx(8, rel=0.3)  # of first order
    assert "stays within 1e-05 m is semi_implicit with substeps = 8" in " ".join(printed.split())
    assert f"{last['error']:.1e} m off at the end" in " ".join(printed.split())


def test_surfaces_alone_need_no_simulation(tmp_path, capsys):
    (tmp_path / "plate.toml").write_text(PLATE)
    assert main(["benchmark", "stability", "--scene", str(tmp_path / "plate.toml")]) == 0
    assert "object.plate.surface" in capsys.readouterr().out
