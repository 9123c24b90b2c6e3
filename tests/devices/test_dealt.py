"""Fingers on several devices of a kind, of which nobody says which is whose."""

import pytest

from hapjax import InputError
from hapjax.cli import main
from hapjax_devices import attached_falcons, falcon
from hapjax_devices.falcon.emulator import EmulatedFalcon, EmulatedUsb, Fault
from hapjax_devices.session import supervisor
from hapjax_devices.session.dealt import dealt
from haply_service import HaplyService

ONE, SECOND = {"type": "falcon"}, {"type": "falcon", "serial": "FT2"}


@pytest.fixture
def usb(monkeypatch):
    """A computer to which the Falcons are attached that are put there."""
    falcons = []
    monkeypatch.setattr(falcon, "attached_falcons", lambda: attached_falcons(EmulatedUsb(*falcons)))
    return falcons


def serials(tables):
    return [table.get("serial") for table in dealt(tables)[0]]


@pytest.mark.parametrize(
    ("attached", "asked", "given"),
    [
        (("FT2", "FT1"), [ONE, ONE], ["FT1", "FT2"]),
        (("FT2", "FT1"), [ONE, {"type": "virtual"}, ONE], ["FT1", None, "FT2"]),
        (("FT2", "FT1"), [ONE, SECOND], ["FT1", "FT2"]),
        (("FT3", "FT2", "FT1"), [ONE, SECOND, ONE], ["FT1", "FT2", "FT3"]),
        # More are attached, or none, or one has no name: the driver asks, or says what is missing.
        (("FT3", "FT2", "FT1"), [ONE, ONE], [None, None]),
        (("FT2", "FT1"), [ONE], [None]),
        ((), [ONE, ONE], [None, None]),
        (("FT1", "FT1"), [ONE, ONE], [None, None]),
    ],
)
def test_falcons_are_dealt_out_by_their_numbers(usb, attached, asked, given):
    usb.extend(EmulatedFalcon(serial=serial) for serial in attached)
    assert serials(asked) == given


def test_one_that_may_not_be_asked_is_left_to_the_driver(usb):
    usb.extend(EmulatedFalcon(serial=serial) for serial in ("FT1", "FT2"))
    usb[0].inject(Fault.FORBIDDEN)
    assert serials([ONE, ONE]) == [None, None]


@pytest.mark.parametrize(
    ("attached", "said"),
    [(("FT1",), "attached is 1; allowed: FT1"), (("FT2", "FT1"), "are 2; allowed: FT1, FT2")],
)
def test_more_than_there_are_is_refused(usb, attached, said):
    usb.extend(EmulatedFalcon(serial=serial) for serial in attached)
    with pytest.raises(InputError, match=f"device has 3 Falcons, but .*{said}"):
        dealt([ONE, SECOND, ONE])


def test_each_inverse3_is_of_its_service():
    with HaplyService(("0500", "049D")) as service, HaplyService(("049D",)) as other:
        asked = [{"type": "inverse3", "url": one.url} for one in (service, other, service)]
        tables, said = dealt(asked)
        assert [table.get("device_id") for table in tables] == ["049D", None, "0500"]
        assert said == "finger 0 is on the Inverse3 049D, finger 2 is on the Inverse3 0500"
    assert dealt(asked) == (asked, "")  # no service any more: the driver says so


def test_a_session_says_which_finger_is_on_which(usb, monkeypatch, tmp_path, capsys):
    def start(session):
        raise InputError(f"the devices are {session.devices}")

    monkeypatch.setattr(supervisor, "ServoProcess", start)
    usb.extend(EmulatedFalcon(serial=serial) for serial in ("FT2", "FT1"))
    table = tmp_path / "table.toml"
    table.write_text(
        "[object.table]\nshape = 'plane'\n[object.table.surface]\nmu = 0.5\nstiffness = 1000.0\n"
    )
    assert main(["run", str(table), "--device", "falcon", "falcon"]) == 2
    order, devices = capsys.readouterr().err.splitlines()
    assert order == "hapjax: finger 0 is on the Falcon FT1, finger 1 is on the Falcon FT2"
    told = [{"type": "falcon", "serial": serial} for serial in ("FT1", "FT2")]
    assert devices == f"hapjax: the devices are {told}"
