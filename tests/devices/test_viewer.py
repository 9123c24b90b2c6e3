"""What the viewer draws: where things are and how large, from a run's own ticks; where a hand's parts are; its sliders."""

import io
import json
import threading
import time
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hapjax
from hapjax_devices.bus import About
from hapjax_devices.viewer import check
from hapjax_devices.viewer.geometry import from_z, matrices, placed, ring, rods
from hapjax_devices.viewer.hand import BONE, KNUCKLE, hand
from viewer_cases import Drawn

viser = pytest.importorskip("viser", reason="the viewer needs the extra viewer")

from hapjax_devices.viewer import live  # noqa: E402
from hapjax_devices.viewer import stage as drawing  # noqa: E402
from hapjax_devices.viewer.live import Decoder  # noqa: E402
from hapjax_devices.viewer.plots import NOWHERE, Plots, cone  # noqa: E402
from hapjax_devices.viewer.server import is_own, serving  # noqa: E402
from hapjax_devices.viewer.shapes import CLEAR, SOLID, as_light, glb, triangles  # noqa: E402
from hapjax_devices.viewer.sliders import Sliders, scale  # noqa: E402

MU, STIFFNESS, A_CRIT = 0.5, 1000.0, 1e-6
TURN = np.array([np.cos(0.4), 0.0, 0.0, np.sin(0.4)])  # about z, by 0.8 rad


def scene():
    """A block that is turned and cannot move, beside a table that nothing feels, and a body that moves."""
    surface = hapjax.Surface(STIFFNESS, mu=MU)
    block = hapjax.Object(hapjax.Box((0.1, 0.04, 0.04)), surface, None, (0.2, 0.0, 0.1), TURN)
    ball = hapjax.Object(
        hapjax.Sphere(0.02), hapjax.Surface(STIFFNESS, mu=MU), hapjax.Body(0.1), (0.5, 0, 0.1)
    )
    return hapjax.Scene(
        {"table": hapjax.Object(hapjax.Plane()), "block": block, "ball": ball},
        torsion=hapjax.GravityDrop(A_CRIT),
    )


@pytest.fixture(scope="module")
def pressed():
    """A run of three steps as its ticks would say it: finger 0 is 1 mm deep in the block's far end and goes along it by more
    than the cone holds, finger 1 touches nothing."""
    made, axis = scene(), matrices(TURN)[:, 0]
    start = np.array([[0.2, 0.0, 0.1] + 0.06 * axis, [0.0, 0.0, 0.3]])
    packed = hapjax.pack(made, start, 1e-3, live=("torsion.critical_area",))
    about = About.of("viewed", 1000.0, made, packed, [], 0)
    ticks, memory = np.zeros(3, about.tick), packed.start
    for tick in range(3):
        hip = start.copy()
        hip[0] += -0.011 * axis + [0, 0, 0.002 * tick]
        memory = packed.call(memory, jnp.asarray(hip, packed.dtype))
        ticks[tick]["tick"], ticks[tick]["hip"], ticks[tick]["force"] = tick, hip, packed.force(memory)
        ticks[tick]["memory"][: about.memory] = memory
    return about, Decoder(about, made), ticks, axis


def test_a_tick_says_where_god_objects_are_and_what_friction_may_be(pressed):
    _, decoder, ticks, axis = pressed
    found = decoder.moments(ticks)
    np.testing.assert_allclose(found.time, [0, 1e-3, 2e-3])
    assert decoder.felt == [1, 2] and found.point.shape == (3, 2, 2, 3)
    np.testing.assert_allclose(found.depth[:, 0, 0], 1e-3, rtol=1e-4)
    np.testing.assert_allclose(found.normal[:, 0, 0], np.tile(axis, (3, 1)), atol=1e-5)
    np.testing.assert_allclose(found.normal_force[:, 0, 0], STIFFNESS * 1e-3, rtol=1e-4)
    np.testing.assert_allclose(found.limit[:, 0, 0], MU * STIFFNESS * 1e-3, rtol=1e-4)
    # On the surface, the second time where it was at first, dragged by the cone later; f = k (g - h).
    np.testing.assert_allclose((found.point[:, 0, 0] - [0.2, 0, 0.1]) @ axis, 0.05, atol=1e-7)
    np.testing.assert_allclose(
        found.force[:, 0], STIFFNESS * (found.point[:, 0, 0] - found.hip[:, 0]), atol=1e-3
    )
    np.testing.assert_allclose(np.linalg.norm(found.friction[2, 0, 0]), found.limit[2, 0, 0], rtol=1e-4)
    np.testing.assert_array_equal(found.depth[:, :, 1], 0)
    np.testing.assert_allclose(found.tip[:, 0], found.point[:, 0, 0])
    np.testing.assert_allclose(found.tip[:, 1], found.hip[:, 1])
    np.testing.assert_allclose(found.pose[0, 1], [0.2, 0, 0.1, *TURN], atol=1e-7)
    np.testing.assert_allclose(found.pose[0, 2, :3], [0.5, 0, 0.1], atol=1e-7)
    np.testing.assert_allclose(found.critical_area, A_CRIT, rtol=1e-6)


def test_circles_are_as_large_as_forces_and_patches_as_their_areas(pressed):
    about, decoder, ticks, axis = pressed
    drawn = Drawn()
    stage = drawing.Stage(SimpleNamespace(scene=drawn), scene(), about.fingers)
    stage.show(decoder.moments(ticks))
    n, per = STIFFNESS * 1e-3, drawing.FORCE
    first, others = slice(0, 1), slice(1, 4)
    circles, patches = drawn.made["/friction_circles"], drawn.made["/contact_patches"]
    np.testing.assert_allclose(circles.batched_scales[first], per * MU * n, rtol=1e-4)
    np.testing.assert_array_equal(circles.batched_colors[0], as_light(drawing.SLIDES))
    np.testing.assert_allclose(patches.batched_scales[first], drawing.PATCH * MU * 1e-3, rtol=1e-4)
    critical = drawn.made["/critical_areas"]
    np.testing.assert_allclose(
        critical.batched_scales[first], drawing.PATCH * np.sqrt(A_CRIT / np.pi), atol=1e-6
    )
    np.testing.assert_array_equal(critical.batched_colors[0], as_light(drawing.GREY))  # 0.79 mm^2 of 1
    for flat in (circles, patches, critical):
        np.testing.assert_array_equal(flat.batched_scales[others], 0)
        along = matrices(flat.batched_wxyzs[0])[:, 2]
        np.testing.assert_allclose(along, axis, atol=1e-5)
    start, end = drawn.made["/forces"].points[0]
    np.testing.assert_allclose(end - start, per * ticks["force"][-1, 0], atol=1e-6)
    np.testing.assert_allclose(drawn.made["/hand/tips"].batched_positions[0], start, atol=1e-6)
    rub = np.diff(drawn.made["/friction"].points[0], axis=0)[0]
    assert np.linalg.norm(rub) == pytest.approx(
        circles.batched_scales[0, 0], rel=1e-4
    )  # it ends on the circle
    np.testing.assert_allclose(drawn.made["/objects/block"].wxyz, TURN, atol=1e-6)
    np.testing.assert_allclose(drawn.made["/hips"].batched_positions, ticks["hip"][-1], atol=1e-6)


def test_in_a_grasp_god_object_and_finger_are_told_apart_inside_the_fingertip():
    drawn, deep = Drawn(), 0.0024  # m, of 1.9 N on 800 N/m
    drawing.Stage(SimpleNamespace(scene=drawn), scene(), 2)
    names = ("/hips", "/god_objects", "/hand/tips")
    hip, god, tip = (np.ptp(drawn.made[name].arguments[0], axis=0).max() / 2 for name in names)
    assert hip + god < deep < tip - hip
    assert god > drawn.made["/forces"].shaft_radius  # the arrow begins there
    assert drawn.made["/hand/tips"].opacity < 0.5
    for name in ("/hips", "/hand/tips"):  # as viser takes them: as amounts of light
        np.testing.assert_array_equal(drawn.made[name].batched_colors[1], as_light(drawing.FINGERS[1]))
    np.testing.assert_array_equal(as_light((0, 188, 255)), [0, 130, 255])  # of sRGB


def test_plots_leave_room_above_and_hide_no_finger(pressed):
    _, decoder, ticks, _ = pressed
    plots = []

    def add(data, series, **options):
        plots.append(SimpleNamespace(data=data, series=series, **options))
        return plots[-1]

    Plots(SimpleNamespace(gui=SimpleNamespace(add_uplot=add)), 5).show(window := decoder.moments(ticks))
    force, _ = plots
    assert len(force.data) == 1 + 2 + 1
    np.testing.assert_allclose(force.data[1], np.linalg.norm(window.force[:, 0], axis=1))
    # What is plotted reaches down to 0, however steady the forces: a tenth of that is above them.
    np.testing.assert_array_equal(force.data[-1], 0)
    assert force.series[-1]["stroke"] == "transparent" and plots[0].padding[0] > 0
    for plot in plots:
        widths = np.array(
            [each["points"]["size"] if each["width"] == 0 else each["width"] for each in plot.series[1:6]]
        )
        assert np.all(np.diff(widths) < -1) and len({each["stroke"] for each in plot.series[1:6]}) == 5


def test_the_cone_has_each_sample_once_in_order_and_each_fingers_limit(pressed):
    _, decoder, ticks, _ = pressed
    window = decoder.moments(ticks)
    window = replace(window, normal_force=window.normal_force * np.array([3.0, 1.0, 2.0])[:, None, None])
    x, *rest = cone(window)
    dots, limits = np.array(rest[:2]), np.array(rest[2:])
    assert np.all(np.diff(x) >= 0) and x[0] == 0 and np.sum(dots != NOWHERE) == 3
    there = dots[0] != NOWHERE
    np.testing.assert_allclose(np.sort(x[there]), np.sort(window.normal_force[:, 0, 0]))
    assert sorted(dots[0, there]) == pytest.approx(sorted(np.linalg.norm(window.friction[:, 0, 0], axis=1)))
    np.testing.assert_allclose(limits[0], MU * x, rtol=1e-4)
    assert np.all(limits[1] == NOWHERE) and np.all(dots[1] == NOWHERE)
    # A dot that would hide another is not drawn: 500 of each finger at a time are more than a page has time for.
    for again, first in zip(cone(window + window), (x, *rest), strict=True):
        np.testing.assert_array_equal(again, first)


SHAPES = {
    "box": hapjax.Box((0.1, 0.2, 0.3)),
    "sphere": hapjax.Sphere(0.1),
    "cylinder": hapjax.Cylinder(0.1, 0.3),
    "capsule": hapjax.Capsule(0.05, 0.2),
    "convex": hapjax.Convex([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0.1, 0.1, 0.1]], scale=0.1),
}


@pytest.mark.parametrize("name", SHAPES)
def test_a_shape_is_drawn_where_it_is_felt_and_outside_out(name):
    shape = SHAPES[name]
    vertices, faces, _ = triangles(shape)
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    volume = np.sum(np.einsum("ij,ij->i", a, np.cross(b, c))) / 6
    wanted = shape.volume()
    assert wanted is not None and volume == pytest.approx(float(wanted), rel=0.02)
    depth = jax.jit(jax.vmap(lambda vertex: shape.closest(vertex).depth))(jnp.asarray(vertices))
    np.testing.assert_allclose(depth, 0, atol=1e-6)


def test_what_is_translucent_hides_nothing_and_has_the_colour_that_is_asked_for():
    from trimesh.exchange.load import load

    for surface, opacity in ((hapjax.Surface(1000.0, mu=0.5), CLEAR), (None, SOLID)):
        data = glb(hapjax.Object(hapjax.Sphere(0.1), surface), (128, 255, 0))
        header = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])
        (material,) = header["materials"]
        assert material["alphaMode"] == "BLEND"  # of which three.js does not write the depth
        colour = material["pbrMetallicRoughness"]["baseColorFactor"]
        np.testing.assert_allclose(colour, [0.22, 1.0, 0.0, opacity], atol=5e-3)
        made: Any = load(io.BytesIO(data), file_type="glb", force="mesh")
        np.testing.assert_allclose(np.linalg.norm(made.vertices, axis=1), 0.1, rtol=1e-6)


def test_turns_and_rods():
    way = np.array([[0, 0, 2.0], [0, 0, -1], [1, 1, 0], [0, -3, 1e-9], [0, 0, 0]])
    turns = from_z(way)
    np.testing.assert_allclose(np.linalg.norm(turns, axis=1), 1)
    size = np.linalg.norm(way[:4], axis=1, keepdims=True)
    np.testing.assert_allclose(matrices(turns[:4])[:, :, 2], way[:4] / size, atol=1e-9)
    np.testing.assert_array_equal(turns[4], [1, 0, 0, 0])
    middle, turn, length = rods(np.array([[[0, 0, 0], [0, 0.2, 0.0]]]))
    np.testing.assert_allclose(middle, [[0, 0.1, 0]])
    ends = placed(np.array([*middle[0], *turn[0]]), np.array([[0, 0, length[0] / 2], [0, 0, -length[0] / 2]]))
    np.testing.assert_allclose(ends, [[0, 0.2, 0], [0, 0, 0]], atol=1e-12)
    vertices, faces = ring(0.9)
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    assert np.sum(np.cross(b - a, c - a)[:, 2]) / 2 == pytest.approx(np.pi * (1 - 0.81), rel=2e-3)


def test_a_hand_reaches_its_fingertips_with_bones_of_one_length():
    tips = np.array([[0.03, 0.0, 0.03], [-0.03, 0.01, 0.03], [-0.03, -0.01, 0.03]])
    made = hand(tips)
    fingers, wrist = made.bones[:-1], made.bones[-1]
    np.testing.assert_allclose(np.linalg.norm(fingers[:, 1] - fingers[:, 0], axis=1), BONE)
    np.testing.assert_array_equal(fingers[3:, 1], tips)
    np.testing.assert_array_equal(fingers[:3, 1], fingers[3:, 0])
    np.testing.assert_allclose(np.linalg.norm(made.joints[:, 0] - made.palm, axis=1), KNUCKLE)
    assert made.joints[0, 1, 0] > tips[0, 0] and np.all(made.joints[1:, 1, 0] < tips[1:, 0])  # bent outward
    assert wrist[0] == pytest.approx(made.palm)
    np.testing.assert_allclose(hand(tips + 1).bones, made.bones + 1)  # it goes along
    far = hand(np.array([[0.5, 0, 0], [-0.5, 0, 0]]))
    assert np.isfinite(far.bones).all() and np.isfinite(hand(np.zeros((1, 3))).bones).all()


SCALES = {
    ("object.cube.surface.mu", 0.6): ("cube: mu", 0.6, 0.0, 1.5, 1e-3),
    ("object.cube.surface.stiffness", 800.0): ("cube: stiffness (N/m)", 800.0, 80.0, 3200.0, 10.0),
    ("object.cube.body.mass", float(np.float32(0.2))): ("cube: mass (g)", 200.0, 20.0, 800.0, 1.0),
    ("torsion.critical_area", float(np.float32(2e-5))): ("torsion: A_crit (mm²)", 20.0, 2.0, 80.0, 0.1),
    ("contact.a_on_b.mu_static[1]", 2.0): ("a_on_b: mu static[1]", 2.0, 0.0, 4.0, 1e-2),
    ("world.gravity[2]", -9.81): ("world: gravity[2]", -9.81, -39.24, -0.981, 0.1),
    ("torsion.twist_damping", 0.0): ("torsion: twist damping (mN m s/rad)", 0.0, 0.0, 1.0, 1e-3),
}


@pytest.mark.parametrize("given", SCALES, ids=lambda given: given[0])
def test_sliders_show_numbers_in_units_that_are_read(given):
    kind = scale(*given)
    label, value, low, high, step = SCALES[given]
    assert (kind.label, kind.shown(given[1]), kind.low, kind.high) == (label, value, low, high)
    assert kind.step == pytest.approx(step)


def test_what_is_set_the_run_gets_and_what_it_refuses_is_taken_back():
    sliders, sent, path = {}, [], "object.cube.body.mass"

    def add(label, **options):
        made = sliders[label] = SimpleNamespace(value=options["initial_value"])
        made.on_update = lambda f: setattr(made, "moved", f)
        return made

    def take(values, timeout):
        if values.get(path, 0) > 0.5:
            raise hapjax.InputError("too heavy")
        sent.append(values)
        return 0

    server = SimpleNamespace(gui=SimpleNamespace(add_slider=add))
    numbers: dict[str, np.ndarray] = {
        path: np.array(0.2, np.float32),
        "object.cube.surface.mu": np.full(3, 0.5),
    }
    made = Sliders(server, take, numbers)
    slider = sliders["cube: mass (g)"]
    assert [*sliders] == ["cube: mass (g)", *(f"cube: mu[{i}]" for i in range(3))]

    def moved(which, value, client: object = "a page"):
        which.value = value
        which.moved(SimpleNamespace(client=client, target=which))
        made.turn(numbers)

    moved(slider, 300.0)
    assert sent.pop() == {path: pytest.approx(0.3)} and made.refused == ""
    moved(sliders["cube: mu[1]"], 0.75)
    np.testing.assert_array_equal(sent.pop()["object.cube.surface.mu"], [0.5, 0.75, 0.5])
    numbers[path] = np.array(0.3, np.float32)
    moved(slider, 600.0)
    assert "too heavy" in made.refused and slider.value == 300.0 and not sent
    moved(slider, 123.0, client=None)  # as when it is set from here
    assert not sent
    numbers[path] = np.array(0.1, np.float32)  # by another process
    made.turn(numbers)
    assert slider.value == 100.0 and not sent


def test_frames_are_a_sixtieth_of_a_second_apart_however_long_one_takes_to_draw(monkeypatch):
    clock = SimpleNamespace(now=5.0)

    def sleep(seconds):
        clock.now += seconds

    monkeypatch.setattr(live, "time", SimpleNamespace(monotonic=lambda: clock.now, sleep=sleep))
    found = []
    for now, takes in zip(live.frames(lambda: False), (0.005, 0.016, 0.001, 0.1, 0.005, 0.0), strict=False):
        found.append(now)
        assert now == pytest.approx(clock.now)
        sleep(takes)
    np.testing.assert_allclose(np.diff(found), [1 / 60, 1 / 60, 1 / 60, 0.1, 1 / 60])
    assert [*live.frames(lambda: True)] == []


def test_an_address_that_cannot_be_is_refused():
    with pytest.raises(hapjax.InputError, match=r"port is 65536; allowed: 0"):
        check("127.0.0.1", 65536)
    with pytest.raises(hapjax.InputError, match="host is ''; allowed: an address"):
        check("", 0)
    with pytest.raises(
        hapjax.InputError, match=r"192.0.2.1:0 cannot be listened at .*; allowed: an address of this"
    ):
        check("192.0.2.1", 0)


def test_a_page_is_served_at_its_address_alone_and_its_end_frees_it(capsys):
    with serving("test", "127.0.0.1", 0, (np.ones(3), np.zeros(3))) as server:
        port = server.get_port()
        assert server.get_host() == "127.0.0.1"
        with pytest.raises(hapjax.InputError, match="free port"):
            check("127.0.0.1", port)
    assert capsys.readouterr().out == f"the viewer is at http://127.0.0.1:{port}\n"
    check("127.0.0.1", port)
    assert not [thread for thread in threading.enumerate() if "asyncio" in thread.name]


ORIGINS = {
    (None, "127.0.0.1:8080"): True,  # no page, but a program
    ("http://127.0.0.1:8080", "127.0.0.1:8080"): True,
    ("http://localhost:9000", "localhost:9000"): True,  # through a tunnel
    ("http://[::1]:8080", "[::1]:8080"): True,
    ("http://192.168.0.7:8080", "192.168.0.7:8080"): True,
    ("http://lab-pc:8080", "lab-pc:8080"): True,
    ("https://example.org", "127.0.0.1:8080"): False,
    ("http://127.0.0.1:3000", "127.0.0.1:8080"): False,  # another server on this computer
    ("http://example.org:8080", "example.org:8080"): False,  # a name that was made to lead here
    ("null", "127.0.0.1:8080"): False,
    ("http://[", "["): False,
}


@pytest.mark.parametrize("origin, asked", ORIGINS)
def test_whose_page_a_request_comes_from(origin, asked, monkeypatch):
    monkeypatch.setattr("socket.gethostname", lambda: "Lab-PC")
    assert is_own(origin, asked, "0.0.0.0") == ORIGINS[origin, asked]


def test_pages_of_others_are_refused():
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect

    with serving("test", "127.0.0.1", 0, (np.ones(3), np.zeros(3))) as server:
        address = f"127.0.0.1:{server.get_port()}"
        options: Any = dict(uri=f"ws://{address}", subprotocols=[f"viser-v{viser.__version__}"], proxy=None)
        options, other = options | {"origin": f"http://{address}"}, {"origin": "http://a.org"}
        with connect(**options) as page:
            assert page.recv(timeout=30)
        with pytest.raises(InvalidStatus, match="403"), connect(**options | other):
            pass


def test_a_slow_page_gets_the_newest_and_not_all_that_was():
    from websockets.sync.client import connect

    with serving("test", "127.0.0.1", 0, (np.ones(3), np.zeros(3))) as server:
        drawn = server.scene.add_point_cloud("/a", np.zeros((1000, 3)), (0, 0, 0), precision="float32")
        options: Any = dict(subprotocols=[f"viser-v{viser.__version__}"], proxy=None, max_queue=1)
        with connect(f"ws://127.0.0.1:{server.get_port()}", **options) as page:
            assert page.recv(timeout=30)
            for now in range(100):
                drawn.points = np.full((1000, 3), now, np.float32)
                server.flush()
                time.sleep(0.01)
            taken, newest = 0, np.full(3000, 99, np.float32).tobytes()
            while newest not in page.recv(timeout=30, decode=False):
                taken += 1
    assert taken < 20  # of a hundred
