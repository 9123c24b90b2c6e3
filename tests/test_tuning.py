"""Numbers that are estimated while a scene is felt: what is measured, which seconds are taken, what is handed over."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

import hapjax
from hapjax import InputError
from hapjax.tuning import process
from hapjax.tuning.sensor import CHUNK, Measured, SimulatedSensor
from hapjax.tuning.settings import Tuning, tuned_by_default
from hapjax.tuning.window import Window
from hapjax_devices.session import supervisor
from test_docs import block

RATE = 1000.0
MU, STIFFNESS = "object.table.surface.mu", "object.table.surface.stiffness"


def table(mu=0.5, stiffness=1000.0):
    return hapjax.Scene({"table": hapjax.Object(hapjax.Plane(), hapjax.Surface(stiffness, mu=mu))})


def cube():
    """A cube that a finger pushes along a floor."""
    box = hapjax.Object(
        hapjax.Box((0.06,) * 3), hapjax.Surface(800.0, mu=0.5, damping=1.0), hapjax.Body(0.1), (0, 0, 0.03)
    )
    pair = hapjax.Contact(2000.0, mu=0.3, damping=1.0, between=("cube", "floor"))
    return hapjax.Scene(
        {"cube": box, "floor": hapjax.Object(hapjax.Plane())},
        {"cube_on_floor": pair},
        world=hapjax.World((0.0, 0.0, -9.81)),
    )


def rubbing(seconds):
    """A finger that comes down every second, rubs along the table 1 mm deep, and goes up again."""
    t = np.arange(round(seconds * RATE)) / RATE
    z = np.where((t % 1 > 0.2) & (t % 1 < 0.8), -1e-3, 1e-3)
    return np.stack([0.01 * np.sin(2 * np.pi * 3 * t), 0 * t, z], axis=1)[:, None]


def ticks_of(hip, first=0, force=None):
    """Ticks as a reader takes them, with what a model's fingers feel where they touch."""
    kind = np.dtype([("tick", "i8"), ("hip", "f8", (1, 3)), ("gimbal", "f8", (0,)), ("force", "f8", (1, 3))])
    ticks = np.zeros(len(hip), kind)
    ticks["tick"], ticks["hip"] = first + np.arange(len(hip)), hip
    ticks["force"][:, 0, 2] = np.where(hip[:, 0, 2] < 0, 1.0, 0.0) if force is None else force
    return ticks


# Sensors ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("truth", [table, cube])
def test_the_sensor_measures_what_the_truth_answers_from_the_first_tick_on(truth):
    truth, hip = truth(), rubbing(0.3) + [0, 0, 0.06 if truth is cube else 0.0]
    sensor = SimulatedSensor(truth, RATE)
    none = np.zeros((CHUNK, 0))
    parts = [sensor.measure(hip[i : i + CHUNK], none) for i in range(0, len(hip), CHUNK)]
    _, reply = hapjax.rollout(truth, hapjax.init(truth, hip[0]), hip, 1 / RATE)
    force, pose = (np.concatenate(rows) for rows in zip(*parts, strict=True))
    error = force - np.asarray(reply.force)
    assert np.std(error) == pytest.approx(sensor.noise, rel=0.1) and np.abs(error).max() < 6 * sensor.noise
    assert np.abs(np.asarray(reply.force)).max() > 20 * sensor.noise
    assert pose.shape == reply.pose.shape and np.abs(pose - np.asarray(reply.pose)).max(initial=0) < 0.01


# Windows ----------------------------------------------------------------------------------------------------


def filled(window, hip, first=0, force=None):
    for i in range(0, len(hip), CHUNK):
        ticks = ticks_of(hip[i : i + CHUNK], first + i, force)
        window.add(ticks, Measured(ticks["force"], np.zeros((len(ticks), 0, 7))))


def test_a_window_is_the_newest_that_begins_without_a_touch():
    window = Window(1.5, RATE, 0.2)
    filled(window, rubbing(4.4))
    recording = window.cut()
    assert recording is not None and recording.hip is not None and recording.hip_t is not None
    assert len(recording.hip_t) == 1500 and recording.hip_t[0] == pytest.approx(2.899, abs=2e-3)
    assert (
        recording.force_t is not None
        and recording.hip[0, 0, 2] > 0
        and recording.pose is None
        and recording.gimbal is None
    )
    np.testing.assert_allclose(recording.force_t, recording.hip_t[::2])  # at 500 Hz
    assert window.cut() is None  # nothing new
    filled(window, rubbing(5.4)[4400:], 4400)
    again = window.cut()
    assert again is not None and again.hip_t is not None and again.hip_t[0] > 3.6


def test_there_is_no_window_of_what_is_too_short_torn_or_never_let_go():
    window = Window(1.5, RATE, 0.2)
    filled(window, rubbing(1.4))
    assert window.cut() is None
    filled(window, rubbing(1.5), 1450)  # 50 ticks are missing before it
    assert window.cut() is None
    held = Window(1.5, RATE, 0.2)
    filled(held, rubbing(4.0), force=1.0)
    assert held.cut() is None and held.lacks == ""  # it may come yet
    filled(held, rubbing(0.5), 4000, force=1.0)
    assert (
        held.cut() is None
        and "touched something all the time in the last 4.5 s; a window of 1.5" in held.lacks
    )
    idle = Window(1.5, RATE, 0.2)
    filled(idle, np.full((4500, 1, 3), 1e-3))
    assert idle.cut() is None and idle.lacks == "no finger touched anything in the last 4.5 s"
    filled(idle, rubbing(1.6), 4500)
    assert idle.cut() is not None and idle.lacks == ""


def test_what_only_the_sensor_feels_is_a_touch_too():
    window, hip = Window(1.0, RATE, 0.2), rubbing(2.0)
    ticks = ticks_of(hip, force=np.where(np.arange(2000) < 1700, 0.0, 1.0))
    felt = np.where(np.arange(2000) < 300, 0.0, 0.3)[:, None, None] * np.array([0.0, 0.0, 1.0])
    window.add(ticks, Measured(felt, np.zeros((len(ticks), 0, 7))))
    recording = window.cut()
    assert recording is not None and recording.hip_t is not None
    assert recording.hip_t[0] == 0.299


def test_a_window_has_poses_at_the_ends_of_their_steps():
    window, hip = Window(1.0, RATE, 0.2), rubbing(1.2)
    pose = np.tile([0.0, 0.0, 0.03, 1.0, 0.0, 0.0, 0.0], (len(hip), 1, 1))
    window.add(ticks_of(hip), Measured(ticks_of(hip)["force"], pose))
    recording = window.cut()
    assert recording is not None and recording.pose_t is not None and recording.hip_t is not None
    np.testing.assert_allclose(recording.pose_t, recording.hip_t[::10] + 1e-3)


# Estimates --------------------------------------------------------------------------------------------------


class Numbers:
    """The live numbers of a run that takes what it is given, but for what it is told to refuse."""

    def __init__(self, refuses=()):
        self.values, self._refuses = {MU: np.array(0.3), STIFFNESS: np.array(700.0)}, refuses

    def now(self):
        return dict(self.values)

    def set(self, values):
        if self._refuses:
            raise InputError(self._refuses)
        self.values = values
        return 4321


@pytest.fixture
def tuner(tmp_path):
    hapjax.save_scene(table(0.3, 700.0), tmp_path / "scene.toml")
    hapjax.save_scene(table(), tmp_path / "truth.toml")
    settings = Tuning("test", str(tmp_path / "scene.toml"), str(tmp_path / "truth.toml"), 1.0)
    return process.Tuner(settings, Numbers(), RATE)


def numberless(text):
    """Lines without what their numbers are."""
    return re.sub(r"\d+(\.\d+)?", "#", text)


def lines_said(found, capsys):
    """What `hapjax run` prints of what the tuner has found."""
    tuner = SimpleNamespace(said=lambda: found, code=lambda: None)
    supervisor._Watch._tune(SimpleNamespace(_tuner=tuner, _tuned=[]), [])  # pyright: ignore[reportArgumentType]
    return numberless(capsys.readouterr().out)


@pytest.mark.slow
def test_the_truth_is_estimated_and_handed_over(tuner, capsys):
    assert tuner.estimate() is None and "no estimate" in tuner.adopt()["sentence"]
    hip = rubbing(1.2)
    for i in range(0, len(hip), CHUNK):
        tuner.take(ticks_of(hip[i : i + CHUNK], i))
    found = tuner.estimate()
    assert found["converged"] and found["until_s"] - found["from_s"] == pytest.approx(1.0, abs=2e-3)
    for path, truth in ((MU, 0.5), (STIFFNESS, 1000.0)):
        estimate = found["parameters"][path]
        low, high = estimate["interval95"]
        assert abs(estimate["estimate"] - truth) < (high - low) < 0.05 * truth
        assert f"{path} {estimate['estimate']:.4g} (" in found["sentence"]
    handed = tuner.adopt()
    assert handed["adopted"] == 4321
    assert lines_said([found, handed], capsys) == numberless(block("realtime.md", "text"))
    now = tuner._numbers.values
    assert float(now[MU]) == pytest.approx(0.5, rel=0.02) and float(now[STIFFNESS]) == pytest.approx(
        1e3, rel=0.02
    )
    assert tuner.adopt()["adopted"] is None  # once
    tuner._numbers, tuner.estimates = Numbers("it is too late"), {MU: 0.5}
    assert "it is too late" in tuner.adopt()["sentence"]


def test_of_a_list_only_what_is_named_changes():
    now = {"a.mu": np.array([0.1, 0.2, 0.3], np.float32), "b": np.array(5.0)}
    values = process.values_of({"a.mu[1]": 0.9, "b": 6.0}, now)
    np.testing.assert_allclose(values["a.mu"], [0.1, 0.9, 0.3])
    assert values["b"] == 6 and now["b"] == 5


class Script(process.Tuner, process._Listener):
    """A tuner and a listener that follow a script: at each look, whether there is an estimate, and whether it is asked."""

    def __init__(self, looks, monkeypatch, why=()):
        self.looks, self.now, self.estimates, self.told, self._why = looks, -1, {}, [], why
        monkeypatch.setattr(process, "_asked", lambda: self.looks[self.now][1])
        monkeypatch.setattr(process, "_tell", self.told.append)
        monkeypatch.setattr(process, "_AGAIN", 0.0)
        monkeypatch.setattr(process, "PERIOD", 1e-4)

    @property
    def over(self):
        self.now += 1
        return self.now == len(self.looks)

    @property
    def lacks(self):
        return self._why[self.now] if self._why else ""

    def chunk(self):
        return None

    def estimate(self):
        if self.looks[self.now][0]:
            self.estimates = {MU: 0.5}
            return "estimate"
        return None

    def adopt(self):
        return f"adopted at {self.now}"


@pytest.mark.parametrize(
    ("always", "told"),
    [
        (False, ["adopted at 1", "estimate", "adopted at 3", "estimate"]),
        (True, ["adopted at 1", "estimate", "adopted at 2", "adopted at 3", "estimate", "adopted at 4"]),
    ],
)
def test_it_is_handed_over_when_asked_or_always(always, told, monkeypatch):
    script = Script([(False, False), (False, True), (True, False), (False, True), (True, False)], monkeypatch)
    process._loop(script, script, always)
    assert script.told == told


def test_why_there_is_no_estimate_is_said_once(monkeypatch):
    why = ["", "no touch", "no touch", "no gap", "no touch"]
    script = Script([(False, False)] * len(why), monkeypatch, why)
    process._loop(script, script, True)
    assert script.told == [{"sentence": f"no estimate: {why}"} for why in ("no touch", "no gap")]


def test_what_is_tuned_by_default_is_mu_and_stiffness_of_all_that_is_felt():
    assert tuned_by_default(cube()) == ("object.cube.surface.mu", "object.cube.surface.stiffness")
    surface = hapjax.Surface(100.0, mu_static=0.5, mu_kinetic=0.4)
    many = hapjax.Surface(100.0, mu=(0.1,) * 6)
    objects = {"a": hapjax.Object(hapjax.Plane(), surface), "b": hapjax.Object(hapjax.Box((1.0,) * 3), many)}
    assert tuned_by_default(hapjax.Scene(objects)) == (
        "object.a.surface.mu_static",
        "object.a.surface.mu_kinetic",
        "object.a.surface.stiffness",
        "object.b.surface.stiffness",
    )


def test_a_truth_of_another_kind_is_refused(tmp_path):
    hapjax.save_scene(cube(), tmp_path / "truth.toml")
    settings = Tuning("test", "scene.toml", str(tmp_path / "truth.toml"))
    settings.check(cube(), 2)
    with pytest.raises(InputError, match="objects that move are cube; allowed: as in the scene, none"):
        settings.check(table(), 2)
    with pytest.raises(InputError, match="window is 0.5 s; allowed: 1 to 60"):
        Tuning("test", "scene.toml", "truth.toml", 0.5)
