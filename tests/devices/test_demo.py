"""The demonstration's tasks: the cube does what the script intends, so that a fit finds what it looks for."""

from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hapjax
import hapjax_devices as devices
from hapjax_devices import demo

pytestmark = pytest.mark.slow


class Played(NamedTuple):
    """A task as it went: the truth at each tick."""

    result: devices.ServoResult
    reply: hapjax.Reply
    place: np.ndarray
    turn: np.ndarray

    def at(self, start: float, end: float) -> slice:
        return slice(round(start * 1000), round(end * 1000))


def play(build) -> Played:
    task = build(0)
    scene = hapjax.cast(task.scene, jnp.float32)
    result = devices.run(
        scene,
        task.devices,
        task.duration,
        force_sensor=task.sensors.force,
        pose_tracker=task.sensors.pose,
        realtime=False,
    )
    hips = jnp.asarray(result.recording.hip, jnp.float32)
    _, reply = hapjax.rollout(scene, hapjax.init(scene, hips[0]), hips, 1e-3)
    pose = np.asarray(reply.pose, np.float64)[:, 0]
    turn = Rotation.from_quat(pose[:, 3:], scalar_first=True).as_rotvec(degrees=True)
    return Played(result, reply, pose[:, :3] - [0, 0, demo.SIDE / 2], turn)


@pytest.fixture(scope="module")
def lift() -> Played:
    return play(demo.three_finger_lift)


@pytest.fixture(scope="module")
def swing() -> Played:
    return play(demo.two_finger_swing)


def test_no_command_is_changed_on_its_way(lift, swing):
    """Otherwise the device's limit, not the cube, would be what the sensor sees."""
    for played in (lift, swing):
        assert played.result.limited == 0 and played.result.not_finite == 0
        assert np.max(np.linalg.norm(played.reply.force, axis=-1)) < 8.0


def test_the_sensors_see_the_truth_with_their_noise(lift, swing):
    for played in (lift, swing):
        recording = played.result.recording
        noise = recording.force - np.asarray(played.reply.force, np.float64)[::2]
        assert noise.std() == pytest.approx(0.02, rel=0.02)
        place = recording.pose[:, 0, :3] - [0, 0, demo.SIDE / 2] - played.place[9::10]
        assert place.std() == pytest.approx(1e-4, rel=0.1)


def test_the_strokes_slide_while_the_cube_stays(lift):
    touch = lift.reply.touch["cube"]
    stroke = lift.at(0.5, 0.7)
    normal = np.asarray(touch.normal_force)[stroke]
    tangential = np.linalg.norm(np.asarray(touch.friction_force)[stroke], axis=-1)
    assert np.all((normal > 1.0) & (normal < 2.2))
    np.testing.assert_allclose(tangential / normal, 0.6, rtol=1e-5)
    before = lift.at(0.0, 1.4)
    assert np.max(np.abs(lift.place[before])) < 5e-4
    assert np.max(np.abs(lift.turn[before])) < 0.5


def test_the_grip_holds_while_the_cube_is_lifted_and_shaken(lift):
    touch = lift.reply.touch["cube"]
    held = lift.at(2.9, 5.2)
    normal = np.asarray(touch.normal_force)[held]
    tangential = np.linalg.norm(np.asarray(touch.friction_force)[held], axis=-1)
    assert np.min(normal) > 2.0 and np.max(tangential / normal) < 0.5
    shaken = lift.at(4.0, 5.0)
    assert np.min(lift.place[shaken, 2]) > 0.035
    assert np.all(np.ptp(lift.place[shaken], axis=0) > 0.01)
    assert np.all(np.ptp(lift.turn[shaken], axis=0) > 8.0)


def test_the_cube_is_put_down_flat_and_let_go(lift):
    end = lift.at(6.4, 6.5)
    np.testing.assert_array_equal(np.asarray(lift.reply.force)[end], 0.0)
    assert np.max(np.abs(lift.place[end])) < 2e-3
    assert np.max(np.abs(lift.turn[end])) < 0.1


def area(played: Played) -> np.ndarray:
    """A / A_crit of the two friction circles, MHS section 3.2."""
    circle = np.asarray(played.reply.touch["cube"].circle, np.float64)
    return np.mean(np.pi * circle**2, axis=1) / 2e-5


def test_gripped_hard_the_cube_keeps_its_attitude(swing):
    for start, end in ((0.85, 1.45), (6.1, 6.5)):
        span = swing.at(start, end)
        assert np.all(area(swing)[span] > 1.2)
        assert np.max(np.ptp(swing.turn[span], axis=0)) < 0.01
    assert swing.place[1450, 2] > 0.01  # off the floor


def test_gripped_softer_it_drops_and_swings_about_the_line_through_the_fingers(swing):
    span = swing.at(1.85, 5.6)
    share = area(swing)[span]
    assert np.all((share > 0.3) & (share < 0.95)) and np.ptp(share) > 0.3
    # It hangs where its centre is below the line: 5 mm beside and 10 mm below it.
    turn = swing.turn[span]
    assert np.mean(turn[-2000:, 0]) == pytest.approx(np.degrees(np.arctan(0.5)), abs=2.0)
    assert np.max(np.abs(turn[:, 1:])) < 0.1
    reversals = np.sum(np.diff(np.sign(np.diff(turn[::50, 0]))) != 0)
    assert reversals >= 6 and np.ptp(turn[1500:, 0]) > 10
    assert np.all(np.asarray(swing.reply.contact["cube_on_floor"].normal_force)[span] == 0)
