"""What gradients and batches cost: sizes, refusals, and the scene that MuJoCo shares."""

import os
import time
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hapjax
from hapjax.benchmark import _grip, batch, gradient, gradient_settings
from hapjax.cli import main
from helpers import followed


def test_the_fingers_hold_the_cube_and_lift_it():
    hips = _grip.grip(600, 0.02)
    scene = _grip.scene()
    end, reply = hapjax.rollout(scene, hapjax.init(scene, hips[0]), hips)
    pressed = np.asarray(reply.touch["cube"].normal_force)[-1]
    np.testing.assert_allclose(pressed, _grip.PRESS, rtol=0.05)
    assert float(end.motion["cube"].position[2]) > _grip.SIDE / 2 + 0.015


@pytest.mark.slow
def test_the_gradients_report(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(gradient, "PARAMETERS", (1, 2))
    bars = followed(monkeypatch, gradient)
    figures = gradient.measure(None, 3, steps=20, lengths=(256, 4096), settings={})
    assert bars == [{"total": 15.0, "told": 15.0, "apart": True}]
    own = figures["times"]["as it is"]
    assert list(own) == ["forward pass", "reverse", "reverse, checkpoint", "forward, 1", "forward, 2"]
    assert own["forward pass"]["ratio"] == 1
    assert all(row["run_s"] > 0 and row["compile_s"] > 0 for row in own.values())
    plain, spared = figures["memory"]["without checkpoint"], figures["memory"]["checkpoint"]
    assert plain["exponent"] > 0.8 and spared["exponent"] < 0.6
    assert spared["bytes"][1] < plain["bytes"][1] / 3
    # A gradient keeps the state of each step, and nothing else of it.
    scene, (fewer, more) = _grip.scene(), plain["bytes"]
    state = hapjax.init(scene, _grip.grip(1, 0.0)[0])
    kept = sum(leaf.nbytes for leaf in jax.tree.leaves(state))
    assert (more - fewer) / (4096 - 256) < 1.5 * kept
    monkeypatch.setattr(gradient, "measure", lambda scene, fingers: figures)
    monkeypatch.setenv("COLUMNS", "200")  # wide figures would break the words beside them
    assert main(["benchmark", "gradient", "--json", str(tmp_path / "f.json")]) == 0
    assert "reverse, checkpoint" in capsys.readouterr().out and (tmp_path / "f.json").stat().st_size > 100


def pauses(unit: float):
    """Programs that take as long as the environment says."""

    def pause(times):
        time.sleep(times * unit * float(os.environ.get("SLOWER", "1")))

    return {"pass": (partial(pause, 1), 0.5), "gradient": (partial(pause, 3), float(os.getpid()))}


@pytest.mark.slow
def test_settings_are_those_of_processes_of_their_own():
    told = []
    slower = {"slower": {"SLOWER": "4"}}
    found = gradient_settings.side_by_side(pauses, (0.003,), slower, lambda doing, _: told.append(doing))
    assert told[:3] == ["built", "built, slower", "round 1 of 10"] and len(told) == 12
    assert "SLOWER" not in os.environ and list(found) == ["as it is", "slower"]
    for name, times in (("as it is", 1), ("slower", 4)):
        assert found[name]["pass"]["run_s"] >= 0.003 * times and found[name]["pass"]["compile_s"] == 0.5
        assert found[name]["gradient"]["run_s"] >= 0.009 * times
        ratio = found[name]["gradient"]["run_s"] / found[name]["pass"]["run_s"]
        assert found[name]["gradient"]["ratio"] == ratio
    assert (
        found["as it is"]["gradient"]["compile_s"] == os.getpid() != found["slower"]["gradient"]["compile_s"]
    )
    table = gradient._time_table(
        {"steps": 1, "integrator": "", "dtype": "", "device": "", "fingers": 1} | {"times": found}
    )
    assert [column.header for column in table.columns] == ["what", "as it is", "slower"]
    assert str(list(table.columns[1].cells)[0]).endswith(" (1.0)")
    (_, said) = gradient.fastest({"times": found})
    assert said.startswith("gradient: least with as it is, ") and "compiled in" in said


def test_the_least_of_several_runs_counts():
    rounds = [{"pass": 2.0, "reverse": 6.0}, {"pass": 3.0, "reverse": 5.0}]
    found = gradient_settings._least(rounds, {"pass": 0.0, "reverse": 7.0})
    assert found["reverse"] == {"run_s": 5.0, "ratio": 2.5, "compile_s": 7.0}
    assert found["pass"]["run_s"] == 2.0


def test_settings_that_a_process_has_are_not_measured_twice(monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "cpu")
    monkeypatch.delenv("NPROC", raising=False)
    monkeypatch.setenv("XLA_FLAGS", "--xla_cpu_enable_fast_math=false")
    found = gradient_settings.others()
    assert list(found) == ["NPROC=1", "in order", "loop flag"]
    flags = [found[name]["XLA_FLAGS"] for name in gradient_settings.FLAGS]
    assert flags == [f"{os.environ['XLA_FLAGS']} {flag}" for flag in gradient_settings.FLAGS.values()]
    monkeypatch.setenv("XLA_FLAGS", flags[1])
    monkeypatch.setenv("NPROC", "1")
    assert list(gradient_settings.others()) == ["in order"]
    monkeypatch.delenv("NPROC")
    assert list(gradient_settings.others()) == ["NPROC=1", "in order"]
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert gradient_settings.others() == {}


@pytest.mark.slow
def test_forward_derivatives_in_the_scale_of_numbers_are_differences():
    scene, hips = _grip.scene(), jnp.asarray(_grip.grip(30, 0.01))
    start = hapjax.init(scene, hips[0])
    (slope,) = gradient._scaled(scene, 1)(scene, start, hips, False)
    step = 1e-4
    ends = []
    for sign in (1, -1):
        surface = hapjax.Surface(_grip.STIFFNESS * (1 + sign * step), mu=_grip.MU, damping=1.0)
        parts = dict(scene.object)
        parts["cube"] = hapjax.Object(
            parts["cube"].shape, surface, parts["cube"].body, position=parts["cube"].position
        )
        changed = hapjax.Scene(parts, scene.contact, world=scene.world, integrator=scene.integrator)
        ends.append(float(gradient._end(changed, start, hips, False)))
    assert float(slope) == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-4)


@pytest.mark.slow
def test_a_held_cube_does_not_creep_and_batches_run():
    pytest.importorskip("mujoco")
    found = batch.measure(sizes=(2,), steps=5, held=0.5, integrators=("semi_implicit",))
    (row,) = found["batches"]
    assert min(row[name] for name in ("one_call", "two_threads", "mujoco", "gradients")) > 0
    best = max(row["one_call"], row["two_threads"]) / row["mujoco"]
    assert found["ratio"] == pytest.approx(best)
    assert max(found["creep"]["semi_implicit"]) < 1e-6 < found["creep"]["MuJoCo"][0] < 3e-3
    assert found["creep"]["MuJoCo noslip"][0] < 0.1 * found["creep"]["MuJoCo"][0]
    assert len(found["creep"]["semi_implicit"]) == 2 and _grip.tilted(0.3)[1] == pytest.approx(
        9.81 * np.sin(0.3)
    )


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["batch", "--fingers", "2"], "fingers is 2; allowed with batch: 3"),
        (["batch", "--scene", "{scene}"], "scene is given"),
        (["gradient", "--fingers", "2"], "fingers is 2 without a scene"),
        (["gradient", "--fingers", "0"], "1 to 100"),
        (["gradient", "--out", "x", "--cases", "top"], "cases is top with gradient; allowed: with error"),
        (["batch", "--out", "x"], "out is x with batch; allowed: with stability or error or fit"),
        (["gradient", "--scene", "{scene}"], "no object with a body has a surface"),
    ],
)
def test_bad_input_is_refused_in_a_sentence(arguments, said, tmp_path, capsys):
    file = tmp_path / "plate.toml"
    file.write_text('[object.plate]\nshape = "plane"\n[object.plate.surface]\nmu = 0.5\nstiffness = 800.0\n')
    assert main(["benchmark", *(a.format(scene=file) for a in arguments)]) == 2
    assert said in capsys.readouterr().err
