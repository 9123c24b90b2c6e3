"""The cube toss example: on real tosses, beside what their impacts say without a contact model, and on malformed files."""

import json

import cube_toss
import numpy as np
import pytest
import tosses
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation


def impulses(throws, before=6, after=3, apart=4e-3):
    """Jumps of velocity and spin (N, 3) at first impacts of a single corner, with the turn then and the corner's signs.

    Free flight on both sides is uniform but for gravity: its means give the jump, whatever the contact is like.
    """
    found = []
    for toss in throws:
        k, dt = toss.first_impact(), 1 / toss.rate
        turns = Rotation.from_quat(toss.orientation, scalar_first=True)
        if k < before + 2 or k + 6 >= len(turns):
            continue
        heights = toss.position[:, 2:] + np.stack(
            [turns.apply(s)[:, 2] for s in toss.side / 2 * SIGNS], axis=1
        )
        if np.sort(heights[k - 1 : k + 6], axis=1)[:, 1].min() < apart:
            continue
        near = slice(k - 8, k + 6)
        falling = np.outer((np.arange(14) * dt) ** 2, [0, 0, cube_toss.GRAVITY / 2])
        velocity = np.diff(toss.position[near] + falling, axis=0) / dt
        spin = (turns[k - 7 : k + 6] * turns[k - 8 : k + 5].inv()).as_rotvec() / dt
        if np.ptp(spin[-after:], axis=0).max() > 0.2 or np.ptp(velocity[-after:], axis=0).max() > 0.04:
            continue  # it touches again
        jump = velocity[-after:].mean(axis=0) - velocity[:before].mean(axis=0)
        share = (velocity - velocity[:before].mean(axis=0)) @ jump / (jump @ jump)
        late = np.sum(1 - share[7:11]) - 1  # samples after k, at which the impulse is
        turn = Rotation.from_rotvec(spin[:before].mean(axis=0) * late * dt) * turns[k]
        corner = SIGNS[np.argmin(turn.apply(SIGNS)[:, 2])]
        found.append(
            (turn.as_matrix(), corner, jump, spin[-after:].mean(axis=0) - spin[:before].mean(axis=0))
        )
    return [np.array(x) for x in zip(*found, strict=True)]


SIGNS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float)


def balanced(throws):
    """Inertia (kg m^2), rounding of the edges (m) and centre of mass (m) with which the impulses' moments about the centre
    turn the cube as it was turned: inertia times jump of spin = arm x mass times jump of the centre's velocity."""
    matrix, corner, jump, turned = impulses(throws)
    half, mass = throws[0].side / 2, throws[0].mass

    def off(x):
        inertia, rounding, centre = 1e-3 * x[0], 1e-3 * x[1], 1e-3 * x[2:]
        arm = np.einsum("nij,nj->ni", matrix, corner * (half - rounding) - centre)
        arm[:, 2] -= rounding
        moved = jump + np.cross(turned, np.einsum("nij,j->ni", matrix, centre))
        return (np.cross(arm, mass * moved) / inertia - turned).ravel()

    found = least_squares(off, [1.0, 0.0, 0.0, 0.0, 0.0], loss="soft_l1", f_scale=0.3)
    return 1e-3 * found.x


@pytest.mark.slow
@pytest.mark.needs_data
def test_a_real_cube(data_dir, tmp_path, capsys):
    data = data_dir / "cube_toss.npz"
    if not data.is_file():
        pytest.skip(f"the recorded tosses are absent: no file {data}")
    paths = {name: tmp_path / name for name in ("plot.png", "found.json")}
    line = [str(data), "--tosses", "4", "--plot", str(paths["plot.png"]), "--json", str(paths["found.json"])]
    assert cube_toss.main(line) == 0
    figures = json.loads(paths["found.json"].read_text())
    found = {name: p["estimate"] for name, p in figures["parameters"].items()}
    assert 0.12 < found["contact.floor.mu"] < 0.25
    inertia, _, *centre = balanced(tosses.read(data))
    fitted = np.mean([found[f"object.cube.body.inertia[{i}]"] for i in range(3)])
    assert fitted == pytest.approx(inertia, rel=0.15)
    for i, place in enumerate(centre):
        assert found[f"object.cube.body.centre[{i}]"] == pytest.approx(place, abs=2e-3)
    ahead = figures["errors_ahead"]
    assert all(ours < theirs for ours, theirs in zip(ahead["fitted"], ahead["published"], strict=True))
    assert paths["plot.png"].read_bytes().startswith(b"\x89PNG")
    assert f"{found['contact.floor.mu']:.3g}" in capsys.readouterr().out


def test_the_loss_of_an_impact_is_its_restitution():
    """A mass that meets the contact's spring at 1.1 m/s leaves it at 0.3 times that: by small steps."""
    damping, stiffness, mass, dt = cube_toss.damping_of(0.3, 1.1), 1e4, 0.1, 1e-6
    depth, speed = 0.0, 1.1
    while depth >= 0:
        speed -= dt * stiffness * depth * max(0.0, 1 + damping * speed) / mass
        depth += dt * speed
    assert -speed / 1.1 == pytest.approx(0.3, abs=1e-3)
    assert cube_toss.restitution_of(damping, 1.1) == pytest.approx(0.3)


def saved(folder, **changes):
    """A file of two tosses of a cube that flies on for ever, level."""
    state = np.zeros((100, 13))
    state[:, 2:4] = [0.5, 1.0]
    arrays = {"state": state, "offset": np.array([0, 50, 100]), "rate": 148.0, "mass": 0.37, "side": 0.1}
    arrays = {name: value for name, value in (arrays | changes).items() if value is not None}
    np.savez(folder / "tosses.npz", **arrays)
    return folder / "tosses.npz"


def test_a_file_is_read_with_spin_in_the_world(tmp_path):
    state = np.zeros((50, 13))
    state[:, 3:7] = [np.sqrt(0.5), 0, np.sqrt(0.5), 0]  # a quarter turn about y: its x points down
    state[:, 10] = 3.0
    (toss,) = tosses.read(saved(tmp_path, state=state, offset=np.array([0, 50])))
    np.testing.assert_allclose(toss.spin, np.tile([0, 0, -3.0], (50, 1)), atol=1e-12)
    np.testing.assert_allclose(toss.lowest(), -0.05)
    assert toss.first_impact() == 0


MALFORMED = {
    "array missing": ({"mass": None}, "array 'mass' is missing"),
    "narrow state": ({"state": np.ones((100, 12))}, "state: shape (100, 12); expected (samples, 13)"),
    "text": ({"state": np.full((100, 13), "a")}, "state: expected finite real numbers of 2 axes"),
    "not a number": ({"state": np.full((100, 13), np.nan)}, "state: expected finite real numbers"),
    "no turns": ({"state": np.zeros((100, 13))}, "state: columns 3 to 6 are no unit quaternions"),
    "pickled": ({"rate": np.array(None)}, "expected a whole NPZ file"),
    "rates": ({"rate": np.ones(2)}, "rate: expected finite real numbers of 0 axes"),
    "no mass": ({"mass": 0.0}, "mass: 0; allowed: above 0"),
    "short toss": ({"offset": np.array([0, 90, 100])}, "rise from 0 to 100 by at least 40"),
    "offset beyond the end": ({"offset": np.array([0, 50, 101])}, "rise from 0 to 100"),
}


@pytest.mark.parametrize("case", MALFORMED)
def test_a_malformed_file_gets_one_sentence(case, tmp_path, capsys):
    changes, sentence = MALFORMED[case]
    path = saved(tmp_path, **changes)
    assert cube_toss.main([str(path), "--json", str(tmp_path / "f.json")]) == 2
    told = capsys.readouterr()
    assert told.out == "" and told.err.startswith(str(path)) and told.err.count("\n") == 1
    assert sentence in told.err and not (tmp_path / "f.json").exists()


def test_other_refusals(tmp_path, capsys):
    for line, sentence in [
        ([str(tmp_path / "absent.npz")], "absent.npz: cannot be read: No such file"),
        ([str(saved(tmp_path)), "--tosses", "2"], "--tosses is 2; allowed: 1 to 1"),
        ([str(saved(tmp_path)), "--tosses", "1"], "no toss touches the floor"),
    ]:
        assert cube_toss.main(line) == 2
        told = capsys.readouterr()
        assert told.out == "" and told.err.count("\n") == 1 and sentence in told.err
