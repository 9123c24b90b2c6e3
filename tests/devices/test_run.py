"""`hapjax run`: the processes of a session begin, are watched, and end in order, in whatever way."""

import json
import os
import re
import signal
import struct
import subprocess
import sys
import threading
import time
from contextlib import suppress
from ipaddress import ip_address
from pathlib import Path
from urllib.request import urlopen

import numpy as np
import pytest

import hapjax
from bus_cases import about, publish
from hapjax.cli import main
from hapjax_devices import DeviceError, TickPublisher, TickReader
from hapjax_devices.bus import services
from hapjax_devices.session import supervisor

TABLE = "[object.table]\nshape = 'plane'\n[object.table.surface]\nmu = 0.5\nstiffness = 1000.0\n"


@pytest.fixture
def table(tmp_path):
    (tmp_path / "table.toml").write_text(TABLE)
    return tmp_path / "table.toml"


@pytest.fixture
def recorders(monkeypatch):
    """The recorders that are started."""
    started, real = [], supervisor.RecorderProcess

    def start(*arguments):
        started.append(real(*arguments))
        return started[-1]

    monkeypatch.setattr(supervisor, "RecorderProcess", start)
    return started


def meanwhile(work):
    """Do something beside a run in this process; its failure is one of the test."""
    failed = []

    def tried():
        try:
            work()
        except BaseException as error:
            failed.append(error)
            os.kill(os.getpid(), signal.SIGTERM)

    thread = threading.Thread(target=tried)
    thread.start()
    return thread, failed


def ticks_until(reader, count):
    """Read until so many more ticks have come."""
    until = reader.last + count
    while reader.last < until:
        assert reader.is_alive()
        reader.take()
        time.sleep(0.01)


@pytest.mark.slow
def test_a_session_is_recorded_and_ends_when_asked(table, tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    name, out, figures = f"asked-{os.getpid()}", tmp_path / "a.mcap", tmp_path / "a.json"
    servo = []

    def ask():
        with TickReader(name, 60.0) as reader:
            servo.append(reader.about.process)
            ticks_until(reader, 300)
            os.kill(os.getpid(), signal.SIGTERM)

    thread, failed = meanwhile(ask)
    options = ["--name", name, "--rate", "400", "--record", str(out), "--json", str(figures)]
    options += ["--max-force", "0.05"]
    code = main(["run", str(table), "--device", "virtual", "virtual", *options])
    thread.join()
    assert not failed and code == 0, failed
    found = json.loads(figures.read_text())
    recording = hapjax.Recording.load(out)
    assert recording.hip_t is not None and recording.force is not None
    assert found["ticks"] == len(recording.hip_t) > 300 and found["devices"] == ["virtual"] * 2
    np.testing.assert_allclose(np.diff(recording.hip_t), 1 / 400)
    largest = np.linalg.norm(recording.force, axis=2).max(axis=0)
    assert [each["max"] for each in found["force"]] == pytest.approx(largest.tolist(), rel=1e-6)
    (end,) = [event for event in found["events"] if event["kind"] == "end"]
    over = [event for event in found["events"] if event["kind"] == "limited"]
    assert end["finger"] is None and {event["finger"] for event in over} == {0, 1}
    with pytest.raises(ProcessLookupError):
        os.kill(servo[0], 0)
    said = capsys.readouterr()
    assert f"{found['ticks']} ticks" in said.out
    stages = [
        "loading the library",
        "reading",
        "hapjax: compiling; the fingers feel the scene once that is done\n",
    ]
    assert re.fullmatch(".*".join(["", *map(re.escape, stages), ""]), said.err, re.DOTALL)
    for event in over:
        assert f"{event['tick'] / 400:.3f} s: finger {event['finger']}: {event['sentence']}\n" in said.err


@pytest.mark.slow
def test_the_recorders_death_leaves_the_servo_going_and_the_servos_is_noticed(
    table, tmp_path, recorders, capfd
):
    name, out = f"killed-{os.getpid()}", tmp_path / "a.mcap"

    def kill():
        with TickReader(name, 60.0) as reader:
            ticks_until(reader, 100)
            recorders[0].kill()
            ticks_until(reader, 200)
            os.kill(reader.about.process, signal.SIGKILL)

    thread, failed = meanwhile(kill)
    code = main(["run", str(table), "--name", name, "--device", "virtual", "--record", str(out)])
    thread.join()
    assert not failed and code == 1, failed
    lines = capfd.readouterr().err.splitlines()  # others, of ticks that came too late, may be among them
    said = [line for line in lines if "recorder" in line or "SIGKILL" in line]
    assert len(said) == 2 and f"{out}: the recorder has ended (exit code -9; hapjax recover" in said[0], lines
    assert "killed (SIGKILL) after tick" in said[1]
    assert int(said[1].rsplit(" ", 1)[1]) > 200


@pytest.mark.slow
def test_what_is_estimated_is_handed_over_when_asked_and_no_tick_is_lost(table, tmp_path, capfd):
    name, figures, truth = f"tuned-{os.getpid()}", tmp_path / "a.json", tmp_path / "truth.toml"
    truth.write_text(TABLE.replace("0.5", "0.3").replace("1000.0", "600.0"))
    taken = []

    def ask():
        with TickReader(name, 60.0) as reader:
            first = min(at for at, _ in reader.about.live.values())
            until, changed = time.monotonic() + 90, None
            while changed is None or taken[-1]["tick"][-1] < changed + 2000:  # it presses, and slips
                assert reader.is_alive() and time.monotonic() < until
                if changed is None:
                    os.kill(os.getpid(), signal.SIGUSR1)
                time.sleep(0.3)
                ticks = reader.take()
                taken.append(ticks)
                new = np.flatnonzero(ticks["memory"][:, first] != taken[0]["memory"][0, first])
                changed = int(ticks["tick"][new[0]]) if changed is None and len(new) else changed
            taken.append(changed)
            os.kill(os.getpid(), signal.SIGTERM)

    thread, failed = meanwhile(ask)
    options = ["--tune", "--truth", str(truth), "--window", "1", "--name", name, "--json", str(figures)]
    code = main(["run", str(table), "--device", "virtual", *options])
    thread.join()
    assert not failed and code == 0, failed
    changed, ticks = taken.pop(), np.concatenate(taken)
    np.testing.assert_array_equal(np.diff(ticks["tick"]), 1)
    found = json.loads(figures.read_text())
    (event,) = [event for event in found["events"] if event["kind"] == "numbers"]
    assert f"from tick {changed} on" in event["sentence"]
    estimates = [each["parameters"] for each in found["tuned"] if "parameters" in each]
    handed = [each["adopted"] for each in found["tuned"] if each.get("adopted")]
    assert handed == [changed] and f"count from tick {changed}" in capfd.readouterr().out
    mu, stiffness = (estimates[0][f"object.table.surface.{n}"]["estimate"] for n in ("mu", "stiffness"))
    assert mu == pytest.approx(0.3, rel=0.02) and stiffness == pytest.approx(600, rel=0.02)
    # The force is that of the old numbers until then, and of the new ones from then on.
    for part, held, slope in (
        (ticks["tick"] < changed, 0.5, 1000.0),
        (ticks["tick"] >= changed, mu, stiffness),
    ):
        normal, along = ticks["force"][part, 0, 2], np.abs(ticks["force"][part, 0, 0])
        depth = np.maximum(-ticks["hip"][part, 0, 2], 0)
        np.testing.assert_allclose(normal, slope * depth, atol=5e-3)  # the device's steps
        assert along.max() == pytest.approx(held * normal.max(), abs=5e-3)


@pytest.mark.slow
def test_a_viewer_listens_on_this_computer_alone_and_its_death_leaves_the_servo_going(
    table, monkeypatch, capfd
):
    pytest.importorskip("viser", reason="the viewer needs the extra viewer")
    name, viewers, real = f"viewed-{os.getpid()}", [], supervisor.viewer.ViewerProcess

    def start(*arguments):
        viewers.append(real(*arguments))
        return viewers[-1]

    monkeypatch.setattr(supervisor.viewer, "ViewerProcess", start)
    said = []

    def look():
        with TickReader(name, 60.0) as reader:
            until = time.monotonic() + 60
            while not (found := re.search(r"http://127\.0\.0\.1:(\d+)\n", "".join(said))):
                assert time.monotonic() < until and reader.is_alive()
                time.sleep(0.1)
                said.append(capfd.readouterr().out)
            with urlopen(found[0].strip(), timeout=30) as page:
                said.append(page.read().decode())
            assert listening(viewers[0].pid) == {("127.0.0.1", int(found[1]))}
            assert reader.about.live.keys() == {f"object.table.surface.{n}" for n in ("mu", "stiffness")}
            os.kill(viewers[0].pid, signal.SIGKILL)
            reader.take()
            ticks_until(reader, 300)
            os.kill(os.getpid(), signal.SIGTERM)

    thread, failed = meanwhile(look)
    code = main(["run", str(table), "--name", name, "--device", "virtual", "--view", "--port", "0"])
    thread.join()
    assert not failed and code == 1, failed
    assert "<html" in said[-1] and "the viewer has ended (exit code -9); the servo" in capfd.readouterr().err


def listening(process):
    """The addresses at which a process listens for TCP."""
    own, found = set(), set()
    for number in os.listdir(f"/proc/{process}/fd"):
        with suppress(FileNotFoundError):  # closed meanwhile
            own.add(os.readlink(f"/proc/{process}/fd/{number}"))
    for version, word in (("tcp", "<I"), ("tcp6", "<4I")):
        for line in Path(f"/proc/net/{version}").read_text().splitlines()[1:]:
            _, local, _, state, *_, inode = line.split()[:10]
            if state == "0A" and f"socket:[{inode}]" in own:
                host, port = local.split(":")
                packed = struct.pack(word, *struct.unpack(word.replace("<", ">"), bytes.fromhex(host)))
                found.add((str(ip_address(packed)), int(port, 16)))
    return found


def test_asked_to_end_before_it_begins_it_ends(table, tmp_path, monkeypatch, capfd):
    real, record = supervisor.ServoProcess, tmp_path / "a.mcap"

    def start(session):
        os.kill(os.getpid(), signal.SIGTERM)
        return real(session)

    monkeypatch.setattr(supervisor, "ServoProcess", start)
    name = f"early-{os.getpid()}"
    assert main(["run", str(table), "--name", name, "--device", "virtual", "--record", str(record)]) == 0
    assert capfd.readouterr() == ("", "") and not record.exists()


@pytest.mark.parametrize("name", ["SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT", "SIGTSTP"])
def test_a_session_ends_at_each_signal_that_would_end_or_suspend_it(name):
    """Suspended, it would watch over nothing while the servo pushes on."""
    number = getattr(signal, name)
    before = signal.getsignal(number)
    with supervisor._asked() as asked:
        assert signal.getsignal(number) not in (before, signal.SIG_DFL)
        signal.raise_signal(number)
        assert supervisor._to_end(asked)
    assert signal.getsignal(number) is before


class Ended:
    """A servo that has ended before it began."""

    pid, how = os.getpid(), -signal.SIGKILL

    def __init__(self, session):
        pass

    def code(self):
        return self.how

    def stop(self):
        pass

    def wait(self, timeout):
        return self.how, ()


@pytest.mark.parametrize(
    ("how", "words"), [(-signal.SIGTERM, "killed (SIGTERM)"), (128 + signal.SIGTERM, "ended (SIGTERM)")]
)
def test_a_servo_that_somebody_else_ends_before_it_begins_is_told_of(how, words, table, monkeypatch, capfd):
    monkeypatch.setattr(supervisor, "ServoProcess", type("Servo", (Ended,), {"how": how}))
    assert main(["run", str(table), "--device", "virtual", "--name", f"ended-{os.getpid()}"]) == 1
    out, error = capfd.readouterr()
    assert out == "" and f"hapjax: the servo's process was {words} before its first tick\n" in error


def test_falcons_of_a_servo_that_was_killed_are_told_to_push_no_more(table, monkeypatch, capfd):
    told = []

    def let_go(serial):
        told.append(serial)
        if serial == "FT1":
            raise DeviceError("the Falcon FT1 is not attached")

    monkeypatch.setattr(supervisor, "ServoProcess", Ended)
    monkeypatch.setattr(supervisor, "let_go", let_go)
    devices = table.parent / "devices.toml"
    falcons = [f"[[device]]\ntype = 'falcon'\nserial = '{serial}'\n" for serial in ("FT1", "FT2")]
    devices.write_text("[[device]]\ntype = 'virtual'\n" + "".join(falcons))
    assert main(["run", str(table), "--devices", str(devices), "--name", f"falcons-{os.getpid()}"]) == 1
    assert told == ["FT1", "FT2"]
    out, error = capfd.readouterr()
    assert out == "" and "FT1 is not attached; it may push on" in error and "SIGKILL" in error


@pytest.mark.slow
def test_a_device_that_is_not_there_ends_it_with_a_sentence(table, tmp_path, capfd):
    file = tmp_path / "devices.toml"
    file.write_text("[[device]]\ntype = 'inverse3'\nurl = 'ws://127.0.0.1:9'\n")
    record = tmp_path / "a.mcap"
    name = f"absent-{os.getpid()}"
    arguments = ["--devices", str(file), "--record", str(record), "--seconds", "1", "--name", name]
    assert main(["run", str(table), *arguments]) == 1
    out, error = capfd.readouterr()
    assert error.count("\n") == 1 and "no program listens there" in error and out == ""
    assert not record.exists()


REFUSED = {
    "no scene": (["run"], ["missing"]),
    "a scene that is none": (["run", "none.toml"], ["none.toml"]),
    "a recording that exists": (["run", "table.toml", "--record", "there.mcap"], ["there.mcap", "new name"]),
    "another recording": (["run", "table.toml", "--record", "new.npz"], ["new.npz", "*.mcap"]),
    "no folder": (["run", "table.toml", "--json", "none/a.json"], ["none"]),
    "no device": (["run", "table.toml", "--device", "wand"], ["wand", "virtual"]),
    "no name": (["run", "table.toml", "--name", "a b"], ["'a b'", "letters"]),
    "a lazy display": (["run", "table.toml", "--display", "0"], ["display is 0", "0.1 to 10"]),
    "no truth": (["run", "table.toml", "--tune"], ["--tune", "--truth"]),
    "no tuning": (["run", "table.toml", "--adopt"], ["--adopt", "--tune"]),
    "a truth that is none": (["run", "table.toml", "--tune", "--truth", "none.toml"], ["none.toml"]),
    "no viewer": (["run", "table.toml", "--port", "0"], ["--port", "--view"]),
    "a port": (["run", "table.toml", "--view", "--port", "65536"], ["port is 65536", "0"]),
    "an address": (
        ["run", "table.toml", "--device", "browser", "--host", "192.0.2.1"],
        ["192.0.2.1", "address"],
    ),
    "a force": (["run", "table.toml", "--max-force", "0"], ["force of the limits is 0.0 N", "above 0"]),
    "a slew": (["run", "table.toml", "--slew", "-5"], ["slew of the limits is -5.0 N/s", "above 0"]),
    "a ramp": (["run", "table.toml", "--ramp", "-1"], ["ramp of the limits is -1.0 s", "0 or above"]),
    "a rate": (["run", "table.toml", "--rate", "5000"], ["rate is 5000", "100 to 4000"]),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_is_refused_before_anything_starts(case, table, monkeypatch, capsys):
    monkeypatch.chdir(table.parent)
    (table.parent / "there.mcap").touch()
    for process in ("ServoProcess", "RecorderProcess", "TunerProcess"):
        monkeypatch.setattr(supervisor, process, lambda *_: pytest.fail("started"))
    arguments, words = REFUSED[case]
    assert main(arguments) == 2
    out, error = capsys.readouterr()
    assert out == "" and error.count("\n") == 1
    for word in words:
        assert word in error


def test_a_name_that_is_taken_is_refused_before_anything_starts(table, tmp_path, monkeypatch, capsys):
    for process in ("ServoProcess", "RecorderProcess"):
        monkeypatch.setattr(supervisor, process, lambda *_: pytest.fail("started"))
    name, record = f"taken-{os.getpid()}", tmp_path / "a.mcap"
    with TickPublisher(about(name)) as publisher:
        told = threading.Thread(target=publisher.wait_for, args=(1, 5.0))
        told.start()
        reader = TickReader(name)
        told.join()
        assert main(["run", str(table), "--name", name, "--record", str(record)]) == 2
    assert main(["run", str(table), "--name", name, "--record", str(record)]) == 2  # it is read still
    reader.close()
    services.check_free(name)
    out, error = capsys.readouterr()
    assert out == "" and error.count(f"hapjax: the name {name} is taken") == error.count("\n") == 2


class Refused:
    """A servo whose name was taken while it imported."""

    def __init__(self, session):
        self._process = subprocess.Popen(["sh", "-c", "sleep 0.5; exit 2"])
        self.pid, self.code, self.stop = self._process.pid, self._process.poll, self._process.terminate

    def wait(self, timeout):
        return self._process.wait(timeout), ()


def test_of_two_runs_of_a_name_that_begin_at_once_one_is_refused_and_has_nothing_of_the_other(
    table, tmp_path, monkeypatch, capfd
):
    """That has another number of fingers."""
    figures, started = tmp_path / "a.json", []
    name, of = f"both-{os.getpid()}", ["--device", "virtual", "--record", str(tmp_path / "a.mcap"), "--tune"]

    class Part:
        def __init__(self, *arguments):
            started.append(arguments[-1])

        def end(self, *patience):
            return 2, ""

        def code(self):
            return None

        said, stop = list, code

    monkeypatch.setattr(
        supervisor, "ServoProcess", lambda session: started.append(Refused(session)) or started[0]
    )
    for process in ("RecorderProcess", "TunerProcess"):
        monkeypatch.setattr(supervisor, process, Part)
    monkeypatch.setattr(supervisor.viewer, "ViewerProcess", Part)
    monkeypatch.setattr(supervisor.viewer, "check", lambda *_: None)
    monkeypatch.setattr(services, "check_free", lambda run: None)
    options = ["--name", name, "--json", str(figures), "--truth", str(table), "--view", "--port", "0"]
    with TickPublisher(about(name)) as publisher:
        publish(publisher, range(5))
        over = threading.Event()

        def tell():
            while not over.is_set():
                publisher.wait_for(9, 0.05)

        telling = threading.Thread(target=tell)
        telling.start()
        try:
            assert main(["run", str(table), *of, *options]) == 2
        finally:
            over.set()
            telling.join()
    assert capfd.readouterr() == ("", "") and json.loads(figures.read_text())["ticks"] == 0
    assert started[1:] == [started[0].pid] * 3


def test_it_speaks_as_often_as_it_is_asked_to(monkeypatch, capsys):
    now = [0.0]
    monkeypatch.setattr(supervisor.time, "monotonic", lambda: now[0])
    for rate, count in ((0.0, 0), (2.0, 6), (10.0, 30)):
        display = supervisor.Display(rate)
        for _ in range(60):
            now[0] += 0.05 + 1e-9
            display.show(lambda: "felt")
        assert capsys.readouterr().out.count("felt") == pytest.approx(count, abs=1)
