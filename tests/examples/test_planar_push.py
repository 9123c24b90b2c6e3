"""The planar push example: on real pushes, on those of an independent simulator, on malformed files."""

import json
import subprocess
import sys
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import planar_push
import pushes
import pytest

import hapjax
from hapjax_fitting.dragged import Dragged, unbalanced

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"

PULL_TEST = 0.282
FEET = np.array([[-0.04, -0.04], [0.08, -0.04], [-0.04, 0.08]])
LOADS = np.array([4.0, 4.5, 6.5])


def turned(angle, v):
    """Vectors of the plane as complex numbers turn by multiplication."""
    z = (v[..., 0] + 1j * v[..., 1]) * np.exp(1j * angle)
    return np.stack([z.real, z.imag], -1)


def foot_forces(arms, travel, spin, mu):
    """Rigid Coulomb friction (P, V, 2) on feet whose body's centre moves by `travel` and turns by `spin`."""
    moved = travel[:, None] + spin[:, None, None] * np.stack([-arms[..., 1], arms[..., 0]], -1)
    size = np.linalg.norm(moved, axis=-1, keepdims=True)
    return -mu * LOADS[:, None] * moved / np.maximum(size, 1e-300)


def quasi_static(tool, heading, angle, mu, steps=100, length=0.02):
    """Push P bodies at rest at the origin by a point that sticks to them: tip, force, first and last pose.

    At each step the body turns just so that friction has no moment about the tip, where alone it is pushed.
    The moment falls as the spin grows (friction opposes it), so bisection finds it. That is all of Coulomb's
    law for rigid feet, without a stiffness and without hapjax.
    """
    step = length / steps * np.stack([np.cos(heading), np.sin(heading)], -1)
    centre, angle = np.zeros_like(step), angle.copy()
    tips, forces, poses = [], [], [np.column_stack([centre, angle])]
    for _ in range(steps):
        arms, lever = turned(angle[:, None], np.broadcast_to(FEET, (len(tool), 3, 2))), turned(angle, tool)
        low, high = np.full(len(tool), -1.0), np.full(len(tool), 1.0)
        for _ in range(60):
            spin = (low + high) / 2
            travel = step - spin[:, None] * np.stack([-lever[:, 1], lever[:, 0]], -1)
            friction = foot_forces(arms, travel, spin, mu)
            about_tip = arms - lever[:, None]
            moment = (about_tip[..., 0] * friction[..., 1] - about_tip[..., 1] * friction[..., 0]).sum(1)
            low, high = np.where(moment > 0, spin, low), np.where(moment > 0, high, spin)
        tips.append(centre + lever)
        forces.append(-friction.sum(1))
        centre, angle = centre + travel, angle + spin
        poses.append(np.column_stack([centre, angle]))
    return np.stack(tips, 1), np.stack(forces, 1), poses[0], poses[-1]


def recorded(mu, seed, count=12, noise=0.3):
    """What a file would hold of such pushes: an approach, rounded tips, noisy forces and poses."""
    rng = np.random.default_rng(seed)
    pose_noise = noise * np.array([3e-4, 3e-4, 3e-3])
    side = rng.uniform(0, 2 * np.pi, count)
    tool = 0.07 * np.stack([np.cos(side), np.sin(side)], -1)
    angle = rng.uniform(-np.pi, np.pi, count)
    heading = side + angle + np.pi + rng.uniform(-1, 1, count)
    tip, force, before, after = quasi_static(tool, heading, angle, mu)
    step = tip[:, 1:2] - tip[:, :1]
    tip = np.concatenate([tip[:, :1] - step * np.arange(20, 0, -1)[:, None], tip], 1)
    force = np.concatenate([np.zeros((count, 20, 2)), force], 1)
    force = force + noise * rng.standard_normal(force.shape)
    poses = [p + rng.standard_normal(p.shape) * pose_noise for p in (before, after)]
    return {
        "t": np.tile(np.arange(120) * 0.05, count),
        "tip": tip.reshape(-1, 2).round(4),
        "force": force.reshape(-1, 2),
        "offset": np.arange(count + 1) * 120,
        "com_before": poses[0],
        "com_after": poses[1],
        "support_points": FEET,
        "support_load": LOADS,
    }


def save(folder, arrays, name="pushes.npz"):
    np.savez(folder / name, **arrays)
    return folder / name


def without(arrays, push):
    """The arrays with one push whose tool never met the object."""
    rows = slice(*arrays["offset"][push : push + 2])
    force = arrays["force"].copy()
    force[rows] = 0.01
    return arrays | {"force": force}


@pytest.mark.slow
def test_finds_the_mu_that_an_independent_simulator_pushed_with(tmp_path):
    inside = []
    for seed in range(20):
        mu = 0.1 + 0.03 * seed
        loaded, skipped = pushes.load(save(tmp_path, recorded(mu, seed)))
        found = planar_push.fit((loaded,), "synthetic")
        assert not skipped and found.starts_at_best == found.starts
        assert found.estimate == pytest.approx(mu, rel=0.08)
        inside.append(found.interval95[0] < mu < found.interval95[1])
    # Of 20 intervals of 95 %, fewer than 17 hold the truth once in 60 times.
    assert sum(inside) >= 17


def test_at_the_true_mu_friction_balances_the_push(tmp_path):
    loaded, _ = pushes.load(save(tmp_path, recorded(0.3, seed=7, count=3, noise=0)))
    board = Dragged(hapjax.Surface(1e5, mu=0.3), jnp.ones(()))
    left = unbalanced(board, loaded)
    pushed, remains = (np.sqrt(np.mean(x[:, 5:] ** 2, axis=(0, 1))) for x in (loaded.wrench, left))
    assert np.all(pushed > 1)  # N: off the centre, so that the moment too has something to balance
    assert np.all(remains < 0.1 * pushed)  # what is left is that the true turn is not quite in proportion


@pytest.mark.slow
@pytest.mark.needs_data
def test_real_pushes_agree_with_the_pull_test(data_dir, tmp_path, capsys):
    files = sorted((data_dir / "planar_push").glob("*.npz"))
    if not files:
        pytest.skip(f"the recorded pushes are absent: no file in {data_dir / 'planar_push'}")
    assert planar_push.main([*map(str, files), "--json", str(tmp_path / "mu.json")]) == 0
    figures = json.loads((tmp_path / "mu.json").read_text())
    assert list(figures["files"]) == [file.name for file in files]
    for figure in figures["files"].values():
        assert figure["estimate"] == pytest.approx(PULL_TEST, rel=0.12)
        assert figure["starts_at_best"] == figure["starts"]
    together = figures["all"]
    assert together["estimate"] == pytest.approx(PULL_TEST, rel=0.08)
    assert together["pushes"] == 179
    assert together["interval95"][0] < PULL_TEST < together["interval95"][1]
    assert f"{together['estimate']:.4f}" in capsys.readouterr().out


@pytest.mark.slow
def test_finds_how_far_out_the_feet_of_the_independent_simulator_stand(tmp_path):
    arm = LOADS @ np.linalg.norm(FEET, axis=1) / LOADS.sum()
    misplaced = recorded(0.3, seed=3) | {"support_points": 0.5 * FEET}
    for given in (recorded(0.3, seed=3), misplaced):
        loaded, _ = pushes.load(save(tmp_path, given))
        found = planar_push.fit((loaded,), "synthetic", with_arm=True)
        assert found.starts_at_best == found.starts
        assert found.estimate == pytest.approx(0.3, rel=0.08)
        assert found.arm is not None
        assert found.arm.estimate == pytest.approx(arm, rel=0.08)
        assert found.arm.interval95[0] < found.arm.estimate < found.arm.interval95[1]


def thinned(file, to, every=3):
    """A file with every third of the pushes."""
    with np.load(file) as archive:
        arrays = dict(archive)
    offset = arrays["offset"]
    kept = range(0, len(offset) - 1, every)
    rows = np.concatenate([np.arange(offset[i], offset[i + 1]) for i in kept])
    arrays |= {name: arrays[name][rows] for name in ("t", "tip", "force")}
    arrays |= {name: arrays[name][::every] for name in ("com_before", "com_after")}
    arrays["offset"] = np.concatenate([[0], np.cumsum(np.diff(offset)[::every])])
    np.savez(to, **arrays)
    return to


@pytest.mark.slow
@pytest.mark.needs_data
@pytest.mark.parametrize(
    ("layout", "arm"), [("10_130_10_10_10_130", 78.5e-3), ("10_90_10_10_30_130", 58.9e-3)]
)
def test_real_pushes_tell_the_torsional_arm_together_with_mu(layout, arm, data_dir, tmp_path, capsys):
    file = data_dir / "planar_push" / f"hardboard__{layout}.npz"
    if not file.exists():
        pytest.skip(f"the recorded pushes are absent: no file {file}")
    file = thinned(file, tmp_path / "some.npz")
    assert planar_push.main([str(file), "--arm", "--json", str(tmp_path / "mu.json")]) == 0
    figures = json.loads((tmp_path / "mu.json").read_text())["all"]
    assert figures["arm"]["estimate"] == pytest.approx(arm, rel=0.15)
    assert figures["estimate"] == pytest.approx(PULL_TEST, rel=0.12)
    assert f"{1e3 * figures['arm']['estimate']:.1f}" in capsys.readouterr().out


@pytest.mark.slow
def test_a_push_without_contact_is_left_out_and_said(tmp_path, capsys):
    path = save(tmp_path, without(recorded(0.3, seed=100, count=4), push=2))
    assert planar_push.main([str(path), "--json", str(tmp_path / "mu.json")]) == 0
    told = capsys.readouterr()
    assert told.err == f"{path}: push 2 is left out: no contact, its largest force is 0.014 N\n"
    figures = json.loads((tmp_path / "mu.json").read_text())
    assert figures["files"] == {"pushes.npz": figures["all"]}
    assert figures["all"]["pushes"] == 3
    low, high = figures["all"]["interval95"]
    assert low < figures["all"]["estimate"] < high and low < 0.3 < high
    assert f"{low:.4f} to {high:.4f}" in told.out


def test_forces_that_help_friction_determine_no_mu(tmp_path):
    arrays = recorded(0.3, seed=100, count=3)
    loaded, _ = pushes.load(save(tmp_path, arrays | {"force": -arrays["force"]}))
    with pytest.raises(hapjax.InputError, match="reversed: .* do not"):
        planar_push.fit((loaded,), "reversed")


@pytest.mark.slow
def test_runs_as_a_program(tmp_path):
    path = save(tmp_path, recorded(0.3, seed=100, count=3))
    command = [
        sys.executable,
        str(EXAMPLES / "planar_push.py"),
        str(path),
        "--json",
        str(tmp_path / "mu.json"),
    ]
    ran = subprocess.run(command, capture_output=True, text=True)
    assert (ran.returncode, ran.stderr) == (0, "") and "pushes.npz" in ran.stdout
    low, high = json.loads((tmp_path / "mu.json").read_text())["all"]["interval95"]
    assert low < 0.3 < high


def at(name, index, value):
    """A change: one number of one array."""

    def change(arrays):
        array = arrays[name].copy()
        array[index] = value
        return arrays | {name: array}

    return change


MALFORMED = {
    "array missing": (lambda a: {k: v for k, v in a.items() if k != "tip"}, "array 'tip' is missing"),
    "text": (lambda a: a | {"t": a["t"].astype(str)}, "t: expected finite real numbers"),
    "complex": (lambda a: a | {"force": a["force"] * 1j}, "force: expected finite real numbers"),
    "pickled": (lambda a: a | {"t": a["t"].astype(object)}, "expected a whole NPZ file"),
    "fractions of rows": (lambda a: a | {"offset": a["offset"] * 1.0}, "offset: expected whole numbers"),
    "NaN force": (at("force", (7, 1), np.nan), "force: expected finite"),
    "infinite tip": (at("tip", (7, 1), np.inf), "tip: expected finite"),
    "NaN pose": (at("com_after", (1, 2), np.nan), "com_after: expected finite"),
    "force in space": (
        lambda a: a | {"force": np.ones((360, 3))},
        "force: shape (360, 3); expected (360, 2)",
    ),
    "short tip": (lambda a: a | {"tip": a["tip"][1:]}, "tip: shape (359, 2); expected (360, 2)"),
    "no samples": (lambda a: a | {"t": a["t"][:0]}, "t: shape (0,); expected"),
    "times in a matrix": (lambda a: a | {"t": a["tip"]}, "t: shape (360, 2); expected"),
    "a pose too few": (
        lambda a: a | {"com_before": a["com_before"][1:]},
        "com_before: shape (2, 3); expected (3, 3)",
    ),
    "a load too many": (
        lambda a: a | {"support_load": np.ones(4)},
        "support_load: shape (4,); expected (3,)",
    ),
    "one offset": (lambda a: a | {"offset": a["offset"][:1]}, "offset: shape (1,); expected"),
    "offset beyond the end": (at("offset", 3, 361), "offset: expected numbers that rise from 0 to 360"),
    "offset short of the end": (at("offset", 3, 350), "offset: expected numbers that rise from 0 to 360"),
    "offset from 1": (at("offset", 0, 1), "offset: expected numbers that rise"),
    "offset backwards": (at("offset", 1, 250), "offset: expected numbers that rise"),
    "time backwards": (at("t", 50, 0.0), "t: expected times that rise"),
    "a foot without load": (at("support_load", 1, 0.0), "support_load: 0; allowed: above 0 N"),
    "feet in one point": (lambda a: a | {"support_points": 0 * FEET}, "all at the centre of mass"),
    "one push with contact": (lambda a: without(without(a, 0), 1), "1 of 3 pushes can be used"),
    "a tool that stands": (lambda a: a | {"tip": 0 * a["tip"]}, "0 of 3 pushes can be used"),
    "contact too short": (
        lambda a: a | {"force": a["force"] * (a["t"] > 4)[:, None]},
        "0 of 3 pushes can be used",
    ),
}


@pytest.fixture(scope="module")
def three_pushes():
    return recorded(0.3, seed=100, count=3)


@pytest.mark.parametrize("case", MALFORMED)
def test_a_malformed_file_gets_one_sentence(case, three_pushes, tmp_path, capsys):
    change, sentence = MALFORMED[case]
    path = save(tmp_path, change(three_pushes))
    assert planar_push.main([str(path), "--json", str(tmp_path / "mu.json")]) == 2
    told = capsys.readouterr()
    assert told.out == ""
    assert told.err.startswith(str(path)) and told.err.count("\n") == 1 and sentence in told.err
    assert not (tmp_path / "mu.json").exists()


def test_what_is_no_file_gets_one_sentence(three_pushes, tmp_path, capsys):
    good, text, cut = save(tmp_path, three_pushes), tmp_path / "text.npz", tmp_path / "cut.npz"
    text.write_text("mu = 0.3\n")
    cut.write_bytes(good.read_bytes()[:2000])
    np.save(tmp_path / "one.npy", np.ones(3))
    for given, sentence in [
        ([tmp_path / "absent.npz"], "absent.npz: cannot be read: No such file"),
        ([tmp_path], "cannot be read: Is a directory"),
        ([text], "text.npz: expected a whole NPZ file"),
        ([cut], "cut.npz: expected a whole NPZ file"),
        ([tmp_path / "one.npy"], "one.npy: expected a whole NPZ file"),
        ([good, good], "given twice"),
        ([good, "--stiffness", "-1"], "--stiffness is -1; allowed: above 0 N/m"),
        ([good, "--stiffness", "nan"], "--stiffness is nan; allowed: above 0 N/m"),
    ]:
        assert planar_push.main([str(x) for x in given]) == 2
        told = capsys.readouterr()
        assert told.out == "" and told.err.count("\n") == 1 and sentence in told.err


@pytest.mark.parametrize(("line", "code", "says"), [([], 2, "FILE"), (["--help"], 0, "N/m")])
def test_the_command_line_explains_itself(line, code, says, capsys):
    with pytest.raises(SystemExit) as ended:
        planar_push.main(line)
    told = capsys.readouterr()
    assert ended.value.code == code and says in told.out + told.err
