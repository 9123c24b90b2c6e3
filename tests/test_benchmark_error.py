"""The work-precision diagrams: orders, who is ahead, the command."""

import csv
import dataclasses
import json
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import hapjax
from hapjax import cli
from hapjax.benchmark import _error_page, _mujoco, _order, _sweep, error, error_scene
from hapjax.benchmark._sweep import Point, Program
from hapjax.benchmark.cases import CASES, sliding
from hapjax.integrate import METHODS

KNOWN: dict[str, Any] = dict(CASES)

# Coarsest and finest dt: where errors go like a power of dt. One of each integrator and of each kind of theory: smooth
# forces, slides that end, touches, a derivative of each.
SWEPT = [
    ("incline_slide", "semi_implicit", -3, -4),
    ("restitution", "semi_implicit", -3.25, -4.25),
    ("load_step", "semi_implicit_matrix", -3.5, -4.5),
    ("roll", "pivot", -3.25, -4.25),
    ("top", "lie_midpoint", -2, -3),
    ("restitution", "lie_midpoint", -3.25, -4.25),
    ("disc", "lie_midpoint", -2.5, -3.5),
    ("restitution", "implicit", -3.5, -4.5),
]


@pytest.mark.slow
@pytest.mark.parametrize("name, integrator, coarse, fine", SWEPT)
def test_orders_are_the_theorys(name, integrator, coarse, fine):
    case = KNOWN[name]
    dts = np.logspace(coarse, fine, 4).tolist()
    finest = _sweep.steps_of(case.seconds, dts)[-1]
    sweep = _sweep.Sweep(dts, (), 3, 10 * finest, gradients=name != "disc")  # the disc's takes long
    points, _ = _sweep.curve(case, integrator, case.truth(), case.truth(), sweep)
    found = error.orders(points, case, integrator, error.SOLVED, True)
    slope = case.gradient_order(integrator) if sweep.gradients else None
    expected = {"order": case.order(integrator).value, "gradient_order": slope}
    assert found == pytest.approx(expected, abs=0.2)


def test_a_program_is_pressed_on_by_the_law_as_stiff_as_dt_allows():
    case = KNOWN["slide"]
    stiff = case.rigid(case.scene(METHODS["semi_implicit"]()), 1e-3)
    assert float(stiff.contact["block_on_floor"].stiffness) == pytest.approx(sliding.MASS / 4 / 1e-6)
    program = Program(case, "semi_implicit")
    own, law = program.run(500)[0], program.run(500, rigid=True)[0]
    assert _sweep.difference(own, case.truth()) > 0.01  # too stiff for 1 ms
    assert _sweep.difference(law, case.law()) < 1e-3


@pytest.mark.parametrize(
    "name, steps, within", [("load_step", 400, 1e-6), ("bounces", 2000, 1e-4), ("tip_rest", 2000, 1e-9)]
)
def test_mujocos_model_has_the_same_truth(name, steps, within):
    pytest.importorskip("mujoco")
    case = KNOWN[name]
    value, _ = _mujoco.Model(case, case.mujoco, "RK4").run(steps, 1)
    assert _sweep.difference(value, case.truth()) < within


def test_mujocos_pass_against_slip_runs_where_a_case_holds():
    pytest.importorskip("mujoco")
    case = KNOWN["incline_hold"]
    assert {name for name in CASES if _mujoco.NOSLIP in _mujoco.variants(KNOWN[name])} == {
        "incline_hold",
        "lift_hold",
    }
    slips, holds = (
        np.linalg.norm(_mujoco.Model(case, case.mujoco, name).run(1000, 1)[0]) for name in ("Euler", "noslip")
    )
    assert holds < 1e-15 < 1e-6 < slips


def test_mujoco_blowing_up_is_told_and_leaves_no_file(tmp_path, monkeypatch, capfd):
    pytest.importorskip("mujoco")
    monkeypatch.chdir(tmp_path)
    case = KNOWN["rod"]
    value, _ = _mujoco.Model(case, case.mujoco, "Euler").run(30, 1)
    assert (
        np.isnan(value).all()
        and not list(tmp_path.iterdir())
        and "WARNING" not in "".join(capfd.readouterr())
    )


@pytest.mark.slow
def test_the_truth_of_a_stiff_scene_is_one_that_two_integrators_agree_on(monkeypatch):
    """A block of 1 g on four corners of 1e8 N/m: explicit steps have to be below 2 us, finer than any that is swept."""
    block = hapjax.Object(
        hapjax.Box((0.04,) * 3), body=hapjax.Body(1e-3, rotation=False), position=(0, 0, 0.02)
    )
    floor = hapjax.Contact(1e8, mu=0.5, damping=1.0, between=("block", "floor"))
    parts = {"block": block, "floor": hapjax.Object(hapjax.Plane())}
    stiff = hapjax.Scene(parts, {"floor": floor}, world=hapjax.World(gravity=(0, 0, -9.81)))
    scene = hapjax.cast(stiff, jnp.float64)
    case, sweep = (
        error_scene.scene_case(scene, np.full((21, 1, 3), 9.0), None, 1000.0),
        error_scene.sweep_at(1000.0),
    )
    with pytest.raises(hapjax.InputError, match="no truth to compare with"):
        monkeypatch.setattr(_sweep, "WITNESSES", ("implicit",))
        _sweep.extrapolated(case, sweep)
    monkeypatch.undo()
    truth, floor = _sweep.extrapolated(case, sweep)
    assert floor < 1e-6
    np.testing.assert_allclose(truth, [0, 0, 0.02], atol=1e-8)  # it yields by m g / 4 k, 2e-11 m


# Orders and comparisons ------------------------------------------------------------------------------------


def test_an_order_is_fitted_to_the_finest_steps_above_the_noise():
    dts = np.logspace(-2, -5, 13)
    noisy = np.maximum(3 * dts**2, 1e-9)  # the truth is known to 1e-9
    assert _order.fitted_order(dts, noisy, 1.0, 1e-9) == pytest.approx(2, abs=1e-6)
    coarse = dts + 100 * dts**2  # of another order where dt is coarse
    assert _order.fitted_order(dts, coarse, 1.0, 0.0) == pytest.approx(1, abs=0.03)
    assert _order.fitted_order(dts, np.full(13, 1e-12), 1.0, 1e-12) is None
    assert _order.fitted_order(dts[:3], [1.0, np.inf, None], 1.0, 0.0) is None
    spun = 3 * dts**2 + 75 * np.finfo(float).eps / dts  # it turns by 75 rad
    assert _order.fitted_order(dts, spun, 1.0, 0.0, 75.0) == pytest.approx(2, abs=0.05)
    unstable = np.where(dts > 2e-4, 0.1, 3 * dts**2)
    assert _order.fitted_order(dts, unstable, 1.0, 1e-12) == pytest.approx(2, abs=1e-6)
    assert _order.fitted_order(dts, spun, 1.0, 0.0, 75.0, scatters=False) == pytest.approx(2, abs=0.05)
    # A step's rounding counts: 1e5 of them to 2e-10, and thrice that.
    assert _order.fitted_order([1e-5] * 3, [6e-10] * 3, 1.0, 0.0) is None


def test_where_errors_do_not_scatter_an_order_is_fitted_to_steps_whose_own_orders_agree():
    dts = np.logspace(-2, -5, 13)
    bent = dts + 3e3 * dts**2  # of order 2 down to 0.3 ms
    fitted = _order.fitted_order(dts, bent, 1.0, 0.0)
    assert fitted is not None and fitted > 1.15
    assert _order.fitted_order(dts, bent, 1.0, 0.0, scatters=False) == pytest.approx(1.07, abs=0.03)
    swings = dts * (1.5 + np.cos(7 * np.log10(dts)))
    assert _order.fitted_order(dts, swings, 1.0, 0.0) is not None
    assert _order.fitted_order(dts, swings, 1.0, 0.0, scatters=False) is None


def test_what_chance_moves_by_dt_squared_scatters_where_errors_are_no_larger():
    assert not KNOWN["top"].scatters("lie_midpoint") and not KNOWN["bounces"].scatters("implicit")
    assert KNOWN["bounces"].scatters("lie_midpoint") and KNOWN["tip"].scatters("lie_midpoint")
    assert KNOWN["restitution"].scatters("pivot")  # of order 2
    assert KNOWN["tip"].scatters("pivot") and not KNOWN["tip"].scatters("implicit")  # which looks ahead
    assert KNOWN["slide"].scatters("pivot")  # its rigid law


def test_which_steps_are_run_does_not_depend_on_the_machine():
    sweep = _sweep.Sweep([1e-2, 1e-3, 1e-4], [], 0, 4995, gradients=False)
    assert sweep.longest("implicit") == 999
    full = _sweep.FULL
    assert [len(full.runs("pivot", n, True)) for n in (300_000, 100_000, 30_000)] == [7, 19, 25]
    assert full.has_gradient("pivot", 30_000, True) and not full.has_gradient("pivot", 30_002, True)
    # What does not scatter needs no mean over runs, and goes on to finer steps.
    assert full.runs("implicit", 300, False) == [300] and len(full.runs("implicit", 300, True)) > 20
    assert (full.longest("implicit", True), full.longest("implicit", False)) == (60_000, 300_000)
    assert full.has_gradient("implicit", 300_000, False) and not full.has_gradient("implicit", 300_000, True)
    (coarse, fine), _ = _sweep.curve(KNOWN["sink"], "semi_implicit", None, KNOWN["sink"].truth(), sweep)
    assert fine.dt == pytest.approx(1e-3) and coarse.dt == pytest.approx(1e-2)


def test_why_a_side_is_ahead_is_said_by_the_orders_that_were_measured():
    def why(ours, theirs, dt=1e-3):
        point = {"dt": dt, "error": 1e-3, "law_error": 1e-3}
        curves = {"implicit": {"order": ours, "points": [point]}, "MuJoCo RK4": {"order": theirs}}
        best = {"integrator": "implicit", "dt": dt}, {"integrator": "RK4", "dt": 1e-3}
        row = {"factor": 2.0, "hapjax": best[0], "mujoco": best[1]}
        return _error_page.why({"has_law": False, "curves": curves}, row)

    assert why(0.97, 2.01) == "MuJoCo's RK4 converges here with order 2.0, hapjax's best with 1.0"
    assert why(0.97, 1.02) == why(None, 4.0) == "its error is the larger, at 1 times MuJoCo's dt"
    assert why(None, 4.0, 4.4e-4) == "its error is the larger, at 0.44 times MuJoCo's dt"
    assert why(None, 4.0, 2e-3) == "a step takes longer: 2.0 times MuJoCo's dt in the same time"


def test_a_quick_sweep_has_the_step_its_table_names_and_no_order_of_errors_that_scatter():
    assert min(abs(dt / 1e-3 - 1) for dt in _sweep.QUICK.dts) < 1e-9
    shorter = dataclasses.replace(_sweep.QUICK, dts=_sweep.QUICK.dts[2:6], mujoco_dts=[])
    for name, scatters in {"restitution": True, "top": False}.items():
        assert KNOWN[name].scatters("lie_midpoint") == scatters
        found = error.measure([KNOWN[name]], ["lie_midpoint"], shorter, lambda *_: None)
        assert (found["cases"][name]["curves"]["lie_midpoint"]["order"] is None) == scatters


def points(*pairs):
    return [Point(dt=1e-3, run=run, error=None, law_error=e) for run, e in pairs]


def test_who_is_ahead_at_equal_run_time():
    ours = {"a": points((1e-3, 1e-3), (1e-1, 1e-5)), "b": points((1e-2, 1e-6), (1.0, np.inf))}
    theirs = {"Euler": points((3e-3, 1e-4), (0.3, 1e-7))}
    rows = error.equal_time(ours, theirs, 1e-12)
    assert rows[0]["run"] == pytest.approx(3e-3) and rows[0]["factor"] == pytest.approx(10)
    assert rows[-1]["run"] == pytest.approx(0.3) and rows[-1]["hapjax"]["integrator"] == "b"
    assert rows[-2]["factor"] == pytest.approx(1e-2)
    assert error.equal_time({}, theirs, 1e-12) == []


def test_the_recommendation_is_the_cheapest_within_the_error():
    choices = [
        error_scene.Choice("semi_implicit", 1, np.inf, 1.0),
        error_scene.Choice("lie_midpoint", 1, 3e-5, 2.0),
        error_scene.Choice("semi_implicit", 8, 1e-6, 8.0),
    ]
    said = error_scene.advice(choices, 1e-4, 1000.0, 1e-9)
    assert said.startswith("Cheapest within 0.0001 m at 1000 Hz: lie_midpoint with substeps = 1, 3.0e-05 m")
    assert "semi_implicit with substeps = 8" in error_scene.advice(choices, 1e-5, 1000.0, 1e-9)
    said = error_scene.advice(choices, 1e-8, 1000.0, 1e-7)
    assert said.startswith("None stays within 1e-08 m") and "known to 1e-07 m" in said


def cube(**changes):
    thing = hapjax.Object(
        hapjax.Box((0.06, 0.06, 0.06)),
        hapjax.Surface(800.0, mu=0.6, damping=1.0),
        hapjax.Body(0.2),
        (0.1, 0, 0.03),
    )
    parts: dict[str, Any] = dict(object={"cube": thing}, world=hapjax.World(gravity=(0, 0, -9.81)))
    return hapjax.Scene(**(parts | changes))


def test_the_virtual_operator_grips_what_it_lifts():
    scene = cube()
    hips = error_scene.operator(scene, 3, 1000.0)
    assert hips.shape == (1001, 3, 3)
    outside = np.abs(hips[0, :, 0] - 0.1) > 0.03
    depth = 0.03 - np.abs(hips[500, :, 0] - 0.1)
    assert outside.all()
    assert depth[0] + depth[2] == pytest.approx(depth[1], rel=1e-3)  # two on the one side, one on the other
    assert 0.6 * 800.0 * depth.sum() == pytest.approx(1.5 * 0.2 * 9.81, rel=1e-3)
    assert np.ptp(hips[:, 0, 2]) == pytest.approx(0.01)
    above = error_scene.operator(scene, 1, 1000.0)
    assert above[0, 0, 2] > 0.06 > above[-1, 0, 2]
    with pytest.raises(hapjax.InputError, match="no object with a body has a surface"):
        error_scene.operator(cube(object={"floor": hapjax.Object(hapjax.Plane())}), 3, 1000.0)


def test_a_case_of_a_scene_goes_along_its_fingers_path():
    hips = np.linspace(0, 1, 12).reshape(4, 1, 3)
    case = error_scene.scene_case(cube(), hips, None, 10.0)
    assert case.seconds == pytest.approx(0.2)  # an even number of steps
    np.testing.assert_allclose(case.hip(jnp.asarray(0.15)), (hips[1] + hips[2]) / 2)
    with pytest.raises(hapjax.InputError, match="nothing moves"):
        error_scene.scene_case(cube(object={"floor": hapjax.Object(hapjax.Plane())}), hips, None, 10.0)


# The command -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "arguments, said",
    [
        (["--cases", "pool"], "cases has 'pool'; allowed: top, heavy_top"),
        (["--integrators", "euler"], "integrators has 'euler'; allowed: semi_implicit"),
        (["--scene", "{scene}", "--error", "0"], "error is 0 m; allowed: above 0 and finite"),
        (["--scene", "{scene}", "--error", "nan"], "error is nan m; allowed: above 0 and finite"),
        (["--scene", "{scene}", "--error", "inf"], "error is inf m; allowed: above 0 and finite"),
        (["--scene", "{scene}", "--rate", "1"], "rate is 1 Hz; allowed: 10 to 100000"),
        (["--scene", "{scene}", "--fingers", "0"], "fingers is 0; allowed: 1 to 100"),
        (["--rate", "500"], "rate is 500.0 without a scene; allowed: with --scene"),
        (["--scene", "{scene}", "--quick"], "quick is True with a scene; allowed: without --scene"),
        (["--hip", "lift.npz"], "hip is lift.npz without a scene; allowed: with --scene"),
        (["--out", "{file}/folder"], "cannot be made a folder with files: Not a directory"),
        (["--scene", "{scene}", "--cases", "top"], "cases is top with a scene; allowed: without --scene"),
        (["--scene", "{scene}"], "no object with a body has a surface for fingers"),
    ],
)
def test_bad_input_is_refused_in_one_sentence(arguments, said, tmp_path, capsys):
    (tmp_path / "file").write_text("")
    (tmp_path / "scene.toml").write_text('[object.floor]\nshape = "plane"\n')
    places = {"file": tmp_path / "file", "scene": tmp_path / "scene.toml"}
    assert cli.main(["benchmark", "error", *(a.format(**places) for a in arguments)]) == 2
    out, err = capsys.readouterr()
    assert said in err and err.count("\n") == 1 and not out


@pytest.mark.slow
def test_a_report_is_whole(tmp_path, capsys):
    pytest.importorskip("mujoco")
    arguments = [
        "--cases",
        "top",
        "incline_hold",
        "restitution",
        "--integrators",
        "semi_implicit",
        "lie_midpoint",
    ]
    out, file = tmp_path / "made" / "error", tmp_path / "error.json"
    code = cli.main(["benchmark", "error", *arguments, "--quick", "--out", str(out), "--json", str(file)])
    printed = capsys.readouterr().out
    assert code == 0 and "Orders of convergence" in printed
    assert "MuJoCo does not run restitution: its contacts have no loss" in printed
    figures = json.loads(file.read_text())
    curves = figures["cases"]["top"]["curves"]
    for name in ("semi_implicit", "lie_midpoint"):
        assert curves[name]["order"] == pytest.approx(curves[name]["theory"], abs=0.2)
    held = figures["cases"]["incline_hold"]
    assert held["equal_time"][-1]["factor"] == 1  # both at rounding, MuJoCo by its pass against slip
    slips, holds = (held["curves"][f"MuJoCo {n}"]["points"][0]["law_error"] for n in ("RK4", "noslip"))
    assert holds < 1e-12 < 1e-5 < slips
    with open(out / "error.csv") as stream:
        rows = list(csv.DictReader(stream))
    assert {row["case"] for row in rows} == {"top", "incline_hold", "restitution"}
    assert len(rows) == sum(len(c["points"]) for d in figures["cases"].values() for c in d["curves"].values())
    page = (out / "error.html").read_text()
    assert page.count("data:image/png;base64,") == 3 and "://" not in page  # "http" base64 may hold
    assert sorted(p.name for p in out.iterdir()) == [
        *("error.csv", "error.html", "incline_hold.png", "restitution.png", "top.png")
    ]


@pytest.mark.slow
def test_a_users_scene_ends_with_a_recommendation_that_holds_in_a_loop(tmp_path, capsys, monkeypatch):
    hapjax.save_scene(cube(world=hapjax.World()), tmp_path / "cube.toml")  # nothing to stand on
    hips = error_scene.operator(cube(), 2, 1000.0)[:400]
    hapjax.Recording(hip=hips, hip_t=np.arange(400) / 1000).save(tmp_path / "lift.npz")
    known, find = [], _sweep.extrapolated
    monkeypatch.setattr(_sweep, "extrapolated", lambda *case: known.append(find(*case)) or known[0])
    monkeypatch.setattr(_sweep, "LONGEST", 2.0)
    monkeypatch.setattr(error_scene, "SUBSTEPS", (1, 8))
    options = ["--integrators", "lie_midpoint", "--rate", "500", "--error", "1e-5"]
    options += ["--json", str(tmp_path / "error.json")]
    scene = ["--scene", str(tmp_path / "cube.toml"), "--hip", str(tmp_path / "lift.npz")]
    assert cli.main(["benchmark", "error", *scene, *options]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "Cheapest within 1e-05 m at 500 Hz: lie_midpoint with substeps = 8" in printed
    promised = {
        c["substeps"]: c["error"] for c in json.loads((tmp_path / "error.json").read_text())["choices"]
    }
    path = jnp.asarray(hips[:397:2])  # what a loop at 500 Hz sees, an even number of steps
    case = error_scene.scene_case(cube(), np.asarray(path), None, 500.0)
    for substeps, error_promised in promised.items():
        integrator = hapjax.LieMidpoint(1 / 500, substeps)
        lifted = hapjax.cast(cube(world=hapjax.World(), integrator=integrator), jnp.float64)
        end, _ = hapjax.rollout(lifted, hapjax.init(lifted, path[0]), path[1:])
        error_seen = _sweep.difference(np.asarray(case.measure(end)), known[0][0])
        assert error_promised == pytest.approx(error_seen, rel=1e-6)
