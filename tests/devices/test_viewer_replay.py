"""Recordings in the viewer: objects where they were recorded, touches as the scene makes them, and a bar that goes on."""

import signal
from contextlib import nullcontext
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hapjax
from hapjax.cli import main

pytest.importorskip("viser", reason="the viewer needs the extra viewer")

from hapjax_devices.bus import About  # noqa: E402
from hapjax_devices.recorder.growing import GrowingFile  # noqa: E402
from hapjax_devices.recorder.messages import Message, Messages  # noqa: E402
from hapjax_devices.viewer import recorded, replay  # noqa: E402
from hapjax_devices.viewer.geometry import matrices  # noqa: E402
from viewer_cases import Drawn  # noqa: E402

DT, STEPS = 1e-3, 300


def lifting(damping=1.0):
    """A cube in two fingers, which take it up and turn it, and its floor."""
    surface = hapjax.Surface(800.0, mu=0.8, damping=damping)
    body = hapjax.Body(0.1, (6e-5,) * 3, (0.0, 0.0, 0.002))
    cube = hapjax.Object(hapjax.Box((0.06,) * 3), surface, body, (0, 0, 0.03))
    pair = hapjax.Contact(5000.0, mu=0.5, damping=0.5, between=("cube", "floor"))
    scene = hapjax.Scene(
        {"floor": hapjax.Object(hapjax.Plane()), "cube": cube},
        {"cube_on_floor": pair},
        torsion=hapjax.GravityDrop(2e-5, 1e-4),
        world=hapjax.World((0, 0, -9.81)),
        integrator=hapjax.SemiImplicit(dt=DT),
    )
    return hapjax.cast(scene, float)


@pytest.fixture(scope="module")
def lifted():
    """The scene, the recording of a lift, and what the scene answered."""
    t = np.arange(STEPS) * DT
    grip = 0.033 - 0.006 * np.clip(t / 0.05, 0, 1)
    up, turn = 0.02 * np.clip((t - 0.1) / 0.2, 0, 1), 0.6 * np.clip((t - 0.1) / 0.2, 0, 1)
    side = np.stack([np.cos(turn), np.sin(turn), 0 * t], axis=1) * grip[:, None]
    rise = np.stack([0 * t, 0 * t, 0.03 + up], axis=1)
    hips, scene = np.stack([rise + side, rise - side], axis=1), lifting()
    _, reply = hapjax.rollout(scene, hapjax.init(scene, hips[0]), hips)
    pose = np.asarray(reply.pose)
    assert pose[-1, 0, 2] > 0.04 and not np.any(reply.lost)
    recording = hapjax.Recording(
        hip=hips, hip_t=t, pose=pose, pose_t=t + DT, force=np.asarray(reply.force), force_t=t
    )
    return scene, recording, jax.device_get(reply)


@pytest.mark.parametrize("with_poses", [True, False])
def test_touches_are_those_of_the_scene_where_the_objects_were(lifted, with_poses):
    scene, recording, reply = lifted
    given = recording
    if not with_poses:
        given = hapjax.Recording(hip=recording.hip, hip_t=recording.hip_t)
    found = replay.course_of(scene, given)
    kept, touch = slice(9, STEPS, 10), reply.touch["cube"]
    np.testing.assert_allclose(found.time, np.arange(STEPS)[kept] * DT)
    np.testing.assert_allclose(found.pose[:, 1], reply.pose[kept, 0], atol=1e-6)
    np.testing.assert_allclose(found.hip, recording.hip[kept])
    np.testing.assert_allclose(found.force, reply.force[kept], atol=1e-9 if with_poses else 1e-6)
    # Recorded poses give the velocities, on which the damping depends, as differences.
    near = 5e-3 if with_poses else 1e-6
    np.testing.assert_allclose(found.normal_force[:, 0], touch.normal_force[kept], atol=near)
    np.testing.assert_allclose(
        np.linalg.norm(found.friction[:, 0], axis=-1), _norm(touch.friction_force)[kept], atol=near
    )
    np.testing.assert_allclose(found.circle[:, 0], touch.circle[kept], atol=1e-7)
    np.testing.assert_allclose(found.critical_area, 2e-5)


def _norm(x):
    return np.linalg.norm(x, axis=-1)


def test_velocities_are_those_of_the_motion():
    t = np.arange(100) * DT
    turn = np.array([0.3, -0.2, 0.5]) * t[:, None] * 4
    size = np.linalg.norm(turn, axis=1, keepdims=True)
    quaternion = np.concatenate([np.cos(size / 2), np.sin(size / 2) * turn / np.maximum(size, 1e-12)], axis=1)
    quaternion[50:] *= -1  # the same turns
    pose = np.concatenate([np.array([0.1, 0.0, -0.2]) * t[:, None], quaternion], axis=1)
    recording = hapjax.Recording(hip=np.zeros((100, 1, 3)), hip_t=t, pose=pose[:, None], pose_t=t)
    found = replay._motions(lifting(), recording, t, DT)
    np.testing.assert_allclose(found[1:, 0, 10:], np.tile([1.2, -0.8, 2.0], (99, 1)), atol=2e-3)
    arm = matrices(pose[1:, 3:]) @ [0, 0, 0.002]
    wanted = [0.1, 0.0, -0.2] + np.cross([1.2, -0.8, 2.0], arm)
    np.testing.assert_allclose(found[1:, 0, 7:10], wanted, atol=1e-5)


def test_the_scene_of_a_recording_is_that_which_is_recorded_with_it(tmp_path, monkeypatch):
    from mcap.writer import Writer

    file = tmp_path / "lift.mcap"
    text = "[object.part]\nshape = 'mesh'\nfile = 'parts/block.stl'\n[object.part.surface]\nmu = 0.5\nstiffness = 1000.0\n"
    mesh = pytest.importorskip("trimesh").creation.box((0.1, 0.2, 0.3)).export(file_type="stl")
    with file.open("wb") as opened:
        writer = Writer(opened)
        writer.start()
        for name, data in (("scene.toml", text.encode()), ("parts/block.stl", mesh), ("../out.stl", b"")):
            writer.add_attachment(0, 0, name, "", data)
        writer.finish()
    (tmp_path / "temporary").mkdir()
    monkeypatch.setattr(recorded.tempfile, "tempdir", str(tmp_path / "temporary"))
    scene = recorded.attached_scene(file)
    assert scene.touchable() == ["part"]
    assert float(scene.object["part"].shape.volume()) == pytest.approx(6e-3)  # pyright: ignore[reportArgumentType]
    assert not [*(tmp_path / "temporary").iterdir()]  # nothing was written elsewhere, and what was is gone


@pytest.mark.parametrize("name", ["", ".", "scene.toml/x", "a\0b", "x" * 300])
def test_attachments_that_can_be_no_files_are_refused(name, tmp_path):
    from mcap.writer import Writer

    with (tmp_path / "a.mcap").open("wb") as opened:
        writer = Writer(opened)
        writer.start()
        for each in ("scene.toml", name):
            writer.add_attachment(0, 0, each, "", b"[object.floor]\nshape = 'plane'\n")
        writer.finish()
    with pytest.raises(hapjax.InputError, match=r"a.mcap: has the attachment .*; allowed: names of files"):
        recorded.attached_scene(tmp_path / "a.mcap")


STIFFNESS, A_CRIT = "object.block.surface.stiffness", "torsion.critical_area"


@pytest.fixture(scope="module")
def pressed(tmp_path_factory):
    """The recording of a run, 60 ticks of two fingers 1 mm deep in a block that is twice as stiff from tick 33 on."""
    surface = hapjax.Surface(1000.0, mu=0.5)
    block = hapjax.Object(hapjax.Box((0.06,) * 3), surface, hapjax.Body(1.0))
    scene = hapjax.Scene({"block": block}, torsion=hapjax.GravityDrop(2e-5))
    hip = np.array([[0.029, 0.0, 0.0], [-0.029, 0.0, 0.0]])
    packed = hapjax.pack(scene, hip, DT, live=(STIFFNESS, A_CRIT))
    about = About.of("pressed", 1 / DT, scene, packed, [], 0)
    ticks, memory = np.zeros(60, about.tick), np.array(packed.start)
    for tick in range(60):
        if tick == 33:
            memory[packed.live[STIFFNESS]], memory[packed.live[A_CRIT]] = 2000.0, 1e-5
        memory = np.array(packed.call(memory, jnp.asarray(hip, packed.dtype)))
        ticks[tick]["tick"], ticks[tick]["time_ns"], ticks[tick]["hip"] = tick, 10**6 * tick, hip
        ticks[tick]["memory"][: about.memory] = memory
    file, messages = tmp_path_factory.mktemp("pressed") / "pressed.mcap", Messages(about)
    growing = GrowingFile(file, about, messages.schemas)
    for some in (ticks[:20], ticks[20:]):  # in batches, as they come
        growing.save(messages.of_ticks(some))
    growing.finish()
    return scene, file


def test_numbers_that_were_changed_meanwhile_are_played_back(pressed):
    scene, file = pressed
    with jax.enable_x64(True):
        given, recording = recorded.attached_scene(file), hapjax.Recording.load(file)
        live = recorded.recorded_numbers(file, given)
        found = replay.course_of(given, recording, live)
    np.testing.assert_allclose(live.since, [0, 0.033])  # where they were others, and there alone
    np.testing.assert_allclose(live.values[STIFFNESS], [1000, 2000])
    np.testing.assert_allclose(found.time, [0.009, 0.019, 0.029, 0.039, 0.049, 0.059])
    np.testing.assert_allclose(
        found.normal_force[:, 0], np.repeat([[1.0, 1.0], [2.0, 2.0]], 3, axis=0), rtol=1e-4
    )
    np.testing.assert_allclose(found.critical_area, np.repeat([2e-5, 1e-5], 3))


def test_a_recording_that_was_cut_short_still_has_its_scene(pressed, tmp_path):
    scene, file = pressed
    whole = file.read_bytes()
    for part in (0.95, 0.7):
        (tmp_path / "cut.mcap").write_bytes(whole[: int(part * len(whole))])
        with jax.enable_x64(True):
            given = recorded.attached_scene(tmp_path / "cut.mcap")
            live = recorded.recorded_numbers(tmp_path / "cut.mcap", given)
        assert given.touchable() == scene.touchable() == ["block"]
        assert live.values[STIFFNESS][0] == 1000


MALFORMED = {
    b'{"t": 1}': "a time t, and path and value",
    b'{"t": 0, "numbers": [{"path": "torsion.twist", "value": [1]}]}': "torsion has no twist",
    b'{"t": 0, "numbers": [{"path": "torsion.critical_area", "value": [1, 2]}]}': "is [1.0, 2.0]; allowed: finite",
    b'{"t": 0, "numbers": [{"path": "torsion.critical_area", "value": [NaN]}]}': "is [nan]; allowed: finite",
}


@pytest.mark.parametrize("said", MALFORMED)
def test_numbers_of_another_form_are_refused(said, pressed, tmp_path):
    scene, _ = pressed
    about = About("n", 1e3, 1, 0, 1, "float64", (), (), (), "", {}, "", 1, 0, 0, {"a": (0, 1)})
    growing = GrowingFile(tmp_path / "a.mcap", about, Messages(about).schemas)
    growing.save([Message("/numbers", 0, said)])
    growing.finish()
    with pytest.raises(hapjax.InputError, match=r"a\.mcap, /numbers: ") as refusal:
        recorded.recorded_numbers(tmp_path / "a.mcap", scene)
    assert MALFORMED[said] in str(refusal.value)


def test_far_more_numbers_than_the_file_has_bytes_are_refused(pressed, tmp_path):
    scene, _ = pressed
    about = About("n", 1e3, 1, 0, 1, "float64", (), (), (), "", {}, "", 1, 0, 0, {"a": (0, 1)})
    growing = GrowingFile(tmp_path / "a.mcap", about, Messages(about).schemas)
    growing.save([Message("/numbers", 0, b'{"t": 0, "numbers": []}')] * 40_000)
    growing.finish()
    with pytest.raises(hapjax.InputError, match=r"a.mcap: expected \d+ bytes to unpack to at most"):
        recorded.recorded_numbers(tmp_path / "a.mcap", scene)


REFUSED = {
    "no scene": (["a.npz"], ["a.npz: no scene is recorded with it", "--scene"]),
    "other objects": (["a.npz", "--scene", "other.toml"], ["a.npz: pose has 1 objects; allowed: 0"]),
    "no path": (["b.npz", "--scene", "other.toml"], ["b.npz: hip was not recorded"]),
    "too short": (["c.npz", "--scene", "other.toml"], ["c.npz: hip lasts 0.005 s; allowed: 0.01 s or more"]),
    "no recording": (["d.npz"], ["d.npz"]),
    "a port": (["a.npz", "--port", "-1"], ["port is -1", "65535"]),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_played_back_is_refused(case, lifted, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    _, recording, _ = lifted
    recording.save("a.npz")
    hapjax.Recording(pose=recording.pose, pose_t=recording.pose_t).save("b.npz")
    hapjax.Recording(hip=recording.hip[:5], hip_t=recording.hip_t[:5]).save("c.npz")
    (tmp_path / "other.toml").write_text(
        "[object.table]\nshape = 'plane'\n[object.table.surface]\nmu = 0.5\nstiffness = 1000.0\n"
    )
    arguments, words = REFUSED[case]
    assert main(["view", *arguments]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    for word in words:
        assert word in error


def test_what_takes_long_is_told_of_and_ctrl_c_ends_it(lifted, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("FORCE_COLOR", "1")  # as on a terminal
    scene, recording, _ = lifted
    recording.save("a.npz")
    hapjax.save_scene(scene, "cube.toml")
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    monkeypatch.setattr(replay, "course_of", lambda *_: signal.raise_signal(signal.SIGINT))
    try:
        assert main(["view", "a.npz", "--scene", "cube.toml", "--port", "0"]) == 130
    finally:
        signal.signal(signal.SIGINT, before)
    said = capsys.readouterr().err
    assert 0 < said.index("reading") < said.index("following the recording") < said.index("interrupted")


class Gui:
    """Stands for the panel of viser."""

    def add_folder(self, *arguments, **options):
        return nullcontext()

    def add_uplot(self, *arguments, **options):
        return SimpleNamespace()

    def add_slider(self, label, **options):
        made = SimpleNamespace(value=options["initial_value"], max=options.get("max"))
        made.on_update = lambda f: setattr(made, "moved", f)
        return made

    def add_checkbox(self, label, **options):
        return self.add_slider(label, **options)

    def add_dropdown(self, label, choices, **options):
        assert options["initial_value"] in choices
        return self.add_slider(label, **options)


def test_the_bar_goes_on_while_it_plays_and_begins_anew_at_its_end(lifted):
    scene, recording, _ = lifted
    course = replay.course_of(scene, recording)
    drawn = Drawn()
    sent = []
    server = SimpleNamespace(gui=Gui(), scene=drawn, atomic=nullcontext, flush=lambda: sent.append(1))
    player = replay.Player(server, scene, course)

    def hips():
        return drawn.made["/hips"].batched_positions

    for now, shown in ((0.0, 0.009), (0.1, 0.099), (0.2, 0.199)):
        player.take(now)
        assert player.bar.value == pytest.approx(now) and len(sent) == 1  # at once
        sent.clear()
        np.testing.assert_allclose(hips(), course.hip[np.searchsorted(course.time, shown)], atol=1e-6)
    player.playing.value = False
    player.take(5.0)
    assert player.bar.value == pytest.approx(0.2)
    player.bar.value = 0.05  # by the user
    player.take(5.1)
    np.testing.assert_allclose(hips(), course.hip[4], atol=1e-6)
    player.playing.value, player.speed.value = True, "0.1"
    player.take(6.1)
    assert player.bar.value == pytest.approx(0.15)
    player.speed.value = "3"
    player.take(6.2)
    assert player.bar.value == 0.0


def test_the_bar_is_the_users_while_it_is_moved_and_pages_are_told_where_it_is_left(lifted):
    scene, recording, _ = lifted
    drawn, course = Drawn(), replay.course_of(scene, recording)
    server = SimpleNamespace(gui=Gui(), scene=drawn, atomic=nullcontext, flush=lambda: None)
    player = replay.Player(server, scene, course)

    def moved(time, by: object = "a page"):
        player.bar.value = time
        player.bar.moved(SimpleNamespace(client=by))  # pyright: ignore[reportAttributeAccessIssue]

    player.take(0.0)
    for now, time in ((0.1, 0.25), (0.2, 0.05), (0.3, 0.15)):  # both ways, while it plays
        moved(time)
        player.take(now)
        player.take(now + 0.09)
        assert player.bar.value == time
    player.take(0.3 + replay.HELD - 0.01)
    assert player.bar.value == 0.15
    player.take(0.3 + replay.HELD + 0.01)
    assert player.bar.value != 0.15 and player.bar.value == pytest.approx(0.15)  # viser tells no value twice
    player.take(0.3 + replay.HELD + 0.06)
    assert player.bar.value == pytest.approx(0.2)
    moved(0.1, None)  # as when it is set from here
    player.take(0.3 + replay.HELD + 0.08)
    assert player.bar.value == pytest.approx(0.12)
    player.playing.value = False
    moved(end := float(player.bar.max))  # pyright: ignore[reportAttributeAccessIssue]
    player.take(2.0)
    player.take(3.0)
    assert end - 1e-9 < player.bar.value < end
    player.take(4.0)
    assert end - 1e-9 < player.bar.value < end
    np.testing.assert_allclose(drawn.made["/hips"].batched_positions, course.hip[-1], atol=1e-6)
