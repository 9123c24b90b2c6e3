"""`hapjax run`."""

from pathlib import Path
from typing import Literal

from tyro.conf import FlagCreatePairsOff, Positional

from ..errors import InputError
from ..extras import need
from ..files import check_apart
from ..progress import following
from ..scene_file import load_scene
from ..tuning.settings import Tuning, tuned_by_default

HOST, PORT = "127.0.0.1", 8080  # of a viewer's page


def run(
    scene: Positional[Path],
    *,
    device: tuple[Literal["virtual", "browser", "falcon", "inverse3"], ...] = (),
    devices: Path | None = None,
    rate: float = 1000.0,
    seconds: float | None = None,
    record: Path | None = None,
    hip: Path | None = None,
    name: str = "hapjax",
    live: tuple[str, ...] = (),
    passivity: int | None = None,
    max_force: float | None = None,
    slew: float = 4000.0,
    ramp: float = 0.5,
    tune: FlagCreatePairsOff[bool] = False,
    truth: Path | None = None,
    window: float = 4.0,
    adopt: FlagCreatePairsOff[bool] = False,
    view: FlagCreatePairsOff[bool] = False,
    host: str = HOST,
    port: int = PORT,
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
        max_force: N that no device's force passes, above 0; absent: what each device can.
        slew: N/s by which a force may rise or turn, above 0.
        ramp: s in which the force of a finger that is let in comes up, 0 or above.
        tune: Estimate the live numbers meanwhile (absent: mu and stiffness of all that is felt), in another process; Enter
            or SIGUSR1 hands the newest estimates to the servo.
        truth: Of --tune: scene file of the object that simulated sensors measure under the same fingers.
        window: Of --tune: how many of the last seconds a fit is to, 1 to 60.
        adopt: Of --tune: hand over each estimate, unasked.
        view: Show it on a page in the browser, with sliders for the live numbers (absent: mu, stiffness, mass, A_crit); with
            a device `browser`, whose fingers the mouse moves there, always.
        host: Of --view: address of the page; on another than 127.0.0.1 anyone who reaches it can move fingers and sliders.
        port: Of --view: port of the page, 0 for any that is free.
        display: Lines a second on a terminal, 0.1 to 10.
        json: File for the figures; - is standard output.
    """
    tuning = None
    with following(None, doing="loading the library"):
        session = need("hapjax_devices.session", "devices")
    check_apart([record, json], [scene, hip, devices, truth])
    if tune:
        need("hapjax_fitting", "fitting")
        if truth is None:
            raise InputError(
                "--tune is given without --truth; allowed: with the scene that simulated sensors measure"
            )
        tuning = Tuning(name, str(scene), str(truth), window, adopt)
        live = live or tuned_by_default(load_scene(scene))
    elif truth is not None or adopt or window != 4.0:
        raise InputError("--truth, --window and --adopt are of --tune; allowed: with it")
    readers = 1 + (record is not None) + tune
    options = {"rate": rate, "seconds": seconds, "live": live, "passivity": passivity, "readers": readers}
    options |= {"max_force": max_force, "slew": slew, "ramp": ramp}
    with following(None, doing="reading"):
        wanted = session.Session.of(name, scene, device, devices, hip, **options)
    if not (view or wanted.by_mouse):
        if (host, port) != (HOST, PORT):
            raise InputError("--host and --port are of --view; allowed: with it")
        return session.supervise(wanted, record, display, json, tuning)
    return session.supervise(wanted.viewed(), record, display, json, tuning, (host, port))
