"""The recorder: all that was on the bus is in the file, whoever of servo and recorder is killed."""

import errno
import json
import os
import resource
import signal
import subprocess
import sys
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
from mcap.reader import make_reader

import bus_cases
from bus_cases import NONE, about, numbers, publish
from hapjax import InputError, Recording, load_recording
from hapjax_devices import Event, RecorderProcess, TickPublisher, TickReader, record, runs
from hapjax_devices.recorder import growing

RATE = 1000.0


def recorded(path, ticks, **options):
    """Record, in this process, what `ticks(publisher)` publishes; what the recorder said."""
    said = []
    made = about(f"{path.stem}-{os.getpid()}", **options)
    with TickPublisher(made) as publisher:
        thread = threading.Thread(target=lambda: said.append(record(made.run, path)), daemon=True)
        thread.start()
        publisher.wait_for(1, 10.0)
        ticks(publisher)
    thread.join(10)
    return said


def messages(path, *topics):
    """What a file says, by the library's own reader: (topic, log time, message)."""
    with open(path, "rb") as file:
        found = make_reader(file).iter_messages(topics=topics or None)
        return [(channel.topic, message.log_time, json.loads(message.data)) for _, channel, message in found]


def events(path):
    return [(said["kind"], said["tick"], said["message"]) for _, _, said in messages(path, "/event")]


def test_a_recording_is_what_was_published(tmp_path):
    path = tmp_path / "whole.mcap"
    assert recorded(path, lambda publisher: publish(publisher, range(300))) == ["300 ticks recorded"]
    recording = load_recording(path)
    assert recording.findings == ()
    hip, gimbal, force, memory = (np.stack(x) for x in zip(*map(numbers, range(300)), strict=True))
    np.testing.assert_array_equal(recording.hip, hip)
    np.testing.assert_array_equal(recording.gimbal, gimbal)
    np.testing.assert_array_equal(recording.force, force)
    # What the step answered is what its memory begins with.
    assert recording.model_force is not None
    np.testing.assert_array_equal(recording.model_force.reshape(300, -1), memory.astype(np.float32)[:, :6])
    times = np.arange(300) / 400
    np.testing.assert_array_equal(recording.hip_t, times)
    np.testing.assert_array_equal(recording.pose_t, np.arange(1, 301) / 400)
    place = memory.astype(np.float32)[:, 4:7].astype(float)
    assert recording.pose is not None
    np.testing.assert_array_equal(recording.pose[:, 0, :3], place)


def test_a_recording_says_of_itself_what_it_is(tmp_path):
    path = tmp_path / "told.mcap"
    before = time.time_ns()
    recorded(path, lambda publisher: publish(publisher, range(40)))
    with open(path, "rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        attached = {a.name: a.data for a in reader.iter_attachments()}
        (run,) = reader.iter_metadata()
    assert summary is not None and summary.statistics is not None
    assert {c.topic for c in summary.channels.values()} == {
        *("/hip", "/force", "/model_force", "/gimbal", "/pose", "/servo", "/event")
    }
    assert set(attached) == {"scene.toml", "devices.json"} and b"cube" in attached["scene.toml"]
    assert json.loads(attached["devices.json"])[1]["force_limit"] == 8.5
    began = int(run.metadata["wall_start_ns"])
    assert before <= began <= time.time_ns() and run.metadata["rate"] == "400.0"
    schemas = {channel.topic: summary.schemas[channel.schema_id] for channel in summary.channels.values()}
    assert {schema.encoding for schema in schemas.values()} == {"jsonschema"}
    for topic, _, said in messages(path):
        assert set(json.loads(schemas[topic].data)["properties"]) == set(said)
    # The first tick's, then 2.5 ms each by the servo's clock.
    stamps = [stamp for _, stamp, _ in messages(path, "/servo")]
    assert np.all(np.diff(stamps) == 2_500_000) and 0 < stamps[0] - began < 60e9
    servo = messages(path, "/servo")[7][2]
    assert (servo["tick"], servo["lateness_us"], servo["compute_us"]) == (7, 1.5, 20.25)


def test_what_happened_is_in_the_recording(tmp_path):
    path = tmp_path / "events.mcap"

    def ticks(publisher):
        publish(publisher, range(150), counts=(0, 0, 7, 2, 5, 3, 1))
        publisher.tell(Event(50, time.perf_counter_ns(), 1, "fault", "the cable is out"))
        publisher.tell(Event(60, time.perf_counter_ns(), 1, "limited", "forces over it"))
        publish(publisher, range(152, 155), counts=(3, 0, 7, 2, 5, 3, 1))

    recorded(path, ticks)
    fault, limited, dropped, end = sorted(events(path), key=lambda event: event[1])
    if dropped[0] == "end":  # at the same tick
        dropped, end = end, dropped
    assert fault == ("fault", 50, "the cable is out") and limited == ("limited", 60, "forces over it")
    assert end == ("end", 154, "the loop ended after 155 ticks")
    noticed = dropped[1]  # when the recorder looked next
    assert 152 <= noticed <= 154
    sentence = f"2 ticks before tick {noticed} were not recorded: the recorder was late"
    assert dropped == ("dropped", noticed, sentence)
    said = {message["kind"]: message for _, _, message in messages(path, "/event")}
    assert [said[kind]["level"] for kind in ("fault", "limited", "end")] == [4, 3, 2]
    assert (said["limited"]["finger"], said["limited"]["t"]) == (1, 60 / 400)
    last = messages(path, "/servo")[-1][2]
    assert [last[name] for name in ("missed", "limited", "slewed", "ramped", "overrun")] == [3, 7, 5, 3, 1]
    found = load_recording(path).findings
    assert not any(finding.kind == "dropout" for finding in found)  # 2 are no gap


def test_samples_that_are_not_finite_are_left_out_and_counted(tmp_path):
    path = tmp_path / "unfit.mcap"

    def ticks(publisher):
        publish(publisher, range(10))
        hip, gimbal, force, memory = numbers(10)
        memory[8] = np.nan  # of the pose
        publisher.publish(10, time.perf_counter_ns(), 0.0, 0.0, NONE, 0, hip, gimbal, force, memory)

    recorded(path, ticks)
    recording = Recording.load(path)
    assert recording.hip is not None and recording.pose is not None
    assert (len(recording.hip), len(recording.pose)) == (11, 10)
    assert ("unfit", 10, "1 samples until tick 10 were left out: they were not finite") in events(path)


def test_a_full_disk_ends_the_recording_and_leaves_it_whole(tmp_path, monkeypatch):
    """The third batch is cut short by the system, as a disk that gets full does it."""
    path, written = tmp_path / "full.mcap", []

    class System:
        def __getattr__(self, name):
            return getattr(os, name)

        def write(self, file, data):
            written.append(len(data))
            if len(written) == 4:
                return os.write(file, data[:100])
            if len(written) > 4:
                raise OSError(errno.ENOSPC, "No space left on device")
            return os.write(file, data)

    monkeypatch.setattr(growing, "os", System())
    made = about("full")
    told = growing.GrowingFile(path, made, {"/hip": ("hapjax.hip", b"{}")})
    data = b'{"t":%d,"fingers":[{"x":0.5,"y":0.0,"z":0.0}]}'
    told.save([growing.Message("/hip", 5, data % 0)])
    told.save([growing.Message("/hip", 6, data % 1)])
    with pytest.raises(OSError, match="No space") as caught:
        told.save([growing.Message("/hip", 7, data % 2)])
    assert caught.value.filename == str(path) and path.stat().st_size == sum(written[:3])
    recording = load_recording(path)
    assert recording.hip_t is not None and recording.hip_t.tolist() == [0, 1]
    assert [finding.kind for finding in recording.findings] == ["cut short"]


def test_a_disk_that_is_full_from_the_start_is_left_without_a_file(tmp_path, monkeypatch):
    class System:
        def __getattr__(self, name):
            return getattr(os, name)

        def write(self, file, data):
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(growing, "os", System())
    with pytest.raises(InputError, match=r"a\.mcap: cannot be made: No space left on device"):
        growing.GrowingFile(tmp_path / "a.mcap", about("full"), {})
    assert not any(tmp_path.iterdir())


def test_a_scene_that_is_in_no_file_is_said_to_be_missing(tmp_path):
    why = "object.stone.file is missing"
    told = growing.GrowingFile(tmp_path / "a.mcap", replace(about("loose"), scene="", unsaid=why), {})
    told.finish()
    with open(tmp_path / "a.mcap", "rb") as file:
        reader = make_reader(file)
        assert [run.metadata["no_scene"] for run in reader.iter_metadata()] == [why]
        assert [attached.name for attached in reader.iter_attachments()] == ["devices.json"]


def test_no_recording_is_written_over(tmp_path):
    path = tmp_path / "there.mcap"
    path.write_text("mine")
    with pytest.raises(InputError, match="there.mcap: exists; allowed: a recording with a new name"):
        growing.GrowingFile(path, about("there"), {})
    with pytest.raises(InputError, match="cannot be made: No such file"):
        growing.GrowingFile(tmp_path / "no" / "a.mcap", about("there"), {})
    assert path.read_text() == "mine"


# Processes that are killed --------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def killed(tmp_path_factory):
    """A servo at 1 kHz with four recorders: one is killed, one's disk gets full, one comes later and is stopped, and
    one sees the servo be killed. Their files, the tick that was read when each ended, and what it said."""
    folder, run = tmp_path_factory.mktemp("killed"), f"killed-{os.getpid()}"
    names = ("killed", "full", "stopped", "last")
    files = {name: folder / f"{name}.mcap" for name in names}
    recorders = {name: RecorderProcess(run, files[name], 60.0) for name in ("killed", "full", "last")}
    servo = subprocess.Popen([sys.executable, bus_cases.__file__, run, str(RATE), "2"])
    try:
        with TickReader(run, patience=30.0) as reader:
            until = time.monotonic() + 30
            while not all(files[name].exists() for name in recorders) and time.monotonic() < until:
                time.sleep(0.02)
            resource.prlimit(recorders["full"].pid, resource.RLIMIT_FSIZE, (40_000, 40_000))
            recorders["stopped"] = RecorderProcess(run, files["stopped"], 60.0)
            while not files["stopped"].exists() and time.monotonic() < until:
                time.sleep(0.02)
            ticks = {}

            def newest():
                while len(reader.take()):
                    pass
                return reader.last

            time.sleep(0.3)
            ticks["killed"] = newest()
            os.kill(recorders["killed"].pid, signal.SIGKILL)
            ticks["stopped"] = newest()
            recorders["stopped"].stop()
            time.sleep(0.2)
            servo.kill()
            servo.wait()
            ticks["last"] = newest()
        said = {name: recorder.wait(20.0) for name, recorder in recorders.items()}
        return files, ticks, said
    finally:
        for process in (servo, *recorders.values()):
            process.kill()
            process.wait()


def last_tick(path):
    recording = load_recording(path)
    assert recording.hip_t is not None and recording.force_t is not None
    assert recording.hip_t[-1] == recording.force_t[-1] and np.all(np.diff(recording.hip_t) < 1.5 / RATE)
    return round(recording.hip_t[-1] * RATE)


@pytest.mark.slow
def test_a_killed_servo_loses_nothing(killed):
    files, ticks, said = killed
    code, sentence = said["last"]
    assert code == 0 and sentence.endswith("the servo's process ended without a word")
    assert last_tick(files["last"]) == ticks["last"]
    kind, tick, sentence = events(files["last"])[-1]
    assert (kind, tick) == ("cut", ticks["last"]) and "without a word" in sentence
    assert load_recording(files["last"]).findings == ()


@pytest.mark.slow
def test_what_was_killed_is_cleaned_up(killed):
    """Also of the servo, whose services nobody closed."""
    assert f"killed-{os.getpid()}" not in runs()
    with TickPublisher(about(f"killed-{os.getpid()}", fingers=5)) as again:  # with other samples, too
        assert again.run in runs()


@pytest.mark.slow
def test_a_killed_recorder_loses_a_tenth_of_a_second_at_most(killed):
    files, ticks, said = killed
    assert said["killed"][0] == -signal.SIGKILL
    assert last_tick(files["killed"]) >= ticks["killed"] - 0.1 * RATE
    assert [finding.kind for finding in load_recording(files["killed"]).findings] == ["cut short"]


@pytest.mark.slow
def test_a_recorder_that_is_stopped_finishes_its_file(killed):
    files, ticks, said = killed
    assert said["stopped"][0] == 0 and said["stopped"][1].endswith("ticks recorded")
    assert last_tick(files["stopped"]) >= ticks["stopped"]
    assert load_recording(files["stopped"]).findings == ()


@pytest.mark.slow
def test_a_recorder_whose_disk_is_full_says_so_and_the_servo_goes_on(killed):
    files, ticks, said = killed
    code, sentence = said["full"]
    assert (
        code == 1
        and f"{files['full']}: the recording ends here (File too large), the servo goes on" in sentence
    )
    assert 0 < files["full"].stat().st_size <= 40_000 and 0 < last_tick(files["full"]) < ticks["last"]


@pytest.mark.slow
def test_a_recorder_with_nothing_to_record_says_so(tmp_path):
    path = tmp_path / "a.mcap"
    recorder, other = RecorderProcess("nowhere", path, 0.0), RecorderProcess("nowhere", path, 600.0)
    code, sentence = recorder.wait(60.0)
    assert code == 2 and sentence.startswith("hapjax: no run 'nowhere' is on the bus; allowed: ")
    other.stop()  # it need not wait for the run
    assert other.wait(20.0)[0] == -signal.SIGTERM and not path.exists()
