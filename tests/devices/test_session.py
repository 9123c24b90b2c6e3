"""A session's parts: which devices it has, what virtual fingers do, devices of their own rate, figures."""

import re
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hapjax
from bus_cases import about
from hapjax import InputError
from hapjax_devices import (
    BrowserDevice,
    DeviceError,
    Falcon,
    GimbalDevice,
    Inverse3,
    Limits,
    RecoverableDevice,
    VirtualDevice,
)
from hapjax_devices.session import Session, process
from hapjax_devices.session.figures import Figures, Spread
from hapjax_devices.session.motion import FOLLOWING
from hapjax_devices.session.slower import Slower
from hapjax_devices.session.wanted import KEYS

SCENES = {
    "table": "[object.table]\nshape = 'plane'\n[object.table.surface]\nmu = 0.5\nstiffness = 1000.0\n",
    "cube": "[object.cube]\nshape = 'box'\nsize = [0.06, 0.06, 0.06]\n[object.cube.body]\nmass = 0.1\n"
    "[object.cube.surface]\nmu = 0.5\nstiffness = 1000.0\n",
    "gimbals": "[object.cube]\nshape = 'box'\nsize = [0.06, 0.06, 0.06]\n[object.cube.body]\nmass = 0.1\n"
    "[object.cube.surface]\nmu = 0.5\nstiffness = 1000.0\n[torsion]\nmodel = 'gimbal'\ncritical_area = 1e-5\n",
    "nothing": "[object.table]\nshape = 'plane'\n",
    "fingers": "[object.table]\nshape = 'plane'\n[object.table.surface]\nmu = 0.5\nstiffness = 1e3\n"
    "finger_mu = [1.0, 2.0]\n",
}


@pytest.fixture
def places(tmp_path):
    for name, text in SCENES.items():
        (tmp_path / f"{name}.toml").write_text(text)
    return tmp_path


def session(places, scene="table", devices=None, **options):
    file = None
    if devices is not None:
        file = places / "devices.toml"
        file.write_text(devices)
    return Session.of("test", places / f"{scene}.toml", options.pop("kinds", ()), file, **options)


# Devices ----------------------------------------------------------------------------------------------------


def test_devices_come_from_a_file(places):
    firmware = places / "fw.bin"
    firmware.write_bytes(b"\0" * 4096)
    text = """
        [[device]]
        type = "falcon"
        serial = "FT1"
        firmware = "fw.bin"
        position = [0.1, 0, 0]
        [[device]]
        type = "inverse3"
        device_id = "049D"
        orientation = [0.7071, 0, 0, 0.7071]
        rate = 500
        [[device]]
        type = "virtual"
    """
    made = session(places, devices=text)
    again = Session.from_json(made.to_json())
    assert again == made
    falcon, inverse3, virtual = again.made()
    assert isinstance(falcon, Falcon) and falcon.name == "the Falcon FT1"
    assert isinstance(inverse3, Slower) and inverse3.rate == 500 and isinstance(inverse3.device, Inverse3)
    assert isinstance(inverse3, RecoverableDevice) and not isinstance(inverse3, GimbalDevice)
    assert isinstance(virtual, VirtualDevice)


def test_a_falcon_that_is_to_be_homed_says_so_as_the_command_does(places, capsys):
    device = session(places, kinds=("falcon",)).made()[0]
    assert isinstance(device, Falcon)
    device._notify("the Falcon is not homed.")
    assert capsys.readouterr().err == "hapjax: the Falcon is not homed.\n"


def test_the_device_file_that_is_shown_is_taken(places):
    page = (Path(__file__).resolve().parents[2] / "docs" / "command_line.md").read_text()
    shown = re.search(r"^### Device files$.*?^```toml\n(.*?)^```$", page, re.DOTALL | re.MULTILINE)
    assert shown is not None
    (places / "falcon.bin").write_bytes(b"\0" * 4096)
    made = session(places, devices=shown[1])
    assert [table["type"] for table in made.devices] == ["falcon", "inverse3", "virtual"]
    given = {key for table in made.devices for key in table}
    assert given == {"type", *(key for keys in KEYS.values() for key in keys)}  # all that there are


def test_a_device_has_the_limits_of_its_table_or_those_of_all(places):
    text = "[[device]]\ntype = 'virtual'\nmax_force = 3\nslew = 500\n[[device]]\ntype = 'virtual'\nramp = 0"
    made = session(places, devices=text, max_force=2.0, ramp=0.25)
    assert Session.from_json(made.to_json()).limits() == [Limits(3.0, 500.0, 0.25), Limits(2.0, 4000.0, 0.0)]
    assert session(places).limits() == [Limits()] * 3


def test_the_servos_process_keeps_to_the_limits(places, monkeypatch):
    given = {}

    def run(scene, devices, *_, **options):
        given.update(options)
        raise DeviceError("enough")

    monkeypatch.setattr(process, "run", run)
    parents = []
    monkeypatch.setattr(process, "end_with", parents.append)
    told = session(places, kinds=("virtual",), max_force=2.0, slew=300.0).to_json()
    assert process.main([told, "17"]) == 1
    assert given["limits"] == [Limits(2.0, 300.0)] and parents == [17]


@pytest.mark.slow
def test_a_mouse_moves_fingers_where_a_session_has_such_devices(places):
    made = session(places, "cube", kinds=("browser", "virtual"))
    assert made.by_mouse and not session(places).by_mouse
    by_mouse, other = made.made()
    assert isinstance(by_mouse, BrowserDevice) and isinstance(other, VirtualDevice)
    with by_mouse:
        np.testing.assert_allclose(by_mouse.read(), [-0.035, 0, 0], atol=1e-4)  # beside the cube
    slow = session(places, devices="[[device]]\ntype = 'browser'\nrate = 500").made()[0]
    assert isinstance(slow, Slower) and isinstance(slow.device, BrowserDevice)


@pytest.mark.slow
def test_a_viewer_has_numbers_for_its_sliders_unless_some_are_given(places):
    felt = ("object.cube.surface.mu", "object.cube.surface.stiffness", "object.cube.body.mass")
    assert session(places, "cube").viewed().live == felt
    assert session(places, "gimbals").viewed().live == (*felt, "torsion.critical_area")
    assert session(places, "cube", live=felt[:1]).viewed().live == felt[:1]


def test_devices_are_virtual_unless_told_otherwise(places):
    assert [table["type"] for table in session(places).devices] == ["virtual"] * 3
    assert [table["type"] for table in session(places, kinds=("virtual",) * 5).devices] == ["virtual"] * 5


BAD_FILES = {
    "": ["0 devices", "1 to 5"],
    "[[device]]\ntype = 'virtual'\n" * 6: ["6 devices", "1 to 5"],
    "a" + ".a" * 200_000 + " = 1": ["devices.toml: line 1 has 200000 dots", "16 or fewer"],
    "[[device]]\ntype = 'wand'": ["device[0].type is 'wand'", "virtual, browser, falcon, inverse3"],
    "[[device]]\nserial = 'x'": ["device[0].type is None"],
    "[[device]]\ntype = 'virtual'\nserial = 'x'": ["device[0].serial is not known of a virtual"],
    "[[device]]\ntype = 'falcon'\nserial = 3": ["device[0].serial is 3", "text"],
    "[[device]]\ntype = 'falcon'\nrate = '1'": ["device[0].rate is '1'", "a number"],
    "[[device]]\ntype = 'falcon'\nrate = 2000": ["device[0]: rate is 2000.0 Hz", "10 to the session's 1000"],
    "[[device]]\ntype = 'falcon'\nrate = true": ["device[0].rate is True", "a number"],
    "[[device]]\ntype = 'falcon'\nposition = [1, 2]": ["device[0].position is [1, 2]", "3 numbers"],
    "[[device]]\ntype = 'falcon'\norientation = [0, 0, 0, 0]": ["device[0]: orientation", "not 0"],
    "[[device]]\ntype = 'falcon'\nfirmware = 'none.bin'": ["device[0]: firmware", "none.bin cannot be read"],
    "[[device]]\ntype = 'inverse3'\nforce_limit = -1": ["device[0]: force_limit is -1.0 N", "above 0"],
    "[[device]]\ntype = 'inverse3'\nmessage_format = '9'": ["message_format is '9'", "'3.1', '3.5'"],
    "[[device]]\ntype = 'virtual'\nmax_force = 0": ["device[0]: force of the limits is 0.0 N", "above 0"],
    "[[device]]\ntype = 'virtual'\nslew = 'fast'": ["device[0].slew is 'fast'", "a number"],
    "device = 3": ["device is 3", "[[device]]"],
    "[device]\ntype = 'falcon'": ["[[device]] for each finger"],
    "[[devices]]": ["devices is not known"],
    "[[device": ["not TOML"],
}


@pytest.mark.parametrize("text", BAD_FILES, ids=range(len(BAD_FILES)))
def test_a_malformed_device_file_is_refused(text, places):
    with pytest.raises(InputError) as refused:
        session(places, devices=text)
    for word in BAD_FILES[text]:
        assert word in str(refused.value)


BAD_SESSIONS = {
    "both": (
        dict(devices="[[device]]\ntype='virtual'", kinds=("virtual",)),
        ["device and devices", "one of"],
    ),
    "too many": (dict(kinds=("virtual",) * 6), ["6 devices", "1 to 5"]),
    "too slow": (dict(rate=99.0), ["rate is 99.0 Hz", "100 to 4000"]),
    "too fast": (dict(rate=4001.0), ["rate is 4001.0 Hz", "100 to 4000"]),
    "no rate": (dict(rate=float("nan")), ["rate is nan"]),
    "too short": (dict(seconds=0.0), ["seconds is 0.0", "one tick"]),
    "no such number": (dict(live=("object.table.surface.nu",)), ["has no nu"]),
    "no delay": (dict(passivity=-1), ["-1", "0 to 100"]),
    "no force": (dict(max_force=-1.0), ["force of the limits is -1.0 N", "above 0"]),
    "no slew": (dict(slew=0.0), ["slew of the limits is 0.0 N/s", "above 0"]),
    "no ramp": (dict(ramp=float("nan")), ["ramp of the limits is nan s", "0 or above"]),
    "no gimbal": (dict(scene="gimbals", kinds=("virtual", "falcon")), ["device[1] is falcon", "no gimbal"]),
    "nothing to feel": (dict(scene="nothing"), ["no object", "surface"]),
    "fingers": (dict(scene="fingers"), ["finger_mu has 2 factors for 3 fingers"]),
    "no scene": (dict(scene="none"), ["none.toml"]),
}


@pytest.mark.parametrize("case", BAD_SESSIONS)
def test_what_does_not_go_together_is_refused(case, places):
    options, words = BAD_SESSIONS[case]
    with pytest.raises(InputError) as refused:
        session(places, **options)
    for word in words:
        assert word in str(refused.value)


# Motions ----------------------------------------------------------------------------------------------------


def way(device):
    """The path of a virtual device, as far as it is not a repetition."""
    assert isinstance(device, VirtualDevice) and device._hand == FOLLOWING
    return device.path


@pytest.mark.parametrize("scene", ["table", pytest.param("cube", marks=pytest.mark.slow)])
def test_a_virtual_operator_touches_and_lets_go_without_end(scene, places):
    made = session(places, scene).made()
    paths = np.stack([way(device) for device in made], axis=1)
    loop = np.concatenate([paths, paths[:1]])
    assert np.abs(np.diff(loop, axis=0)).max() < 1e-3  # no jump, not where it begins anew either
    thing = session(places, scene).loaded.object[scene]
    query = jnp.asarray(paths[::100] - np.asarray(thing.position))
    depth = np.asarray(jax.vmap(jax.vmap(lambda p: thing.shape.closest(p).depth))(query))
    assert np.all(depth[0] < 0) and np.all(depth.max(axis=0) > 5e-4)
    with made[0] as device:
        for _ in range(3):
            device.read()
            device.write(np.zeros(3))


def test_recorded_fingers_are_followed_there_and_back(places):
    t = np.arange(101) / 500
    hip = np.stack([np.stack([0.1 * t + i, 0 * t, 0 * t], axis=1) for i in range(2)], axis=1)
    hapjax.Recording(hip=hip, hip_t=t).save(places / "hip.npz")
    made = session(places, hip=places / "hip.npz", rate=1000.0)
    assert len(made.devices) == 2
    path = way(made.made()[1])
    assert len(path) == 2 * 201 - 2  # at the session's rate
    np.testing.assert_allclose(path[[0, 100, 200, 300], 0], [1.0, 1.01, 1.02, 1.01], atol=1e-9)
    with pytest.raises(InputError, match=r"hip.npz: hip has 2 fingers; allowed: 3"):
        session(places, hip=places / "hip.npz", kinds=("virtual",) * 3)
    hapjax.Recording(force=hip, force_t=t).save(places / "force.npz")
    with pytest.raises(InputError, match=r"force.npz: hip has fewer"):
        session(places, hip=places / "force.npz")


# The end of the loop, and its figures -----------------------------------------------------------------------


@pytest.fixture
def asked(monkeypatch):
    handlers = {}
    monkeypatch.setattr(process.signal, "signal", lambda number, handler: handlers.update({number: handler}))
    return process._Asked(3.0), handlers


def test_the_loop_ends_with_its_ticks_or_a_signal(asked):
    over, handlers = asked
    assert [over(), over(), over()] == [False, False, True]
    over = process._Asked(float("inf"))
    assert not over()
    handlers[process.signal.SIGTERM](process.signal.SIGTERM, None)
    assert over()


def test_a_signal_before_the_loop_ends_the_process_at_once(asked):
    with pytest.raises(SystemExit):
        asked[1][process.signal.SIGINT](process.signal.SIGINT, None)
    asked[1][process.signal.SIGTERM](process.signal.SIGTERM, None)  # the devices are being let go


def test_spreads_are_right_to_a_hundredth():
    values = np.random.default_rng(0).lognormal(1.0, 2.0, 20_000)
    spread = Spread()
    for part in np.array_split(values, 7):
        spread.add(part)
    found = spread.to_dict()
    for name, share in (("p50", 50), ("p99", 99), ("p99.9", 99.9)):
        assert found[name] == pytest.approx(np.percentile(values, share), rel=0.015)
    assert found["max"] == values.max()
    spread = Spread()
    spread.add(np.zeros(5))
    assert spread.to_dict() == {"p50": 0.0, "p99": 0.0, "p99.9": 0.0, "max": 0.0}


def test_figures_say_what_was_felt():
    ticks = np.zeros(4, about("test", fingers=2).tick)
    ticks["tick"], ticks["missed"] = np.arange(4), [0, 0, 1, 2]
    ticks["force"][:, 1] = np.arange(4)[:, None] * np.array([0.0, 3.0, 4.0])
    figures = Figures(2)
    figures.add(ticks[:0])
    assert figures.to_dict()["ticks"] == 0
    figures.add(ticks[:3])
    figures.add(ticks[3:])
    found = figures.to_dict()
    assert (found["ticks"], found["unseen"], found["missed"]) == (4, 0, 2)
    assert found["force"] == [{"max": 0.0, "mean": 0.0}, {"max": 15.0, "mean": 7.5}]
    assert "15.00 N" in figures.line(1000.0) and "missed ticks: 2" in figures.line(1000.0)


def test_ticks_that_were_not_seen_are_counted_as_such():
    ticks = np.zeros(10, about("test", fingers=2).tick)
    ticks["tick"], ticks["force"] = np.arange(10), 1.0
    figures = Figures(2)
    assert (figures.ticks, figures.unseen) == (0, 0)
    figures.add(ticks[:4])
    figures.add(ticks[7:])
    found = figures.to_dict()
    assert (found["ticks"], found["unseen"]) == (10, 3)
    assert found["force"][0]["mean"] == pytest.approx(np.sqrt(3))
