"""`hapjax run`."""

from pathlib import Path
from typing import Literal

from tyro.conf import Positional

from ..extras import need


def run(
    scene: Positional[Path],
    *,
    device: tuple[Literal["virtual", "falcon", "inverse3"], ...] = (),
    devices: Path | None = None,
    rate: float = 1000.0,
    seconds: float | None = None,
    record: Path | None = None,
    hip: Path | None = None,
    name: str = "hapjax",
    live: tuple[str, ...] = (),
    passivity: int | None = None,
    display: float = 1.0,
    json: Path | None = None,
) -> int:
    """Let fingers feel a scene through haptic devices, virtual ones too, until Ctrl-C.

    The servo loop has a process of its own, and the recorder another. Example: hapjax run cube.toml --seconds 2

    Args:
        scene: Scene file (TOML).
        device: What each finger is on, 1 to 5; absent: three virtual devices, or as many as --hip has fingers.
        devices: Device file (TOML), in place of --device: serial numbers, places, rates of their own.
        rate: Hz of the servo loop, 100 to 4000.
        seconds: How long; absent: until Ctrl-C or SIGTERM.
        record: New recording (.mcap) of every tick.
        hip: Recording whose channel hip (m) the virtual fingers follow, there and back; absent: they grip and lift the first
            object that moves, or stroke the first that is felt.
        name: Of the run on the bus.
        live: Paths of numbers that other processes may change meanwhile, such as object.cube.surface.mu.
        passivity: By how many samples the devices are late, 0 to 100, to keep them passive by damping; absent: off.
        display: Lines a second on a terminal, 0.1 to 10.
        json: File for the figures.
    """
    session = need("hapjax_devices.session", "devices")
    options = {"rate": rate, "seconds": seconds, "live": live, "passivity": passivity}
    wanted = session.Session.of(
        name, scene, device, devices, hip, readers=1 if record is None else 2, **options
    )
    return session.supervise(wanted, record, display, json)
