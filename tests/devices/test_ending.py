"""However a loop ends, the last that a device is written is no force."""

import signal
import subprocess
import sys

import pytest

import ending_cases
from hapjax_devices.ending import Ending

CODES = {
    "exception": 1,
    "SIGINT": -signal.SIGINT,
    "SIGTERM": 128 + signal.SIGTERM,
    "SIGHUP": 128 + signal.SIGHUP,
    "SIGTSTP": 128 + signal.SIGTSTP,
    "hang": 128 + signal.SIGTERM,
    "stop": 0,
    "SIGKILL": -signal.SIGKILL,
}


@pytest.fixture(scope="module")
def ended(tmp_path_factory):
    """All of them at once: most of the time each of them is started, not run. Its code, and what its device was written."""
    folder = tmp_path_factory.mktemp("ended")
    started = {}
    for way in CODES:
        command = [sys.executable, ending_cases.__file__, str(folder / way), way]
        started[way] = subprocess.Popen(
            command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, start_new_session=True
        )
    try:
        for way, again in (("hang", signal.SIGTERM), ("stop", signal.SIGCONT)):
            assert started[way].stdout.readline()
            started[way].send_signal(again)
            if way == "stop":  # it may not have been stopped yet when it was told to go on
                while started[way].poll() is None:
                    started[way].send_signal(again)
                    try:
                        started[way].wait(0.5)
                    except subprocess.TimeoutExpired:
                        continue
        codes = {way: process.wait(120) for way, process in started.items()}
    finally:
        for process in started.values():
            process.kill()
            process.communicate()
    return {way: (codes[way], (folder / way).read_text().split()) for way in CODES}


@pytest.mark.slow
@pytest.mark.parametrize("way", [way for way in CODES if way != "SIGKILL"])
def test_the_last_force_is_none_and_the_device_is_closed(ended, way):
    code, written = ended[way]
    assert code == CODES[way]
    assert float(written[ending_cases.PUSHES - 1]) == pytest.approx(2.0)  # it did push
    assert written[-1] == "closed" and float(written[-2]) == 0
    if way != "stop":  # between two ticks: at once
        assert len(written) == ending_cases.PUSHES + 2


@pytest.mark.slow
def test_of_a_killed_loop_only_the_device_itself_can_take_the_force_off(ended):
    """Why a device needs a watchdog of its own."""
    code, written = ended["SIGKILL"]
    assert code == CODES["SIGKILL"] and float(written[-1]) == pytest.approx(2.0)


@pytest.mark.slow
def test_a_loop_that_was_stopped_goes_on_with_no_force_and_lets_in_anew(ended):
    """At 500 Hz; whatever time it was stopped, it was more than 20 ticks, or it is not looked at."""
    _, written = ended["stop"]
    forces = [float(x) for x in written[:-1]]
    after = forces[ending_cases.PUSHES :]
    if after[0] == 0:
        assert after[:6] == pytest.approx([0.0, 0.4, 0.8, 1.2, 1.6, 2.0])
    else:
        pytest.skip("it was told to go on within 20 ticks")


def test_handlers_of_the_program_stay_and_are_put_back():
    before, mine = signal.getsignal(signal.SIGTERM), signal.signal(signal.SIGHUP, print)
    try:
        with Ending() as ending:
            assert signal.getsignal(signal.SIGHUP) is print
            assert signal.getsignal(signal.SIGTERM) is not before
            with pytest.raises(SystemExit) as caught:  # before the loop: at once
                signal.raise_signal(signal.SIGTERM)
            assert caught.value.code == 128 + signal.SIGTERM
        raise AssertionError
    except SystemExit:
        pass  # it was asked for, and nobody has seen it yet
    finally:
        assert signal.getsignal(signal.SIGTERM) is before
        signal.signal(signal.SIGHUP, mine)
    with pytest.raises(KeyboardInterrupt), Ending() as ending, ending.between() as check:
        signal.raise_signal(signal.SIGINT)
        check()


def test_what_comes_while_all_is_let_go_waits_for_it():
    done = []
    with pytest.raises(SystemExit), Ending() as ending:
        with ending.between():
            pass
        signal.raise_signal(signal.SIGTERM)
        signal.raise_signal(signal.SIGTERM)
        done.append("let go")
    assert done == ["let go"]
