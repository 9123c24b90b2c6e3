"""The bus: what a servo says at each tick reaches whoever listens, and who does not holds nobody up."""

import os
import subprocess
import threading
import time

import numpy as np
import pytest

import hapjax
from bus_cases import about, numbers, publish
from hapjax import InputError
from hapjax_devices import (
    About,
    Broadcast,
    Event,
    NotBegun,
    TickPublisher,
    TickReader,
    VirtualDevice,
    run,
    runs,
)
from hapjax_devices.bus.about import scene_file


@pytest.fixture
def publisher(request):
    with TickPublisher(about(f"{request.node.name[:60]}-{os.getpid()}")) as made:
        yield made


def reader(publisher, **options):
    """A reader of a publisher in this process, which has to look for it."""
    thread = threading.Thread(target=publisher.wait_for, args=(publisher.readers() + 1, 5.0))
    thread.start()
    listening = TickReader(publisher.run, **options)
    thread.join()
    return listening


def test_ticks_arrive_whole_and_in_order(publisher):
    with reader(publisher) as listening:
        publish(publisher, range(3))
        publish(publisher, range(3, 5), 2, (1, 2, 3, 4, 5, 6, 7))
        ticks = listening.take()
        assert ticks["tick"].tolist() == [0, 1, 2, 3, 4] and np.all(np.diff(ticks["time_ns"]) > 0)
        for tick in range(5):
            hip, gimbal, force, memory = numbers(tick)
            np.testing.assert_array_equal(ticks["hip"][tick], hip)
            np.testing.assert_array_equal(ticks["gimbal"][tick], gimbal)
            np.testing.assert_array_equal(ticks["force"][tick], force)
            np.testing.assert_array_equal(ticks["memory"][tick, :11], memory.astype(np.float32))
        last = ticks[-1]
        counted = ("missed", "not_finite", "limited", "lost", "slewed", "ramped", "overrun", "down")
        assert [last[n] for n in counted] == [1, 2, 3, 4, 5, 6, 7, 2]
        assert (last["lateness_us"], last["compute_us"]) == (1.5, 20.25)
        assert (len(listening.take()), listening.lost, publisher.unsent) == (0, 0, 0)
        said = About.from_json(listening.about.to_json())
        assert said == listening.about and said.run in runs() and listening.is_alive()


def test_a_reader_that_sleeps_loses_the_oldest_and_nobody_else_does(publisher):
    with reader(publisher) as awake, reader(publisher) as asleep, reader(publisher, depth=1) as newest:
        taken = []
        for begin in range(0, 2000, 250):
            publish(publisher, range(begin, begin + 250))
            taken += awake.take()["tick"].tolist()
        assert taken == list(range(2000)) and awake.lost == 0 and publisher.unsent == 0
        late = asleep.take()["tick"]
        np.testing.assert_array_equal(late, np.arange(1500, 2000))  # 1.25 s at 400 Hz
        assert newest.take()["tick"].tolist() == [1999]
        publish(publisher, range(2000, 2600))
        assert (asleep.take()["tick"][0], asleep.lost, newest.take()["tick"][0]) == (2100, 100, 2599)
        assert newest.lost == 599


def test_a_reader_that_comes_late_gets_the_last_second(publisher):
    publish(publisher, range(900))
    with reader(publisher) as late:
        np.testing.assert_array_equal(late.take()["tick"], np.arange(400, 900))
        publish(publisher, range(900, 903))
        assert late.take()["tick"].tolist() == [900, 901, 902] and late.lost == 0
    with reader(publisher) as again:
        assert again.take()["tick"][-1] == 902


def test_what_was_said_can_be_read_after_the_end():
    with TickPublisher(about(f"ended-{os.getpid()}")) as publisher:
        listening = reader(publisher)
        publish(publisher, range(20))
    assert publisher.run not in runs()
    assert len(listening.take()) == 20
    (end,) = listening.events()
    assert (end.kind, end.tick, end.sentence) == ("end", 19, "the loop ended after 20 ticks")
    listening.close()


def test_runs_do_not_mix():
    with (
        TickPublisher(about(f"one-{os.getpid()}")) as one,
        TickPublisher(about(f"other-{os.getpid()}")) as other,
    ):
        with reader(one) as listening:
            publish(other, range(5))
            publish(one, range(7, 9))
            assert listening.take()["tick"].tolist() == [7, 8]
        assert {one.run, other.run} <= set(runs())
        with pytest.raises(InputError, match=f"the name {one.run} is taken, by another run"):
            TickPublisher(about(f"one-{os.getpid()}"))
    with pytest.raises(InputError, match="no run 'nowhere' is on the bus; allowed: "):
        TickReader("nowhere", patience=0.05)
    for name in ("", "a/b", ".hidden", "x" * 101):
        with pytest.raises(InputError, match="allowed: up to 100 letters"):
            Broadcast(name)
    with pytest.raises(InputError, match="readers is 7; allowed: 0 to 6"):
        Broadcast("a", readers=7)


def test_a_reader_that_wants_the_run_of_a_process_takes_no_other(publisher):
    with reader(publisher, process=os.getpid()) as own:
        assert own.about.process == os.getpid()
    telling = threading.Thread(target=publisher.wait_for, args=(1, 0.5))
    telling.start()
    with pytest.raises(InputError, match="no run") as refused:
        TickReader(publisher.run, 0.3, process=os.getppid())
    telling.join()
    assert not isinstance(refused.value, NotBegun)
    with subprocess.Popen(["true"]) as ended:
        os.waitid(os.P_PID, ended.pid, os.WEXITED | os.WNOWAIT)  # nobody has asked how it ended yet
        with pytest.raises(NotBegun, match="its process has ended"):
            TickReader(publisher.run, process=ended.pid)
    with pytest.raises(NotBegun, match="its process has ended"):
        TickReader(publisher.run, process=ended.pid)


def test_what_happens_is_told(publisher):
    with reader(publisher) as listening:
        told = Event(7, 12345, 1, "not_finite", "a force that is none")
        publisher.tell(told)
        publish(publisher, range(3))
        publisher.event("numbers", "x" * 1000)
        first, second = listening.events()
        assert first == told and (second.tick, second.finger, second.sentence) == (2, -1, "x" * 480)


def test_a_servo_puts_on_the_bus_what_it_records():
    """As fast as it can: all 60 ticks are kept for a reader that looks once it is over."""
    name, found = f"servo-{os.getpid()}", []
    board = hapjax.Object(hapjax.Plane(), hapjax.Surface(600.0, mu=0.5, damping=0.5))
    path = np.linspace([0.0, 0.0, 0.001], [0.01, 0.0, -0.004], 60)

    def listen():
        with TickReader(name, 60.0) as listening:
            while not any(e.kind == "end" for e in listening.events()):
                time.sleep(0.01)
            found.extend((listening.take(), listening.about))

    thread = threading.Thread(target=listen)
    thread.start()
    scene = hapjax.Scene({"board": board})
    result = run(scene, [VirtualDevice(path)], 0.06, realtime=False, broadcast=Broadcast(name, readers=1))
    thread.join(10)
    ticks, said = found
    np.testing.assert_array_equal(ticks["tick"], np.arange(60))
    np.testing.assert_array_equal(ticks["hip"], result.recording.hip)
    assert np.max(ticks["force"][:, 0, 2]) > 0.5 and result.unsent == 0
    assert (said.rate, said.objects, said.devices[0]["type"]) == (1000.0, (), "VirtualDevice")
    assert 'shape = "plane"' in said.scene


def test_the_scene_is_said_as_a_file_with_the_files_that_it_names(tmp_path):
    """It can be loaded where they are put together again; a mesh that is in no file cannot be said."""
    lines = ["v 0 0 0", "v 1 0 0", "v 0 1 0", "v 0 0 1", "f 1 3 2", "f 1 2 4", "f 1 4 3", "f 2 3 4", ""]
    for part in ("parts/a.obj", "b.obj"):
        (tmp_path / part).parent.mkdir(exist_ok=True)
        (tmp_path / part).write_text("\n".join(lines))
    stones = [hapjax.load_mesh(tmp_path / part, scale=0.01) for part in ("parts/a.obj", "b.obj")]
    scene = hapjax.Scene({f"stone{i}": hapjax.Object(stone) for i, stone in enumerate(stones)})
    text, files, unsaid = scene_file(scene)
    assert unsaid == "" and set(files) == {"parts/a.obj", "b.obj"}
    (tmp_path / "again.toml").write_text(text)
    again = hapjax.load_scene(tmp_path / "again.toml").object["stone0"].shape
    assert isinstance(again, hapjax.Mesh)
    np.testing.assert_array_equal(again.vertices, stones[0].vertices)
    tips = [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]
    loose = hapjax.Mesh(tips, [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    text, files, unsaid = scene_file(hapjax.Scene({"stone": hapjax.Object(loose)}))
    assert (text, files) == ("", {}) and unsaid.startswith("object.stone.file is missing")
