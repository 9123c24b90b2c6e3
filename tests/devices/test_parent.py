"""A process that does not outlive the one that started it."""

import subprocess
import sys
import time

import pytest

from hapjax_devices.session import parent

CHILD = """if True:
    import os, runpy, signal, sys
    signal.alarm(60)
    if sys.argv[2] == "late":
        sys.stdin.readline()
    runpy.run_path(sys.argv[3])["end_with"](int(sys.argv[1]))
    print("begun", flush=True)
    signal.pause()
"""
STARTER = """if True:
    import os, subprocess, sys
    subprocess.Popen([sys.executable, "-c", sys.argv[1], str(os.getpid()), *sys.argv[2:]]).wait()
"""


@pytest.mark.parametrize("when", ["early", "late"])
def test_a_process_ends_with_the_one_that_started_it(when):
    """Also where that has ended while the process was still importing."""
    command = [sys.executable, "-c", STARTER, CHILD, when, parent.__file__]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as starter:
        assert starter.stdout is not None
        if when == "early":
            assert starter.stdout.readline() == "begun\n"
        else:
            time.sleep(0.1)  # it has started the other, as a rule
        starter.kill()
        starter.wait()
        out, _ = starter.communicate("\n", timeout=20)  # until the other has ended, too
    assert out == ""
