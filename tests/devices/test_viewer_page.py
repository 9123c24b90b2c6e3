"""The viewer's page in a browser: opened, dragged, its sliders moved, and what the run then feels: `make viewer-test`."""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

import hapjax
from hapjax_devices import TickReader
from hapjax_devices.viewer.hand import PALM

CHROMIUM = os.environ.get("HAPJAX_CHROMIUM")
pytestmark = pytest.mark.skipif(not CHROMIUM, reason="runs where chromium is installed: make viewer-test")

CUBE = """
[object.cube]
shape = "box"
size = [0.06, 0.06, 0.06]
position = [0.0, 0.0, 0.03]
[object.cube.surface]
mu = 0.6
stiffness = 800.0
damping = 1.0
[object.cube.body]
mass = 0.1
[object.floor]
shape = "plane"
[contact.cube_on_floor]
between = ["cube", "floor"]
mu = 0.5
stiffness = 5000.0
damping = 0.5
[torsion]
model = "gravity_drop"
critical_area = 2.0e-5
twist_damping = 1.0e-4
[world]
gravity = [0.0, 0.0, -9.81]
"""
ARGUMENTS = ["--headless=new", "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
WIDE = {"width": 1400, "height": 900}
MUTED = (
    "Unable to preventDefault inside passive event listener"  # Chromium's remark on how viser takes the wheel
)


class Page:
    """A page of the viewer in Chromium.

    **Attributes:** `failed`, the errors that it has told of.
    """

    def __init__(self, browser, url, scene):
        from hapjax_devices.viewer.stage import camera

        self.page, self.failed = browser.new_page(viewport={"width": 1000, "height": 700}), []
        self.page.on("pageerror", lambda error: self.failed.append(str(error)))
        self.page.on(
            "console",
            lambda said: (
                self.failed.append(said.text) if said.type == "error" and MUTED not in said.text else None
            ),
        )
        self.page.set_default_timeout(90_000)
        self.page.goto(url)
        self.page.get_by_text("force on the fingers").wait_for()
        self.page.wait_for_timeout(3000)  # the scene has been drawn by then
        self._canvas = self.page.locator("canvas").first.bounding_box()
        self._eye, self._target = camera(scene)

    def pixel(self, point):
        """Where on the page a point (m) of the scene is, while the camera is as at first."""
        from hapjax_devices.viewer.server import FIELD_OF_VIEW

        box = self._canvas
        forward = self._target - self._eye
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, [0, 0, 1])
        right /= np.linalg.norm(right)
        way = point - self._eye
        size = box["height"] / 2 / np.tan(FIELD_OF_VIEW / 2) / (way @ forward)
        up = np.cross(right, forward)
        return np.array([box["width"] / 2 + size * (way @ right), box["height"] / 2 - size * (way @ up)])

    def drag(self, point, to):
        """Drag what is seen at a point (m) to where another is seen."""
        start, end = self.pixel(point), self.pixel(to)
        self.page.mouse.move(*start)
        self.page.mouse.down()
        for share in np.linspace(0, 1, 9)[1:]:
            self.page.mouse.move(*(start + share * (end - start)))
            self.page.wait_for_timeout(50)
        self.page.mouse.up()

    def input(self, label):
        """What a user sets what is called so in: of a slider the number beside it."""
        row = self.page.get_by_text(label, exact=True).locator("xpath=ancestor::div[.//input][1]")
        return row.locator("input").last

    def enter(self, label, number):
        """Set a slider by the number beside it."""
        self.input(label).fill(str(number))
        self.input(label).press("Enter")

    def shows(self, label, number):
        """Wait until the page shows a number there."""
        from playwright.sync_api import expect

        expect(self.input(label)).to_have_value(number, timeout=90_000)

    def picture(self, other_than=b""):
        """What is seen of the scene once it stands still for a second."""
        end, before = time.monotonic() + 60, b""
        while time.monotonic() < end:
            seen = self.page.screenshot(clip={"x": 0, "y": 0, "width": 550, "height": 700})
            if seen == before != other_than:
                return seen
            before = seen
            self.page.wait_for_timeout(1000)
        raise AssertionError("the scene does not stand still, or is as it was")

    def plotted(self):
        """The newest that the plot of forces has: when (s), and the force (N) on each finger."""
        chart = "Object.values(window.__viserTestpoints.uplots)[0].chart"
        when, *forces, _ = self.page.evaluate(f"{chart}.data.map(each => each.at(-1))")
        return when, forces

    def stands_out(self, point, file):
        """By how much what is small and at a point (m) is darker than what is 5 pixels above it and below it, of 1."""
        self.page.screenshot(path=file)
        x, y = np.round(self.pixel(point)).astype(int)
        spot = plt.imread(file)[y - 6 : y + 7, x - 1 : x + 2, :3].mean(axis=2)
        return min(spot[:2].mean(), spot[-2:].mean()) - spot[4:9].min(axis=0).mean()

    def keep(self, name):
        """Keep a picture of it."""
        self.page.set_viewport_size(WIDE)
        self.page.wait_for_timeout(500)
        folder = Path(os.environ.get("HAPJAX_PICTURES", ".pytest_cache/viewer"))
        folder.mkdir(parents=True, exist_ok=True)
        self.page.screenshot(path=folder / name)
        assert (folder / name).stat().st_size > 20_000


@pytest.fixture(scope="module")
def browser():
    with pytest.importorskip("playwright.sync_api").sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield chromium
        chromium.close()


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("page")
    (made / "cube.toml").write_text(CUBE)
    return made


class Command:
    """`hapjax` with arguments; `url`, where it says that its page is."""

    def __init__(self, *arguments):
        command = [sys.executable, "-c", "import hapjax_command; hapjax_command.run()", *map(str, arguments)]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        assert self.process.stdout is not None
        said = self.process.stdout.readline()
        found = re.search(r"http://127\.0\.0\.1:\d+", said)
        assert found is not None, said
        self.url = found[0]

    def end(self):
        self.process.terminate()
        self.process.communicate(timeout=60)
        return self.process.returncode


def until(reader, wanted):
    """The first tick that is as wanted, and the last that came before it."""
    end, before = time.monotonic() + 60, np.zeros(1, reader.about.tick)[0]
    while time.monotonic() < end and reader.is_alive():
        for tick in reader.take():
            if wanted(tick):
                return tick
            before = tick
        time.sleep(0.02)
    raise AssertionError(
        f"it does not become so; the last tick has hip {before['hip']}, force {before['force']}"
    )


def plots_now(page, reader):
    """Whether the page comes to plot what was felt half a second ago or less."""
    end = time.monotonic() + 60
    while time.monotonic() < end:
        page.page.wait_for_timeout(600)
        when, forces = page.plotted()
        (same,) = np.nonzero((ticks := reader.take())["tick"] == round(when * reader.about.rate))
        if len(same) and ticks["tick"][-1] < (when + 0.5) * reader.about.rate:
            return np.allclose(forces, np.linalg.norm(ticks["force"][same[0]], axis=1), atol=1e-6)
    return False


def normal_forces(tick):
    return np.abs(tick["force"][:, 0])


def test_anyone_grasps_the_cube(browser, folder):
    name = f"page-{os.getpid()}"
    arguments = [
        "--device",
        "browser",
        "browser",
        "--port",
        "0",
        "--name",
        name,
        "--record",
        folder / "a.mcap",
    ]
    command = Command("run", folder / "cube.toml", *arguments)
    try:
        scene = hapjax.load_scene(folder / "cube.toml")
        with TickReader(name, 60.0) as reader:
            places = np.array(reader.about.pose_at[0])
            page = Page(browser, command.url, scene)
            tick = until(reader, lambda tick: True)
            page.drag(tick["hip"][1], tick["hip"][1] + [0, 0, 0.015])
            tick = until(reader, lambda tick: tick["hip"][1, 2] > 0.038)
            assert abs(tick["hip"][0, 2] - 0.03) < 1e-3 and not tick["force"].any()
            page.drag(tick["hip"][1], tick["hip"][1] - [0, 0, tick["hip"][1, 2] - 0.03])
            until(reader, lambda tick: tick["hip"][1, 2] < 0.036)
            page.enter("grip (mm)", 12)
            soft = until(reader, lambda tick: normal_forces(tick).min() > 1.5)
            page.enter("cube: stiffness (N/m)", 1600)
            until(reader, lambda tick: normal_forces(tick).min() > 1.15 * normal_forces(soft).max())
            tick = until(reader, lambda tick: True)
            palm = tick["hip"].mean(axis=0) + PALM
            page.drag(palm, palm + [0, 0, 0.025])
            tick = until(reader, lambda tick: tick["memory"][places[2]] > 0.04)
            page.page.wait_for_timeout(1000)
            assert plots_now(page, reader)
            page.keep("grasp.png")
            assert until(reader, lambda tick: True)["memory"][places[2]] > 0.04  # it is held
        assert page.failed == []
        command.end()
        page.page.get_by_text("The run has ended.").wait_for()
        page.page.close()
    finally:
        assert command.end() == 0


def test_a_recording_is_played_back_where_the_time_bar_says(browser, folder):
    t = np.arange(0, 2, 0.01)
    grip = 0.036 - 0.011 * np.clip(t / 0.3, 0, 1)
    rise = 0.03 + 0.04 * np.clip((t - 0.5) / 1.0, 0, 1)
    hip = np.stack([np.stack([side * grip, 0 * t, rise], axis=1) for side in (-1, 1)], axis=1)
    hapjax.Recording(hip=hip, hip_t=t).save(folder / "lift.npz")
    command = Command("view", folder / "lift.npz", "--scene", folder / "cube.toml", "--port", "0")
    try:
        page = Page(browser, command.url, hapjax.load_scene(folder / "cube.toml"))
        page.input("playing").uncheck(force=True)
        page.enter("time (s)", 0.1)
        before = page.picture()
        page.enter("time (s)", 1.9)
        page.shows("time (s)", "1.900")  # also after what came late of the playing
        page.picture(other_than=before)
        for x in (0.03, 0.0275, 0.025):  # the god-object, the line, the HIP
            assert page.stands_out(np.array([x, 0.0, 0.0695]), folder / "seen.png") > 0.1, x
        page.keep("replay.png")
        assert page.failed == []
        page.page.close()
    finally:
        assert command.end() == 0
