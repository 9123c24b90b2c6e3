"""`hapjax devices`."""

from pathlib import Path

from ..extras import need
from ..files import check_writable


def devices(url: str = "ws://localhost:10001", json: Path | None = None) -> None:
    """List the devices that are attached, and what they say of themselves; the virtual one is always there.

    Falcons on USB, each Inverse3 that Haply's service knows; where a kind cannot be used, why not.
    Example: hapjax devices --json devices.json

    Args:
        url: Of Haply's service.
        json: File for the list; - is standard output.
    """
    if json is not None:
        check_writable(json)
    need("hapjax_devices.attached", "devices").report(url, json)
