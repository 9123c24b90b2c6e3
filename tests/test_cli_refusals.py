"""Every malformed scene, recording or argument ends in one sentence on stderr and exit code 2."""

from pathlib import Path

import numpy as np
import pytest

from hapjax.cli import main
from test_recording_mcap import json_file

SCENE = """
[object.cube]
shape = "box"
size = [0.06, 0.06, 0.06]
position = [0.0, 0.0, 0.03]

[object.cube.surface]
mu = 0.6
stiffness = 800.0
damping = 1.0

[object.cube.body]
mass = 0.2
inertia = [1.2e-4, 1.2e-4, 1.2e-4]

[object.ball]
shape = "sphere"
radius = 0.02

[object.floor]
shape = "plane"

[contact.cube_on_floor]
between = ["cube", "floor"]
mu = 0.5
stiffness = 5000.0
damping = 0.5

[torsion]
model = "gravity_drop"
critical_area = 2.0e-5
twist_damping = 1.0e-4

[world]
gravity = [0.0, 0.0, -9.81]
gyroscopic = true
dead_band = 0.0

[integrator]
method = "semi_implicit"
dt = 0.001
substeps = 1
"""

# What is replaced in the scene, by what, and words that the sentence must have.
SCENES = [
    ("mu = 0.6", "mu = -0.1", ["object.cube.surface.mu", "-0.1", "0 or above"]),
    ("mu = 0.6", "mu = nan", ["object.cube.surface.mu", "nan"]),
    ("mu = 0.6", "mu = inf", ["object.cube.surface.mu", "inf"]),
    ("mu = 0.6", "mu = true", ["object.cube.surface.mu", "True", "one number"]),
    ("mu = 0.6", 'mu = "high"', ["object.cube.surface.mu", "high"]),
    ("mu = 0.6", "mu = []", ["object.cube.surface.mu", "+x, -x, +y, -y, +z, -z"]),
    ("mu = 0.6", "mu = [0.1, 0.2]", ["object.cube.surface.mu", "+x, -x, +y, -y, +z, -z"]),
    ("mu = 0.6", "mu = [[0.1], [0.2]]", ["object.cube.surface.mu"]),
    ("mu = 0.6", "", ["object.cube.surface.mu", "missing"]),
    ("mu = 0.6", "mu = 0.6\nmu_static = 0.7", ["object.cube.surface", "mu_static", "mu_kinetic"]),
    ("mu = 0.6", "mu_kinetic = 0.7", ["object.cube.surface", "mu_kinetic"]),
    ("mu = 0.6", "mu_static = 0.4\nmu_kinetic = 0.7", ["mu_kinetic is 0.7", "mu_static 0.4"]),
    ("mu = 0.6", "mu_static = 0.4\nmu_kinetic = [0.1, 0.1, 0.1, 0.1, 0.1, 0.1]", ["mu_static", "mu_kinetic"]),
    ("stiffness = 800.0", "stiffness = 0.0", ["object.cube.surface.stiffness", "above 0 N/m"]),
    ("stiffness = 800.0", "", ["object.cube.surface.stiffness", "missing"]),
    ("stiffness = 800.0", "stifness = 800.0", ["object.cube.surface.stifness", "not known", "stiffness"]),
    ("damping = 1.0", "damping = -1.0", ["object.cube.surface.damping", "-1.0"]),
    ("mass = 0.2", "mass = 0", ["object.cube.body.mass", "above 0 kg"]),
    ("mass = 0.2", "mass = [0.2]", ["object.cube.body.mass", "one number"]),
    (
        "[1.2e-4, 1.2e-4, 1.2e-4]",
        "[1.2e-4, 1.2e-4, 9e-4]",
        ["object.cube.body.inertia", "sum of the other two"],
    ),
    ("[1.2e-4, 1.2e-4, 1.2e-4]", "[1.2e-4, 1.2e-4]", ["object.cube.body.inertia", "three numbers"]),
    (
        "[1.2e-4, 1.2e-4, 1.2e-4]",
        "[[1, 0.5, 0], [0, 1, 0], [0, 0, 1]]",
        ["object.cube.body.inertia", "symmetric"],
    ),
    (
        "inertia = [1.2e-4, 1.2e-4, 1.2e-4]",
        "centre = [0, 0, 0.01]",
        ["object.cube.body", "centre", "inertia"],
    ),
    ("inertia =", "rotation = false\ninertia =", ["object.cube.body", "rotation", "inertia"]),
    ("inertia =", "rotation = 1\ninertia =", ["object.cube.body", "rotation", "1"]),
    ("size = [0.06, 0.06, 0.06]", "size = [0.06, 0.06]", ["object.cube.size", "three numbers"]),
    ("size = [0.06, 0.06, 0.06]", "size = [0.06, 0.06, -0.06]", ["object.cube.size", "above 0 m"]),
    ("size = [0.06, 0.06, 0.06]", "radius = 0.06", ["object.cube.radius", "size"]),
    ('shape = "box"', 'shape = "cube"', ["object.cube.shape", "plane, sphere, box"]),
    ('shape = "box"', "shape = 3", ["object.cube.shape", "3"]),
    ('shape = "box"', "", ["object.cube.shape", "missing"]),
    ("radius = 0.02", "radius = -0.02", ["object.ball.radius", "above 0 m"]),
    ("radius = 0.02", "", ["object.ball.radius", "missing"]),
    ("position = [0.0, 0.0, 0.03]", "position = 0.03", ["object.cube.position", "three numbers"]),
    ("position = [0.0, 0.0, 0.03]", "orientation = [0, 0, 0, 0]", ["object.cube.orientation", "not all 0"]),
    ("position = [0.0, 0.0, 0.03]", "orientation = [1, 0, 0]", ["object.cube.orientation", "four numbers"]),
    ('shape = "plane"', 'shape = "plane"\nbody = {mass = 1.0}', ["object.floor", "body", "plane"]),
    ('["cube", "floor"]', '["cube"]', ["contact.cube_on_floor.between", "two objects"]),
    ('["cube", "floor"]', '["cube", "wall"]', ["contact.cube_on_floor.between", "wall", "cube, ball, floor"]),
    ('["cube", "floor"]', '["cube", "cube"]', ["contact.cube_on_floor.between", "twice"]),
    (
        "[torsion]",
        "[object.wall]\nshape='plane'\n[contact.again]\nbetween=['floor','wall']\nmu=1\nstiffness=1\n[torsion]",
        ["contact.again.between", "at most one plane"],
    ),
    ('["cube", "floor"]', '["ball", "floor"]', ["contact.cube_on_floor.between", "without a body"]),
    ("mu = 0.5", "mu = [0.5]", ["contact.cube_on_floor.mu", "one number"]),
    (
        "[torsion]",
        "[contact.again]\nbetween=['floor','cube']\nmu=1\nstiffness=1\n[torsion]",
        ["again", "each pair once"],
    ),
    ('model = "gravity_drop"', 'model = "glue"', ["torsion.model", "glue", "gravity_drop"]),
    ("critical_area = 2.0e-5", "critical_area = 0.0", ["torsion.critical_area", "m^2"]),
    ("twist_damping = 1.0e-4", "twist_damping = -1", ["torsion.twist_damping", "N m s/rad"]),
    ("gravity = [0.0, 0.0, -9.81]", "gravity = -9.81", ["world.gravity", "three numbers in m/s^2"]),
    ("gyroscopic = true", 'gyroscopic = "yes"', ["world.gyroscopic", "true or false"]),
    ("dead_band = 0.0", "dead_band = -1", ["world.dead_band", "N m"]),
    ("dt = 0.001", "dt = 0", ["integrator.dt", "above 0"]),
    ("dt = 0.001", "dt = 2", ["integrator.dt", "at most 1 s"]),
    ("substeps = 1", "substeps = 0", ["integrator.substeps", "1 to 10000"]),
    ("substeps = 1", "substeps = 1.5", ["integrator.substeps", "whole number"]),
    ('method = "semi_implicit"', 'method = "magic"', ["integrator.method", "magic", "semi_implicit"]),
    ("[world]", "[wordl]", ["wordl", "world"]),
    ("[world]", "[world", ["not TOML", "line"]),
    ("[object.cube]", '[object."a b"]\nshape="plane"\n[object.cube]', ["a b", "letters"]),
    (SCENE, "", ["object is empty"]),
    (SCENE, "object = 3", ["object is 3", "table"]),
    (SCENE, "[object]\ncube = 3", ["object.cube is 3", "table"]),
    (SCENE, "x = " + "[" * 5000, ["not TOML"]),
    (SCENE, "\x00", ["not TOML"]),
    ("mu = 0.6", f"mu = {'9' * 400}", ["object.cube.surface.mu", "1329 bits"]),
    ("mu = 0.6", f"mu = 0x{'f' * 5000}", ["object.cube.surface.mu"]),
    ("mu = 0.6", f"mu = {'9' * 5000}", ["not TOML", "digits"]),
    ("mu = 0.6", f"mu = {'[' * 80}1{']' * 80}", ["object.cube.surface.mu"]),
    ("substeps = 1", f"substeps = {'9' * 400}", ["integrator.substeps", "1329 bits"]),
    ("dt = 0.001", "dt = 1979-05-27", ["integrator.dt", "one number"]),
    ("position = [0.0, 0.0, 0.03]", "orientation = [1e-200, 0, 0, 0]", ["object.cube.orientation"]),
    ("position = [0.0, 0.0, 0.03]", "orientation = [1e200, 0, 0, 0]", ["object.cube.orientation"]),
    ("mu = 0.6", '"a\\nb" = 3', ["object.cube.surface.a b is not known"]),
]

ARGUMENTS = [
    ([], ["no command", "demo, run, simulate, fit, view, benchmark"]),
    (["fly"], ["fly"]),
    (["simulate"], ["missing", "--hip", "--out"]),
    (["simulate", "{scene}", "--hip"], ["--hip"]),
    (
        ["simulate", "{folder}/none.toml", "--hip", "{hip}", "--out", "{folder}/o.npz"],
        ["none.toml", "cannot be read"],
    ),
    (["simulate", "{folder}", "--hip", "{hip}", "--out", "{folder}/o.npz"], ["cannot be read"]),
    (["simulate", "{hip}", "--hip", "{hip}", "--out", "{folder}/o.npz"], ["hip.npz", "UTF-8"]),
    (["simulate", "{scene}", "--hip", "{folder}/none.npz", "--out", "{folder}/o.npz"], ["none.npz"]),
    (["simulate", "{scene}", "--hip", "{scene}", "--out", "{folder}/o.npz"], ["scene.toml", ".npz"]),
    (["simulate", "{scene}", "--hip", "{force}", "--out", "{folder}/o.npz"], ["force.npz", "hip"]),
    (["simulate", "{scene}", "--hip", "{single}", "--out", "{folder}/o.npz"], ["single.npz", "one sample"]),
    (["simulate", "{scene}", "--hip", "{long}", "--out", "{folder}/o.npz"], ["long.npz", "10 million"]),
    (["simulate", "{scene}", "--hip", "{hip}", "--out", "{folder}/o.xyz"], ["o.xyz", ".npz"]),
    (["simulate", "{scene}", "--hip", "{hip}", "--out", "{folder}/no/o.npz"], ["no/o.npz", "folder"]),
    (["simulate", "{scene}", "--hip", "{hip}", "--out", "{folder}/o.npz", "--speed", "2"], ["--speed"]),
    (["fit", "--scene", "{scene}", "--free", "object.cube.surface.mu"], ["recording"]),
    (["fit", "{force}", "--free", "object.cube.surface.mu"], ["missing", "--scene"]),
    (["fit", "{force}", "--scene", "{scene}"], ["missing", "--free"]),
    (
        ["fit", "{both}", "--scene", "{scene}", "--free", "object.cube.mu"],
        ["object.cube.mu", "object.cube.surface"],
    ),
    (["fit", "{both}", "--scene", "{scene}", "--free", "object.cube.surface"], ["not a number"]),
    (
        ["fit", "{both}", "--scene", "{scene}", "--free", "object.cube.surface.mu", "--posterior", "10"],
        ["samples is 10", "50 to 100000"],
    ),
    (["fit", "{both}", "--scene", "{scene}", "--free", "object.cube.surface.mu_static"], ["leaves out"]),
    (["fit", "{both}", "--scene", "{scene}", "--free", "object.cube.surface.mu[1]"], ["out of range"]),
    (["fit", "{both}", "--scene", "{scene}", "--free", "world.dead_band"], ["world.dead_band", "above 0"]),
    (
        ["fit", "{both}", "--scene", "{scene}", "--free", "torsion.critical_area", "torsion.critical_area"],
        ["twice"],
    ),
    (
        ["fit", "{both}", "--scene", "{scene}", "--free", "integrator.dt", "--observe", "sound"],
        ["sound", "force, pose"],
    ),
    (
        ["fit", "{both}", "--scene", "{scene}", "--free", "object.cube.surface.mu", "--observe", "pose"],
        ["pose"],
    ),
    (
        ["fit", "{both}", "--scene", "{scene}", "--free", "object.cube.surface.mu", "--starts", "0"],
        ["starts", "1 to"],
    ),
    (
        ["fit", "{both}", "--scene", "{scene}", "--free", "object.cube.surface.mu", "--starts", "few"],
        ["--starts", "few"],
    ),
    (
        ["fit", "{both}", "--scene", "{scene}", "--free", "object.cube.surface.mu", "--spread", "0.5"],
        ["spread", "0.5"],
    ),
    (
        [
            "fit",
            "{both}",
            "--scene",
            "{scene}",
            "--free",
            "object.cube.surface.mu",
            "--json",
            "{folder}/no/f.json",
        ],
        ["no"],
    ),
    (["fit", "{force}", "--scene", "{scene}", "--free", "object.cube.surface.mu"], ["force.npz", "hip"]),
    (
        ["fit", "{both}", "{both}", "--scene", "{scene}", "--free", "torsion.critical_area"],
        ["both.npz", "twice"],
    ),
    *(
        (["fit", file, "--scene", "{scene}", "--free", "torsion.critical_area"], [said])
        for file, said in (("{folder}/loop.npz", "cannot be read"), ("{folder}/a\0b.npz", "null"))
    ),
    *(
        (
            ["fit", "{both}", "--scene", "{scene}", "--free", "torsion.critical_area", "--json", file],
            [file, "another file of this command"],
        )
        for file in ("{both}", "{scene}")
    ),
    (["simulate", "{scene}", "--hip", "{hip}", "--out", "{hip}"], ["hip.npz", "another file"]),
    (["benchmark", "latency", "--scene", "{scene}", "--json", "{scene}"], ["scene.toml", "another file"]),
    (["run", "{scene}", "--record", "{folder}/r.mcap", "--json", "{folder}/r.mcap"], ["r.mcap", "another"]),
    (["export", "{scene}", "--to", "mjcf", "--out", "{scene}"], ["scene.toml", "another file"]),
    (
        ["export", "{scene}", "--to", "mjcf", "--out", "{folder}/m.xml", "--json", "{folder}/m.xml"],
        ["m.xml", "another file"],
    ),
    (["import", "{scene}", "--out", "{scene}"], ["scene.toml", "another file"]),
    (["recover", "{hip}", "--out", "{folder}/w.mcap", "--json", "{hip}"], ["hip.npz", "another file"]),
    (["recover", "."], [": .: cannot be read"]),
    (["export", ".", "--to", "urdf"], [": .: cannot be read"]),
    (["benchmark"], ["missing"]),
    (["benchmark", "speed"], ["speed", "latency"]),
    (["benchmark", "latency", "--fingers", "0"], ["fingers", "1 to 100"]),
    (["benchmark", "latency", "--fingers", "2"], ["fingers is 2 without a scene"]),
    (["benchmark", "latency", "--fingers", "two"], ["--fingers", "two"]),
    (["benchmark", "latency", "--seconds", "0"], ["seconds", "above 0"]),
    (["benchmark", "latency", "--scene", "{folder}/none.toml"], ["none.toml"]),
    (["benchmark", "latency", "--json", "{folder}/no/f.json"], ["no"]),
    (["simulate", "{scene}", "--hip", "{damaged}", "--out", "{folder}/o.npz"], ["damaged.npz", "whole NPZ"]),
    (["simulate", "{scene}", "--hip", "{hip}", "--out", "{folder}"], ["{folder}"]),
    (["simulate", "{folder}/a\nb.toml", "--hip", "{hip}", "--out", "{folder}/o.npz"], ["a b.toml"]),
    (["simulate", "{folder}/a\0b.toml", "--hip", "{hip}", "--out", "{folder}/o.npz"], ["no name of a file"]),
    (["simulate", "{scene}", "--hip", "{folder}/a\0b.npz", "--out", "{folder}/o.npz"], ["null"]),
    (["simulate", "{scene}", "--hip", "{hip}", "--out", "{folder}/a\0b.npz"], ["null"]),
    (
        ["fit", "{both}", "--scene", "{scene}", "--free", "torsion.critical_area", "--json", "{folder}"],
        ["regular file"],
    ),
    (
        ["fit", "{both}", "--scene", "{scene}", "--free", "torsion.critical_area", "--report", "{hip}"],
        ["hip.npz", "folder"],
    ),
    (
        ["fit", "{both}", "--scene", "{scene}", "--free", "torsion.critical_area", "--json", "/dev/null"],
        ["regular file"],
    ),
    (
        ["export", "{scene}", "--to", "urdf", "--object", "cube", "--out", "{folder}/q.urdf"]
        + ["--json", "/dev/stdout"],
        ["/dev/stdout", "--json - "],
    ),
    (
        ["fit", "{both}", "--scene", "{scene}", "--free", "object.cube.surface.mu", "--prior"]
        + ["object.cube.surface.mu", "0.5", "0.1", "object.cube.surface.mu", "0.6", "0.1"],
        ["--prior", "object.cube.surface.mu", "twice"],
    ),
    (
        ["fit", "{both}", "--scene", "{scene}", "--free", "object.cube.surface.mu", "--bounds"]
        + ["object.cube.surface.mu", "0", "1", "object.cube.surface.mu", "0", "2"],
        ["--bounds", "object.cube.surface.mu", "twice"],
    ),
    (
        ["fit", "{both}", "--scene", "{scene}", "--free", "object.cube.surface.mu"]
        + ["--free=object.cube.body.mass"],
        ["--free", "2 times", "once"],
    ),
    (["--tyro-print-completion", "foo"], ["foo", "bash"]),
    (["demo", "--seed", "-1"], ["--seed", "-1"]),
    (["demo", "--seed", "one"], ["--seed", "one"]),
    (["demo", "--out", "{scene}"], ["scene.toml"]),
    (["demo", "--out", "{scene}/under"], ["under"]),
]


@pytest.fixture(scope="module")
def places(tmp_path_factory):
    folder = tmp_path_factory.mktemp("refusals")
    (folder / "scene.toml").write_text(SCENE)
    t, hip = np.arange(5) * 1e-3, np.full((5, 1, 3), 1.0)
    np.savez(folder / "hip.npz", hip=hip, hip_t=t)
    np.savez(folder / "force.npz", force=hip, force_t=t)
    np.savez(folder / "both.npz", hip=hip, hip_t=t, force=hip, force_t=t)
    np.savez(folder / "single.npz", hip=hip[:1], hip_t=t[:1])
    np.savez(folder / "long.npz", hip=hip, hip_t=t * 1e9)
    damaged = bytearray((folder / "hip.npz").read_bytes())
    damaged[damaged.index(b"PK\1\2") + 6] = 99  # the version of ZIP that the directory asks for
    (folder / "damaged.npz").write_bytes(damaged)
    (folder / "loop.npz").symlink_to("loop.npz")
    names = ("hip", "force", "both", "single", "long", "damaged")
    return {"folder": str(folder), "scene": str(folder / "scene.toml")} | {
        n: str(folder / f"{n}.npz") for n in names
    }


def refused(capsys, arguments, words):
    assert main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("hapjax: ") and err.count("\n") == 1 and err.endswith("\n")
    for word in words:
        assert word in err
    return err


@pytest.mark.parametrize(("old", "new", "words"), SCENES, ids=[f"{new[:40]!r}" for _, new, _ in SCENES])
def test_a_malformed_scene_is_refused(old, new, words, tmp_path, capsys):
    assert old in SCENE
    file = tmp_path / "bad.toml"
    file.write_text(SCENE.replace(old, new, 1))
    error = refused(capsys, ["simulate", str(file), "--hip", "hip.npz", "--out", "out.npz"], words)
    assert "bad.toml" in error


def test_a_file_does_not_steer_the_terminal(tmp_path, places, capsys):
    (tmp_path / "a.mcap").write_bytes(json_file({}, topic="/\x1b]0;title\x07"))
    arguments = ["simulate", places["scene"], "--hip", str(tmp_path / "a.mcap"), "--out", "o.npz"]
    assert refused(capsys, arguments, ["/?]0;title? (hapjax.hip)"]).strip().isprintable()


@pytest.mark.parametrize(("arguments", "words"), ARGUMENTS, ids=[" ".join(a)[:60] for a, _ in ARGUMENTS])
def test_malformed_arguments_are_refused(arguments, words, places, capsys):
    before = sorted(path for path in Path(places["folder"]).rglob("*"))
    refused(capsys, [a.format(**places) for a in arguments], [w.format(**places) for w in words])
    assert sorted(path for path in Path(places["folder"]).rglob("*")) == before


def test_the_scene_itself_is_accepted(places, tmp_path, capsys):
    out = tmp_path / "out.npz"
    assert main(["simulate", places["scene"], "--hip", places["hip"], "--out", str(out)]) == 0
    assert capsys.readouterr().err == ""
    assert out.exists()
