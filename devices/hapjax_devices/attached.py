"""Which devices there are on this computer, and what they say of themselves."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from hapjax import InputError
from hapjax.files import write_json

from . import falcon, inverse3
from .device import DeviceError
from .virtual import ENCODER_STEP, FORCE_LIMIT


class Attached(NamedTuple):
    """A device that is attached, or a kind of which none is to be had.

    **Attributes:** its `kind`, as `hapjax run --device` calls it; its `name`, which tells it from others of the kind, `None`
    where it has none; whether it is `usable` as it is; a `sentence` about it; its `force_limit` in N and its `resolution` in
    m, `None` where there is no device.
    """

    kind: str
    name: str | None
    usable: bool
    sentence: str
    force_limit: float | None = None
    resolution: float | None = None


def attached(url: str = inverse3.URL) -> Iterator[Attached]:
    """The devices that are attached, and of each kind of which none is, why not; the virtual one is always there.

    **Arguments:** `url` of Haply's service.
    """
    yield Attached("virtual", None, True, "in the hand of a virtual operator", FORCE_LIMIT, ENCODER_STEP)
    yield from _falcons()
    yield from _inverse3(url)


def report(url: str, file: Path | None) -> None:
    """Print what there is, and write it as JSON where a file is given."""
    found = list(attached(url))
    for device in found:
        named = device.kind if device.name is None else f"{device.kind} {device.name}"
        limits = "" if device.force_limit is None else f" (at most {device.force_limit:g} N)"
        print(f"{named}: {device.sentence}{limits}")
    if file is not None:
        write_json(file, [device._asdict() for device in found])


def _falcons() -> Iterator[Attached]:
    try:
        found = falcon.attached_falcons()
    except (DeviceError, InputError) as error:
        yield Attached("falcon", None, False, str(error))
        return
    limits = (falcon.Falcon.force_limit, falcon.Falcon.resolution)
    for each in found:
        place = f"on USB bus {each.bus}, address {each.address}"
        said = place if each.problem is None else f"{place}: {each.problem}"
        yield Attached("falcon", each.serial, each.problem is None, said, *limits)
    if not found:
        yield Attached("falcon", None, False, "none is attached, or it has no power")


def _inverse3(url: str) -> Iterator[Attached]:
    try:
        found = inverse3.attached_inverse3(url)
    except (DeviceError, InputError) as error:
        yield Attached("inverse3", None, False, str(error))
        return
    for name in found:
        yield Attached(
            "inverse3",
            name,
            True,
            f"known to Haply's service at {url}",
            inverse3.FORCE_LIMIT,
            inverse3.RESOLUTION,
        )
    if not found:
        yield Attached("inverse3", None, False, f"Haply's service at {url} knows of none")
