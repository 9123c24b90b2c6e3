"""Clocks that are shifted, or run fast or slow: by how much is told, and a true one is not blamed."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from fitting_cases import floor, forces, held_cube
from fitting_lies import found, four_fingers, late, lifted, on_floor
from hapjax import Recording, cast
from hapjax_fitting.benchmark import speed
from hapjax_fitting.findings import lies


@pytest.mark.parametrize("lag", [0.0, 0.005, 0.02, -0.02, 0.3])
def test_noisy_poses_hide_no_shift_and_make_none(lag):
    """The shifts that are told are right to 5 ms, and less is not told."""
    scene, recording = four_fingers()
    kinds, said = found(late(recording, lag), scene)
    assert kinds == ({("shifted clock", "force")} if abs(lag) > 0.01 else set()), said
    if kinds:
        assert told_lag(said) == pytest.approx(lag, abs=5e-3)


def told_lag(said: str) -> float:
    size, way = said.split(" is ")[1].split(":")[0].split(" ms ")
    return float(size) * (1e-3 if way == "late" else -1e-3)


@cache
def at_hand_speed() -> Recording:
    """Two fingers that move slowly and always press."""
    t, random = 1e-3 * np.arange(2000), np.random.default_rng(3)

    def wander(size):
        waves = [np.sin(2 * np.pi * random.uniform(0.2, 2) * t + random.uniform(0, 6)) for _ in range(3)]
        return size / 3 * sum(waves)

    path = np.stack(
        [np.stack([0.1 * k + wander(0.02), wander(0.02), wander(1.5e-3) - 2e-3], axis=-1) for k in range(2)],
        axis=1,
    )
    force = forces(floor(), path) + 0.02 * random.standard_normal(path.shape)
    return Recording(hip=path, hip_t=t, force=force, force_t=t)


@pytest.mark.parametrize("lag", [0.0, 0.02, -0.02, 0.3, -0.8])
def test_a_slow_hand_hides_no_shift(lag):
    kinds, said = found(late(at_hand_speed(), lag), floor(mu=0.3), friction=True)
    assert kinds == ({("shifted clock", "force")} if lag else set()), said
    if kinds:
        assert told_lag(said) == pytest.approx(lag, abs=2e-3)


@pytest.mark.parametrize(("seconds", "rate"), [(2, 0.02), (2, -0.02), (20, 0.02), (20, 0.005), (20, -0.05)])
def test_how_fast_a_clock_runs_is_told(seconds, rate):
    recording, scene = speed.strokes(seconds, 0), speed.floor(*speed.TRUTH)
    if seconds == 2:
        recording, scene = at_hand_speed(), floor(mu=0.3)
    kinds, said = found(replace(recording, force_t=(1 + rate) * recording.force_t), scene, friction=True)
    assert kinds == {("clock rate", "force")}, said
    told, way = said.split("runs about ")[1].split(" against")[0].split("% ")
    assert float(told) == pytest.approx(100 * abs(rate), abs=0.2) and way == ("fast" if rate > 0 else "slow")


def test_a_shift_beyond_what_is_looked_for_gets_no_wrong_number():
    for lag in (1.0, 1.2, -1.5):
        _, said = found(late(at_hand_speed(), lag), friction=True)
        assert "shifted by more than" in said or not said, said


@pytest.mark.parametrize("lag", [0.005, -0.012, 0.1])
def test_the_size_of_a_shift_is_told(lag):
    (finding,) = lies(
        cast(floor(), np.float64), replace(on_floor(3), force_t=on_floor().force_t + lag), False
    )
    assert finding.kind == "shifted clock"
    told = float(finding.sentence.split(" is ")[1].split(" ms")[0])
    assert told == pytest.approx(1e3 * abs(lag), abs=1.0)
    assert ("late" if lag > 0 else "early") in finding.sentence


@pytest.mark.parametrize("seed", [0, 5])
def test_poses_that_were_held_are_no_shifted_clock(seed):
    """They are named; poses that rest and then move on are not."""
    true = lifted(seed, 2000)
    assert true.pose is not None and true.pose_t is not None
    held, rests = true.pose.copy(), true.pose.copy()
    held[100:200], rests[:20] = held[100], rests[20]
    kinds, said = found(replace(true, pose=held), held_cube())
    assert kinds == {("held poses", "pose")}, said
    assert "from 0.505 to 1 s, then jumps by" in said
    assert found(replace(true, pose=rests), held_cube()) == (set(), "")
