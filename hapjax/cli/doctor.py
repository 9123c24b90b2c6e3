"""`hapjax doctor`."""

from pathlib import Path

from ..at_once import compute_at_once
from ..extras import need
from ..files import check_writable


def doctor(rate: float = 1000.0, seconds: float = 2.0, json: Path | None = None) -> None:
    """Say what rate this machine can hold, and what to change: privileges, kernel, processors, shared memory, USB.

    Looks at the settings, then runs three loops: an idle one as any program, one with real-time priority where that is
    granted, and one that steps the demo's scene. Example: hapjax doctor --json doctor.json

    Args:
        rate: Hz of the loops, 100 to 4000.
        seconds: How long each loop runs, 0.1 to 600 s.
        json: File for all that is said, with its figures; - is standard output.
    """
    if json is not None:
        check_writable(json)
    compute_at_once()
    need("hapjax_devices.doctor.examine", "devices").report(rate, seconds, json)
