"""Who starts the processes of a session, watches over them, and ends them in order."""

import select
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from hapjax import InputError
from hapjax.files import check_writable, write_json
from hapjax.tuning.settings import Tuning

from .. import viewer
from ..bus import TickReader, services
from ..device import DeviceError
from ..ending import ENDING
from ..falcon import let_go
from ..recorder import RecorderProcess
from .dealt import dealt
from .figures import Figures
from .process import ServoProcess
from .settings import Session
from .tuner import TunerProcess

PERIOD = 0.05  # s between two looks
_PATIENCE = 600.0  # s that a recorder waits for a servo that waits for its user to home a device
_END = 10.0  # s that a process is given to end
_COUNTED = ("end", "missed", "ramped")  # events that the counts and the summary tell of, and no sentence


def supervise(
    session: Session,
    record: Path | None,
    display: float,
    file: Path | None,
    tuning: Tuning | None = None,
    view: tuple[str, int] | None = None,
) -> int:
    """Run a session until its time is over, or one of `ENDING` comes, Ctrl-C, Ctrl-Z or SIGTERM say; returns the exit code.

    0: it went as asked; 1: the servo, or a device that cannot come back, failed, or the recorder did; 2: the servo refused
    its input.

    **Arguments:** `session`; `record`, a new file that it is recorded to; `display`, how many lines a second are printed on
    a terminal, 0.1 to 10; `file` for the figures; `tuning`, what is to be estimated meanwhile: it is handed over at
    SIGUSR1, and where Enter is pressed in the terminal; `view`, host and port of a viewer's page.

    **Raises:** `InputError`, before anything is started, also where another run has the name.
    """
    if not 0.1 <= display <= 10:
        raise InputError(f"display is {display} lines a second; allowed: 0.1 to 10")
    if record is not None:
        _check_new(record)
    if tuning is not None:
        tuning.check(session.loaded, len(session.devices))
    if file is not None:
        check_writable(file)
    if view is not None:
        viewer.check(*view)
    services.check_free(session.run)
    tables, order = dealt(session.devices)
    session = replace(session, devices=tables)
    if order:
        _say(order)
    with _asked() as asked:
        watch = _Watch(session, record, Display(display if sys.stdout.isatty() else 0.0), tuning, view)
        code = watch.until(asked)
        figures = watch.figures()
        _summary(figures)
        if file is not None:
            write_json(file, figures)
    return code


class Display:
    """Prints a line now and then.

    **Arguments:** `rate`, how many a second; 0: none.
    """

    def __init__(self, rate: float):
        self._rate, self._next = rate, 0.0

    def show(self, line: Callable[[], str]) -> None:
        """Print the line if it is time to."""
        if self._rate and time.monotonic() >= self._next:
            self._next = time.monotonic() + 1 / self._rate
            print(line(), flush=True)


class _Watch:
    """A session's processes, and what is known of them."""

    def __init__(
        self,
        session: Session,
        record: Path | None,
        display: Display,
        tuning: Tuning | None,
        view: tuple[str, int] | None,
    ):
        self._session, self._record, self._display = session, record, display
        self._servo = ServoProcess(session)
        run, servo = session.run, self._servo.pid
        self._recorder = None if record is None else RecorderProcess(run, record, _PATIENCE, servo)
        self._tuner = None if tuning is None else TunerProcess(tuning, servo)
        self._viewer = None if view is None else viewer.ViewerProcess(run, *view, _PATIENCE, servo)
        self._tuned: list[dict[str, Any]] = []
        self._figures = Figures(len(session.devices))
        self._said: list[dict[str, Any]] = []
        self._refused: tuple[str, ...] = ()
        self._failed = False

    def until(self, asked: list[int]) -> int:
        """Watch until the servo has ended, by itself or because of a signal in `asked`; the exit code."""
        reader = self._reader(asked)
        if reader is not None:
            with reader:
                while self._servo.code() is None and not _to_end(asked):
                    self._look(reader)
                    self._tune(asked)
                    time.sleep(PERIOD)
                self._servo.stop()
                code = self._ended()
                self._look(reader)
        else:
            self._servo.stop()
            code = self._ended()
        if self._tuner is not None:
            self._tuner.end()
        if self._viewer is not None:
            self._viewer.end(_END)
        unbegun = code > 128 or (code < 0 and reader is None)
        if _to_end(asked) and unbegun:
            code = 0
        elif code < 0 or code > 128:
            code = self._cut_short(code)
        self._finish_recording(code == 0 and reader is None)
        return 1 if code == 0 and self._failed else code

    def figures(self) -> dict[str, Any]:
        """What there is to say of the session at its end."""
        session = self._session
        return {
            "run": session.run,
            "scene": session.scene,
            "devices": [device["type"] for device in session.devices],
            "rate": session.rate,
            "seconds": self._figures.ticks / session.rate,
            **self._figures.to_dict(),
            "events": self._said,
            "refused": list(self._refused),
            "tuned": self._tuned,
            "record": None if self._record is None else str(self._record),
        }

    def _reader(self, asked: list[int]) -> TickReader | None:
        """A reader of the servo's ticks, once it has begun; `None` where it does not."""
        if sys.stderr.isatty():
            _say("compiling; the fingers feel the scene once that is done")
        while self._servo.code() is None and not _to_end(asked):
            try:
                return TickReader(self._session.run, 0.5, process=self._servo.pid)
            except InputError:
                continue  # it imports, compiles, or waits for a device
        return None

    def _look(self, reader: TickReader) -> None:
        """Take what has come, and say what is new."""
        self._figures.add(reader.take())
        for event in reader.events():
            finger = None if event.finger < 0 else event.finger
            said = {"tick": event.tick, "finger": finger, "kind": event.kind, "sentence": event.sentence}
            self._said.append(said)
            if event.kind not in _COUNTED:
                seconds = max(event.tick, 0) / self._session.rate
                _say(f"{seconds:.3f} s: {event.said(len(self._session.devices))}")
        if self._recorder is not None and not self._recorder.is_alive():
            self._finish_recording(False)
        if self._viewer is not None and self._viewer.code():  # 0: it has seen the run's end
            _say(f"the viewer has ended (exit code {self._viewer.code()}); the servo goes on")
            self._viewer, self._failed = None, True
        if self._figures.ticks:
            self._display.show(lambda: self._figures.line(self._session.rate))

    def _tune(self, asked: list[int]) -> None:
        """Say what is estimated, and have it handed over when that is asked for."""
        tuner = self._tuner
        if tuner is None:
            return
        for found in tuner.said():
            self._tuned.append(found)
            print(
                f"estimated, {found['sentence']}" if "parameters" in found else found["sentence"], flush=True
            )
        if signal.SIGUSR1 in asked or _entered():
            asked[:] = [number for number in asked if number != signal.SIGUSR1]
            tuner.adopt()
        if tuner.code() is not None:
            _say(f"the process that estimates has ended (exit code {tuner.code()}); the servo goes on")
            tuner.end()
            self._tuner, self._failed = None, True

    def _cut_short(self, code: int) -> int:
        """Say that a signal from elsewhere has ended the servo, which has let go by itself where it could; the exit code."""
        killed = code < 0
        if killed:
            self._let_go()
        ticks, name = self._figures.ticks, signal.Signals(-code if killed else code - 128).name
        when = f"after tick {ticks - 1}" if ticks else "before its first tick"
        _say(f"the servo's process was {'killed' if killed else 'ended'} ({name}) {when}")
        return 1

    def _let_go(self) -> None:
        """Stop those devices that go on pushing when their process is killed."""
        for table in self._session.devices:
            if table["type"] == "falcon":
                try:
                    let_go(table.get("serial"))
                except DeviceError as error:
                    _say(f"{error}; it may push on: switch it off")

    def _ended(self) -> int:
        code, self._refused = self._servo.wait(_END)
        return code

    def _finish_recording(self, in_vain: bool) -> None:
        """Let the recorder end, which it does by itself where the run has; say how it went where it went wrong."""
        recorder, self._recorder = self._recorder, None
        if recorder is None:
            return
        if in_vain or not self._figures.ticks:
            recorder.stop()
        code, said = recorder.end(_END)
        if code != 0 and self._figures.ticks:
            self._failed = True
            how = (
                said.removeprefix("hapjax: ") or f"exit code {code}; hapjax recover makes whole what there is"
            )
            _say(f"{self._record}: the recorder has ended ({how})")


@contextmanager
def _asked() -> Iterator[list[int]]:
    """The signals that asked for the end so far, while they are listened to."""
    found: list[int] = []
    listened = (*ENDING, signal.SIGUSR1)
    before = {number: signal.signal(number, lambda n, _: found.append(n)) for number in listened}
    try:
        yield found
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _to_end(asked: list[int]) -> bool:
    """Whether one of the signals asks for the end."""
    return any(number in ENDING for number in asked)


def _entered() -> bool:
    """Whether Enter was pressed in the terminal."""
    if not sys.stdin or not sys.stdin.isatty() or not select.select([sys.stdin], [], [], 0)[0]:
        return False
    return bool(sys.stdin.readline())


def _check_new(record: Path) -> None:
    """Refuse what is no new MCAP file."""
    if record.suffix.lower() != ".mcap":
        raise InputError(f"{record}: expected a recording named *.mcap")
    check_writable(record)
    if record.exists():
        raise InputError(f"{record}: exists; allowed: a recording with a new name")


def _summary(figures: dict[str, Any]) -> None:
    """Say how it was, in two lines."""
    if not figures["ticks"]:
        return
    late, felt = figures["lateness_us"], figures["force"]
    for sentence in figures["refused"]:
        _say(sentence)
    print(
        f"{figures['ticks']} ticks in {figures['seconds']:.1f} s, {figures['missed']} missed; late by "
        f"{late['p50']:.1f} us (p50), {late['p99.9']:.0f} us (p99.9), {late['max']:.0f} us (max)"
    )
    if figures["unseen"]:
        _say(f"{figures['unseen']} ticks are not in these figures: the command was late to see them")
    print("felt at most: " + ", ".join(f"{each['max']:.2f} N" for each in felt))


def _say(sentence: str) -> None:
    print(f"hapjax: {sentence}", file=sys.stderr, flush=True)
