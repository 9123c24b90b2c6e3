"""The programs of the docs that need something around them: a recording, a loop that runs, a job.

They are run as they stand, but with shorter recordings and runs where a replacement says so.
"""

import json
import os
import socket
import subprocess
import sys
import threading
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest
from mcap.reader import make_reader

import hapjax
from hapjax_devices import VirtualDevice
from test_docs import blocks
from test_recording_mcap import bag


def programs(page):
    """The programs of a page."""
    return [text for language, text in blocks(page) if language == "python"]


def do(program, shorter=(), **names):
    """Run a program in the folder that is the present one; what it left."""
    for long, short in shorter:
        assert program.count(long) == 1, long
        program = program.replace(long, short)
    exec(compile(program, "docs", "exec"), names)
    return names


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.slow
def test_fitting_finds_the_truth(capsys):
    whole, _ = programs("fitting.md")
    do(whole, [("np.arange(600)", "np.arange(150)"), ("t / 0.05", "t / 0.0125")])
    assert "object.floor.surface.mu" in capsys.readouterr().out
    found = json.loads(Path("fit.json").read_text())["parameters"]
    for name, truth in (("mu", 0.6), ("stiffness", 800.0)):
        assert found[f"object.floor.surface.{name}"]["estimate"] == pytest.approx(truth, rel=0.02)
    assert Path("report/report.html").stat().st_size > 10_000


@pytest.mark.slow
def test_a_program_joins_a_job_and_fits(tmp_path):
    """A job of one process, as SLURM's environment tells of it."""
    (program,) = programs("cluster.md")
    surface = hapjax.Surface(800.0, mu=0.6)
    hapjax.save_scene(hapjax.Scene({"floor": hapjax.Object(hapjax.Plane(), surface)}), "floor.toml")
    t = 1e-3 * np.arange(60)
    x = 0.3 * t
    force = np.stack([0 * t - 0.48, 0 * t, 0 * t + 0.8], axis=-1)[:, None]
    force += 0.02 * np.random.default_rng(0).standard_normal(force.shape)
    hapjax.Recording(
        hip=np.stack([x, 0 * t, 0 * t - 1e-3], -1)[:, None], hip_t=t, force=force, force_t=t
    ).save("a.npz")
    loaded = "import hapjax\nscene = hapjax.load_scene('floor.toml')\nrecordings = [hapjax.load_recording('a.npz')]\n"
    Path("fit.py").write_text(program.replace("result = fit", f"{loaded}\nresult = fit"))
    job = {
        "SLURM_JOB_ID": str(free_port() - SLURM_PORT),
        "SLURM_STEP_NODELIST": "localhost",
        "SLURM_NTASKS": "1",
    }
    job |= {"SLURM_PROCID": "0", "SLURM_LOCALID": "0", "SLURM_STEP_NUM_NODES": "1"}
    done = subprocess.run([sys.executable, "fit.py"], env=os.environ | job, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    mu = json.loads(Path("fit.json").read_text())["parameters"]["object.floor.surface.mu"]
    assert mu["estimate"] == pytest.approx(0.6, rel=0.02)


SLURM_PORT = 65536 - 2**12  # and above: where the processes of a job meet, by its number


def free_port():
    for port in range(SLURM_PORT, 65536):
        with socket.socket() as tried:
            if tried.connect_ex(("localhost", port)):
                return port
    raise AssertionError("no port is free")


def test_recordings_are_loaded_saved_and_of_a_bag():
    t = np.arange(20) / 1000
    hip = np.linspace(0, 0.01, 120).reshape(20, 2, 3)
    hapjax.Recording(hip=hip, hip_t=t).save("lift.npz")
    own, ros = programs("recording.md")
    left = do(own, hapjax=hapjax)
    assert left["recording"].fingers == 2
    np.testing.assert_array_equal(hapjax.load_recording("lift.csv").hip, hip)
    stamps = 10**9 + 10**6 * np.arange(20)
    sides = {"left": 0, "right": 1}
    topics = {f"/{side}/tip": ("PointStamped", stamps, hip[:, i]) for side, i in sides.items()}
    topics |= {f"/{side}/sensor": ("WrenchStamped", stamps, hip[:, i]) for side, i in sides.items()}
    pose = np.concatenate([hip[:, 0], np.tile([1.0, 0, 0, 0], (20, 1))], axis=-1)
    bag("bag_0.mcap", topics | {"/cube": ("PoseStamped", stamps, pose)})
    found = do(ros, hapjax=hapjax)["recording"]
    assert found.fingers == 2 and found.force.shape == (20, 2, 3) and found.pose.shape == (20, 1, 7)


def test_a_message_and_a_refusal_are_as_shown():
    t = 0.001 * np.arange(1, 812)
    hip = np.broadcast_to([[0.0, 0.0, 0.03], [0.1, 0.0, 0.03]], (811, 2, 3))
    lift = hapjax.Recording(hip=hip, hip_t=t)
    lift.save("lift.mcap")
    with open("lift.mcap", "rb") as file:
        message = next(make_reader(file).iter_messages())[2].data
    shown = dict(blocks("recording.md"))
    assert json.loads(message) == json.loads(shown["json"])
    lift.save("lift.csv")
    lines = Path("lift.csv").read_text().splitlines()
    row = lines[811].split(",")
    lines[811] = ",".join(["0.809", *row[1:]])
    Path("lift.csv").write_text("\n".join(lines))
    with pytest.raises(hapjax.InputError) as refused:
        hapjax.Recording.load("lift.csv")
    assert f"{refused.value}\n" == shown["text"]


def test_the_example_of_a_test_is_one():
    (program,) = programs("../CONTRIBUTING.md")
    do(program, jnp=jnp)["test_push_is_along_the_normal"](jnp.float32)


CUBE = hapjax.Object(hapjax.Box((0.06,) * 3), hapjax.Surface(800.0, mu=0.6))


@pytest.mark.slow
def test_realtime_is_read_changed_and_recorded(capsys):
    """The three programs of the page at once, on one loop."""
    reading, changing, recording = programs("realtime.md")
    others, late = [], []

    def beside(program):
        try:
            others.append(do(program))
        except hapjax.InputError as error:
            late.append(error)

    threads = [threading.Thread(target=beside, args=(program,)) for program in (reading, changing)]
    for thread in threads:
        thread.start()
    path = np.array([[0.0, 0.0, 0.031]])
    left = do(
        recording,
        [("10.0", "2.0"), ("readers=1)", 'readers=2), live=["object.cube.surface.mu"]')],
        scene=hapjax.Scene({"cube": CUBE}),
        devices=[VirtualDevice(path)],
    )
    for thread in threads:
        thread.join()
    hip = hapjax.load_recording("lift.mcap").hip
    assert left["code"] == 0 and hip is not None and len(hip) == 2000
    if late:
        pytest.skip(f"this machine was too busy for a run of 2 s: {late[0]}")
    (ticks,) = (found["ticks"] for found in others if "ticks" in found)
    (tick,) = (found["tick"] for found in others if "tick" in found)
    assert "'object.cube.surface.mu': array(0.6)" in capsys.readouterr().out and "hip" in ticks.dtype.names
    assert 0 <= tick < 2000
