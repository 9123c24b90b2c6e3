"""Each example runs as its page says, prints its claim, and writes its plot."""

import os
import re
import runpy
import subprocess
import sys
from pathlib import Path

import jax
import plotting
import pytest

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
NUMBER = r"(-?[0-9.]+(?:e[-+]?[0-9]+)?)"

# What is printed, and between which numbers.
CLAIMS = {
    "three_finger_lift": [
        (rf"carried at the top: {NUMBER} N", 1.96, 1.964),
        (rf"put down at {NUMBER} mm", 29.8, 30),
    ],
    "self_stabilising_grasp": [(rf"residual force {NUMBER} N", 0, 1e-8), (rf"torque {NUMBER} N m", 0, 1e-8)],
    "gravity_drop": [
        (rf"0.8 A_crit: centre ends +{NUMBER} mm beside", -0.1, 0.1),
        (rf"1.5 A_crit: centre ends +{NUMBER} mm beside", 19.9, 20.1),
    ],
    "gimbal": [
        (rf"A = 2 A_crit: largest difference to the gimbals {NUMBER}", 0, 1e-4),
        (rf"A = 0.5 A_crit: largest difference to the gimbals {NUMBER}", 1, 4),
    ],
    "soft_finger": [
        (rf"1.3 of it: turned by +{NUMBER} deg", -5, 0),
        (rf"0.3 of it: turned by +{NUMBER} deg", -120, -60),
    ],
    "pole_balance": [
        (rf"balanced: .*centre is at {NUMBER} m", 0.249, 0.251),
        (rf"at rest: .*is at {NUMBER} m", -1e3, 0),
    ],
    "handle_lift": [
        (rf"centre {NUMBER} mm beside", 0, 0.1),
        (rf"swing in the last second: {NUMBER}", 0, 0.2),
    ],
    "rod_swing": [
        (rf"let go: swept {NUMBER} deg", 175, 181),
        (rf"pivot form: .* at most {NUMBER} mm off", 0, 0.4),
    ],
    "lifted_stack": [
        (rf"pull at the end: {NUMBER} N", 1.468, 1.475),
        (rf"cube1 on cube0: {NUMBER}", 1.99, 2.01),
    ],
    "friction_cone": [(rf"at most {NUMBER}, with", 0.59, 0.6), (rf"{NUMBER} slips", 3, 1e3)],
    "dead_band": [
        (rf"50 Hz: in the last half turns by {NUMBER}", 10, 181),
        (rf"T_crit = 1 mN m: in the last half turns by {NUMBER}", 0, 0),
    ],
    "cube_corner_to_face": [(rf"ends {NUMBER} deg", 0, 1e-2), (rf"touches with {NUMBER} corners", 4, 4)],
    "bouncing_cube": [
        (rf"level: energy never rises by more than {NUMBER}", 0, 1e-9),
        (rf"corner first: energy never rises by more than {NUMBER}", 0, 1e-9),
    ],
}


def test_every_example_with_a_plot_is_tested():
    assert set(CLAIMS) == {
        path.stem for path in EXAMPLES.glob("*.py") if "from plotting import" in path.read_text()
    }


@pytest.mark.parametrize(
    ("folder", "writable", "says"),
    [
        ("file/plots", True, "file/plots cannot be made (Not a directory); allowed: a folder for the plot"),
        ("file", True, "file cannot be made (File exists); allowed: a folder for the plot"),
        ("plots", False, "plots cannot be written to; allowed: a folder for the plot"),
    ],
)
def test_a_folder_that_cannot_be_is_refused_in_one_sentence(
    folder, writable, says, tmp_path, monkeypatch, capsys
):
    (tmp_path / "file").write_text("here before")
    monkeypatch.setattr(sys, "argv", ["gimbal.py", "--out", str(tmp_path / folder)])
    if not writable:
        monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(SystemExit) as ended:
        plotting.begin("An example.")
    answer = capsys.readouterr()
    assert ended.value.code == 2 and answer.out == ""
    assert answer.err.splitlines()[-1] == f"gimbal.py: error: --out {tmp_path}/{says}"
    assert "Traceback" not in answer.err and (tmp_path / "file").read_text() == "here before"


@pytest.mark.slow
@pytest.mark.parametrize("name", CLAIMS)
def test_an_example_shows_its_claim(name, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "argv", [f"{name}.py", "--out", str(tmp_path / "plots")])
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):  # as a user has them
        runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    said = capsys.readouterr()
    assert said.err == ""
    assert [path.name for path in (tmp_path / "plots").iterdir()] == [f"{name}.png"]
    assert (tmp_path / "plots" / f"{name}.png").read_bytes().startswith(b"\x89PNG")
    assert 2 <= said.out.count("\n") <= 5
    for pattern, low, high in CLAIMS[name]:
        found = re.search(pattern, said.out)
        assert found, (pattern, said.out)
        assert low <= float(found[1]) <= high, (pattern, found[0])


@pytest.mark.slow
def test_an_example_is_a_program_of_its_own(tmp_path):
    command = [sys.executable, str(EXAMPLES / "friction_cone.py"), "--out", str(tmp_path)]
    quiet = os.environ | {"TF_CPP_MIN_LOG_LEVEL": "3"}  # of a busy machine XLA says that compiling takes long
    ended = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path, env=quiet)
    assert ended.returncode == 0 and ended.stderr == "" and "slips" in ended.stdout
    assert [path.name for path in tmp_path.iterdir()] == ["friction_cone.png"]
