"""The doctor: what it says follows from what the system's files say and from what it measures."""

import json
from contextlib import contextmanager

import numpy as np
import pytest

from hapjax import InputError
from hapjax.cli import main
from hapjax_devices import DeviceError, doctor
from hapjax_devices.doctor import system, timing
from helpers import followed

CPU = "sys/devices/system/cpu"


def machine(root, files):
    for name, text in files.items():
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_text(text + "\n")
    return root


# Which look, at a machine with these files, what it finds, and a word of the sentence and of the advice.
FOUND = {
    "nothing readable": (system.throttle, {}, "unknown", "not readable", ""),
    "throttled": (
        system.throttle,
        {"proc/sys/kernel/sched_rt_runtime_us": "300000"},
        "poor",
        "300 ms",
        "sysctl",
    ),
    "free": (system.throttle, {"proc/sys/kernel/sched_rt_runtime_us": "-1"}, "good", "without end", ""),
    "as usual": (system.throttle, {"proc/sys/kernel/sched_rt_runtime_us": "950000"}, "good", "950 ms", ""),
    "real-time": (system.kernel, {"sys/kernel/realtime": "1"}, "good", "PREEMPT_RT", ""),
    "dynamic": (
        system.kernel,
        {"proc/version": "#1 SMP PREEMPT_DYNAMIC"},
        "good",
        "as it was built",
        "preempt=full",
    ),
    "full": (
        system.kernel,
        {"proc/version": "#1 SMP PREEMPT_DYNAMIC", "proc/cmdline": "quiet preempt=full"},
        "good",
        "PREEMPT_DYNAMIC, full",
        "",
    ),
    "server": (system.kernel, {"proc/version": "Linux 6.1 #1 SMP"}, "poor", "not say", "PREEMPT_RT"),
    "no governor": (system.governor, {}, "unknown", "elsewhere", ""),
    "powersave": (
        system.governor,
        {
            f"{CPU}/cpu0/cpufreq/scaling_governor": "performance",
            f"{CPU}/cpu1/cpufreq/scaling_governor": "powersave",
        },
        "poor",
        "powersave",
        "cpupower",
    ),
    "performance": (
        system.governor,
        {f"{CPU}/cpu0/cpufreq/scaling_governor": "performance"},
        "good",
        "full",
        "",
    ),
    "isolated": (system.cores, {f"{CPU}/isolated": "3"}, "good", "4 processors may be used; apart", ""),
}


@pytest.mark.parametrize(("look", "files", "state", "words", "advice"), FOUND.values(), ids=FOUND)
def test_settings_are_told_with_what_to_do(tmp_path, monkeypatch, look, files, state, words, advice):
    monkeypatch.setattr(system.os, "sched_getaffinity", lambda process: {0, 1, 2, 3})
    check = look(machine(tmp_path, files))
    assert (check.state, bool(check.advice)) == (state, bool(advice)), check
    assert words in check.sentence and advice in check.advice


def test_one_processor_is_too_few(tmp_path, monkeypatch):
    monkeypatch.setattr(system.os, "sched_getaffinity", lambda process: {5})
    check = system.cores(tmp_path)
    assert (check.state, check.figures["usable"]) == ("poor", 1) and "two at least" in check.advice


def test_refused_privileges_are_told(monkeypatch):
    @contextmanager
    def refused():
        yield ["no real time priority (Operation not permitted): the loop runs without it"]

    monkeypatch.setattr(system, "undisturbed", refused)
    check = system.privileges()
    assert check.state == "poor" and "Operation not permitted" in check.sentence
    assert "rtprio 80" in check.advice and "memlock unlimited" in check.advice


def test_usb_is_told_with_the_rule_to_copy(tmp_path, monkeypatch):
    from hapjax_devices import falcon

    def answers(*found):
        def attached():
            if found and isinstance(found[0], Exception):
                raise found[0]
            return list(found)

        monkeypatch.setattr(falcon, "attached_falcons", attached)
        return system.usb(tmp_path)

    monkeypatch.setattr(system.os, "geteuid", lambda: 1000)
    bare = answers()
    assert bare.state == "poor" and "60-hapjax.rules" in bare.advice and "udevadm" in bare.advice
    machine(tmp_path, {"etc/udev/rules.d/60-hapjax.rules": "#"})
    assert answers().state == "good"
    attached = type("Attached", (), {"problem": "the Falcon may not be opened"})()
    assert (answers(attached).state, answers(attached).sentence) == ("poor", "the Falcon may not be opened")
    assert answers(DeviceError("no libusb")).state == "unknown"
    assert "libusb" in answers(DeviceError("no libusb")).advice


def test_the_highest_rate_is_one_that_leaves_room():
    assert [timing.highest_rate(whole) for whole in (100.0, 249.0, 250.0, 334.0, 999.0, 5e3, 2e4)] == [
        *(4000, 4000, 3000, 2000, 1000, 100, 0)
    ]


def test_the_loop_is_timed_as_it_is():
    """Work of 2 ms at 1 kHz: every tick takes as long, and more are missed than are done."""
    import time

    calls = []
    late, worked, missed = timing.loop(1000.0, 0.02, False, lambda: calls.append(time.sleep(0.002)))
    assert len(late) == len(calls) == 20 and np.all(worked > 1990) and missed >= 19
    late, worked, missed = timing.loop(100.0, 0.05, False)
    assert len(late) == 5 and worked.min() < 1000


@pytest.mark.slow
def test_the_command_says_it_all(tmp_path, monkeypatch, capsys):
    bars = followed(monkeypatch, timing)
    assert main(["doctor", "--rate", "100", "--seconds", "0.1", "--json", str(tmp_path / "d.json")]) == 0
    assert bars == [{"total": 0.1, "told": 0.1, "apart": True}] * 3  # none while something is printed
    printed = capsys.readouterr().out
    found = json.loads((tmp_path / "d.json").read_text())
    assert set(found) == {
        *("privileges", "throttle", "kernel", "governor", "processors", "bus", "recorder", "usb"),
        *("idle loop, as any program", "idle loop, with what is granted", "loop with a step"),
    }
    for name, check in found.items():
        assert f"{name}: {check['sentence']}" in printed and check["state"] in ("good", "poor", "unknown")
    step = found["loop with a step"]["figures"]
    assert step["ticks"] == 10 and step["call_us"]["p50"] > 0 and step["holds_hz"] in (0, *timing.RATES)
    assert printed.splitlines()[-1].startswith(("to be mended: ", "nothing to be mended"))


def test_what_cannot_be_examined_is_refused():
    for rate, seconds, words in ((50.0, 1.0, "rate is 50.0 Hz"), (1000.0, 0.0, "seconds is 0.0")):
        with pytest.raises(InputError, match=f"{words}.*; allowed: "):
            doctor.examine(rate, seconds)
