"""`hapjax devices`: what is attached, and why what is not can not be used."""

import json
import sys

import pytest

from hapjax.cli import main
from hapjax_devices import DeviceError, attached, falcon
from hapjax_devices.falcon.emulator import EmulatedFalcon, EmulatedUsb, Fault
from haply_service import HaplyService

NOWHERE = "ws://127.0.0.1:9"
real = falcon.attached_falcons


def usb(monkeypatch, *falcons, error=None):
    """A computer with these Falcons, or one whose USB cannot be asked."""

    def found():
        if error is not None:
            raise error
        return real(EmulatedUsb(*falcons))

    monkeypatch.setattr(falcon, "attached_falcons", found)


def test_what_is_attached_is_listed_with_what_it_says(monkeypatch, capsys, tmp_path):
    forbidden = EmulatedFalcon(serial="FT2")
    forbidden.inject(Fault.FORBIDDEN)
    usb(monkeypatch, EmulatedFalcon(serial="FT1"), forbidden)
    file = tmp_path / "devices.json"
    with HaplyService(ids=("049D", "0A11")) as service:
        assert main(["devices", "--url", service.url, "--json", str(file)]) == 0
    out, error = capsys.readouterr()
    said, found = out.splitlines(), json.loads(file.read_text())
    assert error == "" and len(said) == len(found) == 5
    assert [(d["kind"], d["name"], d["usable"]) for d in found] == [
        ("virtual", None, True),
        ("falcon", "FT1", True),
        ("falcon", None, False),
        ("inverse3", "049D", True),
        ("inverse3", "0A11", True),
    ]
    assert found[0]["force_limit"] == 8.5 and found[1]["force_limit"] == 8.0
    assert all(d["sentence"] in line for d, line in zip(found, said, strict=True))
    assert said[1].startswith("falcon FT1: on USB bus") and "udev" in said[2] and service.url in said[3]


@pytest.mark.parametrize("error", [None, DeviceError("USB cannot be used: no libusb")])
def test_what_is_not_there_is_said_in_a_sentence(error, monkeypatch):
    usb(monkeypatch, error=error)
    virtual, no_falcon, no_inverse3 = attached(NOWHERE)
    assert virtual.usable and not no_falcon.usable and not no_inverse3.usable
    assert no_falcon.sentence == ("none is attached, or it has no power" if error is None else str(error))
    assert "no program listens there" in no_inverse3.sentence and NOWHERE in no_inverse3.sentence


def test_a_service_without_devices_says_so(monkeypatch):
    usb(monkeypatch)
    with HaplyService(ids=()) as service:
        assert [*attached(service.url)][-1].sentence == f"Haply's service at {service.url} knows of none"


def test_a_missing_extra_is_no_failure(monkeypatch, capsys):
    for name in ("usb", "usb.core", "websocket"):
        monkeypatch.setitem(sys.modules, name, None)
    assert main(["devices", "--url", NOWHERE]) == 0
    out = capsys.readouterr().out
    assert "hapjax[falcon]" in out and "hapjax[inverse3]" in out and "virtual:" in out


@pytest.mark.parametrize("url", ["here", "ws://", "ws://here:port"])
def test_a_url_that_is_none_is_refused(url, monkeypatch):
    usb(monkeypatch)
    found = [*attached(url)][-1]
    assert (
        not found.usable and found.sentence == f"url of Haply's service is {url!r}; allowed: ws://HOST:PORT"
    )


def test_a_folder_that_is_not_there_is_refused(capsys, tmp_path):
    assert main(["devices", "--json", str(tmp_path / "none" / "devices.json")]) == 2
    assert capsys.readouterr().err.count("\n") == 1
