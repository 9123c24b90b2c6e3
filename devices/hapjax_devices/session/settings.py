"""What a session is: all that its processes have to know, as text that one process can give another."""

import json
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from hapjax import InputError, Scene, load_scene
from hapjax.paths import number_at
from hapjax.recording import Recording
from hapjax.tuning.settings import tuned_by_default

from ..bus import services
from ..device import Device, GimbalDevice
from ..passivity import Passivity
from ..safety import Limits
from .motion import recorded
from .wanted import limits_of, made, wanted

SLOWEST, FASTEST = 100.0, 4000.0  # Hz


@dataclass(frozen=True)
class Session:
    """A session: what is felt, with which devices, for how long.

    **Arguments:** `run`, its name on the bus; the `scene`'s file; the `devices`, a table each; the `rate` in Hz, 100 to
    4000; `seconds`, above 0, `None`: until it is stopped; `hip`, a recording whose fingers the virtual ones follow; paths
    of `live` numbers; `passivity`, by how many samples the devices are late whose passivity is kept, `None`: it is not;
    how many `readers` are waited for; `max_force` in N, `slew` in N/s and `ramp` in s, the `Limits` of all devices whose
    tables have none of their own.

    **Raises:** `InputError` for what cannot be, before anything is started.
    """

    run: str
    scene: str
    devices: list[dict[str, Any]]
    rate: float = 1000.0
    seconds: float | None = None
    hip: str | None = None
    live: tuple[str, ...] = ()
    passivity: int | None = None
    readers: int = 1
    max_force: float | None = None
    slew: float = Limits.slew
    ramp: float = Limits.ramp

    def __post_init__(self):
        services.check_name(self.run)
        if not SLOWEST <= self.rate <= FASTEST:
            raise InputError(f"rate is {self.rate} Hz; allowed: {SLOWEST:g} to {FASTEST:g}")
        if self.seconds is not None and not 1 <= self.seconds * self.rate < 1e12:
            raise InputError(
                f"seconds is {self.seconds}; allowed: at least one tick of {1 / self.rate:g} s, finite"
            )

    @classmethod
    def of(
        cls,
        run: str,
        scene: Path,
        kinds: tuple[str, ...] = (),
        file: Path | None = None,
        hip: Path | None = None,
        **rest: Any,
    ) -> "Session":
        """A session whose devices are of these `kinds`, or those of a `file`; see `Session`."""
        recording = None if hip is None else recorded(hip, None)
        tables = wanted(kinds, file, recording)
        session = cls(run, str(scene), tables, hip=None if hip is None else str(hip), **rest)
        session.check()
        return session

    @cached_property
    def loaded(self) -> Scene:
        """The scene. **Raises:** `InputError`."""
        return load_scene(self.scene)

    @property
    def by_mouse(self) -> bool:
        """Whether a finger is on a browser device, which needs a viewer."""
        return any(table["type"] == "browser" for table in self.devices)

    def viewed(self) -> "Session":
        """The session for a viewer: with live numbers for its sliders, mu, stiffness, mass, A_crit, unless it has some."""
        scene, paths = self.loaded, [*self.live]
        if not paths:
            paths = [*tuned_by_default(scene), *(f"object.{name}.body.mass" for name in scene.moving())]
            if hasattr(scene.torsion, "critical_area"):
                paths.append("torsion.critical_area")
        return replace(self, live=tuple(paths))

    def made(self) -> list[Device]:
        """The devices, of which none is opened. **Raises:** `InputError`."""
        recording = self.recording()
        return made(self.devices, self.run, self.loaded, self.rate, recording)

    def limits(self) -> list[Limits]:
        """What each device may be told to do. **Raises:** `InputError`."""
        return limits_of(self.devices, asdict(self))

    def recording(self) -> Recording | None:
        """The motion that virtual fingers follow, where it was recorded. **Raises:** `InputError`."""
        return None if self.hip is None else recorded(Path(self.hip), len(self.devices))

    def check(self) -> None:
        """Refuse scene, devices and numbers that do not go together. **Raises:** `InputError`."""
        for path in self.live:
            number_at(self.loaded, path)
        if self.passivity is not None:
            Passivity(self.passivity)
        self.limits()
        for name in self.loaded.touchable():
            surface = self.loaded.object[name].surface
            assert surface is not None
            surface.check_fingers(len(self.devices))
        turned = self.loaded.torsion is not None and self.loaded.torsion.needs_gimbal
        for place, device in enumerate(self.made()):
            if turned and not isinstance(device, GimbalDevice):
                kind = self.devices[place]["type"]
                raise InputError(
                    f"device[{place}] is {kind}, which has no gimbal, but the scene's torsion reads one; allowed: virtual"
                )

    def to_json(self) -> str:
        """All of it, as JSON."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> "Session":
        """What `to_json` wrote."""
        said = json.loads(text)
        return cls(**said | {"live": tuple(said["live"])})
