"""The system's settings: privileges, kernel, processors, shared memory, USB."""

import os
import resource
import shutil
from collections.abc import Iterator
from pathlib import Path

from hapjax import InputError
from hapjax.extras import need

from ..bus import services
from ..device import DeviceError
from ..realtime import PRIORITY, undisturbed
from .check import Check

_LIMITS = "in a file such as /etc/security/limits.d/realtime.conf, then log in again"
_RULES = Path(__file__).parents[1] / "udev" / "60-hapjax.rules"
_SHARED = 64 * 2**20  # bytes; a run with six readers at 4 kHz takes about half of it
CORES = 2  # the loop fills one


def settings(root: Path = Path("/")) -> Iterator[Check]:
    """All of them, of the system whose /proc, /sys and /etc are below `root`."""
    yield privileges()
    yield throttle(root)
    yield kernel(root)
    yield governor(root)
    yield cores(root)
    yield shared_memory()
    yield recorder()
    yield usb(root)


def privileges() -> Check:
    """Whether the loop gets real-time priority and locked memory, by trying."""
    with undisturbed() as refused:
        granted = not refused
    soft = resource.getrlimit(resource.RLIMIT_MEMLOCK)[0]
    memory = None if soft == resource.RLIM_INFINITY else soft
    figures = {"refused": list(refused), "memlock_bytes": memory}
    if granted:
        return Check(
            "privileges", "good", "real-time priority and locked memory are granted", figures=figures
        )
    advice = f"put 'USER - rtprio {PRIORITY}' and 'USER - memlock unlimited' {_LIMITS}"
    return Check("privileges", "poor", "; ".join(refused), advice, figures)


def throttle(root: Path) -> Check:
    """How much of each second the kernel leaves to real-time programs."""
    text = _read(root / "proc/sys/kernel/sched_rt_runtime_us")
    if text is None:
        return Check("throttle", "unknown", "how long real-time programs may run is not readable")
    runtime = int(text)
    if runtime < 0 or runtime >= 900_000:
        how = "without end" if runtime < 0 else f"{runtime / 1000:g} ms of each second"
        sentence = f"real-time programs may run {how}; the loop sleeps more than the rest"
        return Check("throttle", "good", sentence, figures={"sched_rt_runtime_us": runtime})
    return Check(
        "throttle",
        "poor",
        f"real-time programs may run only {runtime / 1000:g} ms of each second",
        "as root: sysctl -w kernel.sched_rt_runtime_us=950000",
        {"sched_rt_runtime_us": runtime},
    )


def kernel(root: Path) -> Check:
    """How the kernel lets itself be interrupted."""
    version = _read(root / "proc/version") or ""
    kinds = ("PREEMPT_RT", "PREEMPT_DYNAMIC", "PREEMPT")
    kind = next((k for k in kinds if k in version), "none")
    if _read(root / "sys/kernel/realtime") == "1":
        kind = "PREEMPT_RT"
    figures = {"preemption": kind}
    if kind == "PREEMPT_RT":
        return Check("kernel", "good", "the kernel is a real-time one (PREEMPT_RT)", figures=figures)
    if kind == "none":
        advice = "install a kernel with PREEMPT_DYNAMIC or PREEMPT_RT (Debian: linux-image-rt-amd64)"
        return Check("kernel", "poor", "the kernel does not say that it can be interrupted", advice, figures)
    mode = "full" if "preempt=full" in (_read(root / "proc/cmdline") or "") else "as it was built"
    sentence = f"the kernel is an ordinary one ({kind}, {mode}): late by some 0.1 ms now and then"
    advice = (
        ""
        if mode == "full"
        else "boot it with preempt=full where ticks are late, or take one with PREEMPT_RT"
    )
    return Check("kernel", "good", sentence, advice, figures)


def governor(root: Path) -> Check:
    """What sets the processors' frequency."""
    files = sorted((root / "sys/devices/system/cpu").glob("cpu[0-9]*/cpufreq/scaling_governor"))
    found = sorted({text for file in files if (text := _read(file)) is not None})
    if not found:
        return Check("governor", "unknown", "the processors' frequency is set elsewhere, or not readable")
    figures = {"governors": found}
    if found == ["performance"]:
        return Check(
            "governor", "good", "the processors run at full frequency (performance)", figures=figures
        )
    sentence = f"the processors slow down between ticks (governor {', '.join(found)})"
    return Check("governor", "poor", sentence, "as root: cpupower frequency-set -g performance", figures)


def cores(root: Path) -> Check:
    """How many processors there are for the loop and for others."""
    usable = len(os.sched_getaffinity(0))
    isolated = _read(root / "sys/devices/system/cpu/isolated") or ""
    figures = {"usable": usable, "isolated": isolated}
    apart = f"; apart from all other work: {isolated}" if isolated else ""
    sentence = f"{usable} processors may be used{apart}"
    if usable < CORES:
        advice = "give it two at least: one for the loop, one for the recorder and the display"
        return Check("processors", "poor", sentence, advice, figures)
    return Check("processors", "good", sentence, figures=figures)


def shared_memory() -> Check:
    """Whether a run can go on the bus."""
    try:
        free = shutil.disk_usage("/dev/shm").free
        services.runs()
    except InputError as error:
        return Check("bus", "poor", str(error), "pip install 'hapjax[devices]', and a writable /dev/shm")
    except OSError as error:
        return Check("bus", "poor", f"/dev/shm: {error.strerror}", "mount a tmpfs at /dev/shm")
    figures = {"free_bytes": free}
    if free < _SHARED:
        sentence = f"{free / 2**20:.0f} MiB of shared memory are free"
        return Check("bus", "poor", sentence, "in a container: --shm-size=256m", figures)
    return Check("bus", "good", f"shared memory works, {free / 2**20:.0f} MiB are free", figures=figures)


def recorder() -> Check:
    """Whether there is what the recorder writes with."""
    try:
        need("mcap.writer", "devices")
        need("zstandard", "devices")
    except InputError as error:
        return Check("recorder", "poor", str(error), "pip install 'hapjax[devices]'")
    return Check("recorder", "good", "recordings can be written")


def usb(root: Path) -> Check:
    """Whether USB devices can be used, and which are there."""
    from ..falcon import attached_falcons

    folders = ("etc/udev/rules.d", "usr/lib/udev/rules.d", "lib/udev/rules.d")
    rule = any((root / folder / _RULES.name).is_file() for folder in folders)
    copy = f"as root: cp {_RULES} /etc/udev/rules.d && udevadm control --reload && udevadm trigger"
    try:
        found = attached_falcons()
    except InputError as error:
        return Check("usb", "unknown", str(error), "pip install 'hapjax[falcon]', for a Falcon")
    except DeviceError as error:
        return Check("usb", "unknown", str(error), "for a Falcon: install libusb (Debian: libusb-1.0-0)")
    figures = {"falcons": len(found), "rule": rule}
    problems = [falcon.problem for falcon in found if falcon.problem is not None]
    if problems:
        return Check("usb", "poor", problems[0], copy, figures)
    sentence = f"USB can be asked; Falcons attached: {len(found)}"
    if not rule and os.geteuid() != 0:
        return Check("usb", "poor", f"{sentence}; no udev rule lets a user have them", copy, figures)
    return Check("usb", "good", sentence, figures=figures)


def _read(file: Path) -> str | None:
    try:
        return file.read_text().strip()
    except OSError:
        return None
