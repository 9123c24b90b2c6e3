"""The dry friction example: on a real damper, on one of known numbers, on malformed files."""

import json
from pathlib import Path

import dry_friction
import numpy as np
import pytest


def damper(tmp_path, name="damper.npz", **changes):
    """A file of four tests of a rigid Coulomb damper of 12 kN in the one direction and 16 kN in the other."""
    arrays = {}
    for i, (stroke, period) in enumerate([(0.02, 2.0), (0.04, 4.0), (0.03, 1.0), (0.02, 8.0)]):
        t = np.arange(1801) * period / 256
        phase = 2 * np.pi * t / period
        place, speed = stroke * np.sin(phase), stroke * 2 * np.pi / period * np.cos(phase)
        # a spring of 5 kN/mm against a limit of 14 kN, which a force of -2 kN shifts, one sample at a time
        god, force = 0.0, np.zeros_like(t)
        for k, x in enumerate(place):
            god = np.clip(god, x - 2.8e-3, x + 2.8e-3)
            force[k] = 5e6 * (x - god) - 2e3
        arrays[f"test{i}"] = np.stack([t, force, place, speed], axis=-1)
    np.savez(tmp_path / name, **arrays | changes)
    return tmp_path / name


@pytest.mark.slow
def test_finds_the_numbers_of_a_damper_that_is_known(tmp_path):
    tests = dry_friction.read(damper(tmp_path))
    found, forces = dry_friction.judge(dry_friction.MODELS["Coulomb"], tests)
    assert found.numbers["force"] == pytest.approx(14e3, rel=1e-3)
    assert found.numbers["stiffness"] == pytest.approx(5e6, rel=1e-3)
    assert found.numbers["bias"] == pytest.approx(-2.0, rel=1e-3)
    assert list(found.train) == ["test0", "test2"] and list(found.test) == ["test1", "test3"]
    assert max(*found.train.values(), *found.test.values()) < 1e-3
    assert [len(f) for f in forces] == [1801] * 4


@pytest.mark.slow
@pytest.mark.needs_data
def test_lugre_predicts_a_real_damper_better_than_coulomb_and_backlash_better_still(
    data_dir, tmp_path, capsys
):
    data = data_dir / "dry_friction.npz"
    if not data.is_file():
        pytest.skip(f"the recordings of the damper are absent: no file {data}")
    paths = {name: tmp_path / name for name in ("plot.png", "found.json")}
    line = ["--data", str(data), "--plot", str(paths["plot.png"]), "--json", str(paths["found.json"])]
    assert dry_friction.main(line) == 0
    found = {n: dry_friction.Found(**f) for n, f in json.loads(paths["found.json"].read_text()).items()}
    assert list(found) == list(dry_friction.MODELS)
    error = {name: f.mean("test") for name, f in found.items()}
    assert len(found["LuGre"].train) == 7 and len(found["LuGre"].test) == 6
    assert error["LuGre"] < 0.95 * error["Coulomb"] and error["Dahl"] < error["Coulomb"]
    assert (
        error["Stribeck behind backlash"] < 0.95 * error["Coulomb behind backlash"] < 0.7 * error["Coulomb"]
    )
    assert paths["plot.png"].read_bytes().startswith(b"\x89PNG")
    printed = capsys.readouterr().out
    assert all(name in printed and f"{error[name]:.3f}" in printed for name in found)
    page = (Path(dry_friction.__file__).parents[1] / "docs" / "friction.md").read_text()
    for name, f in found.items():  # as the documentation tells
        row = next(line for line in page.splitlines() if line.startswith(f"| {name} | {len(f.numbers)} |"))
        assert [float(x) for x in row.split("|")[3:5]] == pytest.approx(
            [f.mean("train"), f.mean("test")], abs=5e-3
        )


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"test1": np.ones((900, 3))}, "test1: shape (900, 3); expected (samples, 4)"),
        ({"test1": np.ones((900, 4), int)}, "test1: expected real numbers"),
        ({"test1": np.ones((400, 4))}, "test1: expected more than 448 finite samples"),
        ({"test1": np.full((900, 4), np.nan)}, "test1: expected more than 448 finite samples"),
        ({"test1": np.ones((900, 4))}, "test1: expected times that rise by equal steps"),
        ({"test1": np.array(["a"], object)}, "expected a whole NPZ file"),
    ],
)
def test_a_malformed_file_gets_one_sentence(change, says, tmp_path, capsys):
    path = damper(tmp_path, **change)
    assert dry_friction.main(["--data", str(path), "--json", str(tmp_path / "f.json")]) == 2
    told = capsys.readouterr()
    assert (
        told.out == "" and told.err.count("\n") == 1 and says in told.err and told.err.startswith(str(path))
    )
    assert not (tmp_path / "f.json").exists()


def test_an_absent_or_lonely_file_gets_one_sentence(tmp_path, capsys):
    assert dry_friction.main(["--data", str(tmp_path / "absent.npz")]) == 2
    assert (
        capsys.readouterr().err == f"{tmp_path / 'absent.npz'}: cannot be read: No such file or directory\n"
    )
    with np.load(damper(tmp_path)) as whole:
        np.savez(tmp_path / "one.npz", test0=whole["test0"])
    assert dry_friction.main(["--data", str(tmp_path / "one.npz")]) == 2
    assert "1 tests; expected at least 2" in capsys.readouterr().err
