"""What the documentation shows is what the program reads, does and prints."""

import contextlib
import io
import json
import re
import shlex
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import hapjax
import hapjax_devices
import hapjax_fitting
from hapjax import cli

DOCS = Path(__file__).resolve().parents[1] / "docs"


def blocks(page):
    """The blocks of code of a page, each as (language, text)."""
    return re.findall(r"^```(\w+)\n(.*?)^```$", (DOCS / page).read_text(), re.DOTALL | re.MULTILINE)


def block(page, language):
    """The first block of code in a language."""
    found = [text for kind, text in blocks(page) if kind == language]
    assert found, f"{page} has no block of {language}"
    return found[0]


def test_the_scene_file_is_read(tmp_path):
    path = tmp_path / "cube.toml"
    path.write_text(block("scene_file.md", "toml"))
    scene = hapjax.load_scene(path)
    assert scene.moving() == ["cube"]
    assert scene.object["cube"].surface is not None
    assert float(scene.object["cube"].surface.stiffness) == pytest.approx(800)


def test_the_recording_is_read(tmp_path):
    path = tmp_path / "recording.csv"
    path.write_text(block("recording.md", "text"))
    recording = hapjax.Recording.load(path)
    np.testing.assert_array_equal(recording.force_t, [0, 0.01])
    np.testing.assert_array_equal(recording.hip_t, [0, 0.001, 0.002, 0.01])


# Programs, and what they print ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    "page",
    [
        "../README.md",
        "index.md",
        "devices.md",
        "hardware.md",
        pytest.param("physics.md", marks=pytest.mark.slow),
    ],
)
def test_a_program_prints_what_is_shown_below_it(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shown = blocks(page)
    places = [i for i, (kind, _) in enumerate(shown) if kind == "python"]
    assert len(places) == 1
    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        exec(compile(shown[places[0]][1], page, "exec"), {"__name__": "__main__"})
    assert printed.getvalue() == shown[places[0] + 1][1]


# The command line -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """A folder with the cube that is shown, held fast to be quick, and a finger's stroke over it."""
    folder = tmp_path_factory.mktemp("shell")
    path = folder / "cube.toml"
    path.write_text(block("scene_file.md", "toml"))
    cube = hapjax.load_scene(path).object["cube"]
    hapjax.save_scene(
        hapjax.Scene({"cube": hapjax.Object(cube.shape, cube.surface, None, cube.position)}), path
    )
    t = np.arange(150) / 1000
    stroke = np.stack([0.1 * (t - 0.075), 0 * t, 0.0605 - 0.02 * t], axis=-1)[:, None]
    hapjax.Recording(hip=stroke, hip_t=t).save(folder / "lift.npz")
    return folder


def section(command):
    """What the page says of one command."""
    found = re.search(rf"^## `hapjax {command}`$(.*?)(?=^## |\Z)", text(), re.DOTALL | re.MULTILINE)
    assert found, f"command_line.md has no section of {command}"
    return found[1]


def text():
    return (DOCS / "command_line.md").read_text()


def shell(line, capsys):
    """The exit code of a command line, and what it wrote to stderr."""
    program, *arguments = shlex.split(line)
    assert program == "hapjax"
    code = cli.main(arguments)
    return code, capsys.readouterr().err


def test_every_command_is_described():
    assert re.findall(r"^## `hapjax (\w+)`$", text(), re.MULTILINE) == list(cli.COMMANDS)


@pytest.mark.parametrize("command", cli.COMMANDS)
def test_every_option_is_described(command, capsys):
    with pytest.raises(SystemExit) as ended:
        cli.main([command, "--help"])
    assert ended.value.code == 0
    offered = set(re.findall(r"--\w[\w-]*", capsys.readouterr().out)) - {"--help"}
    assert set(re.findall(r"^\| `(--[\w-]+)`", section(command), re.MULTILINE)) == offered


@pytest.mark.slow
def test_examples_run(files, monkeypatch, capsys):
    monkeypatch.chdir(files)
    simulate, fit = (re.findall(r"^hapjax .*", section(c), re.MULTILINE)[0] for c in ("simulate", "fit"))
    assert shell(simulate, capsys)[0] == 0
    answer = hapjax.Recording.load("answer.csv")
    assert answer.force is not None
    noisy = answer.force + np.random.default_rng(0).normal(0, 0.01, answer.force.shape)
    hapjax.Recording(hip=answer.hip, hip_t=answer.hip_t, force=noisy, force_t=answer.force_t).save("lift.npz")
    assert shell(f"{fit} --starts 1", capsys)[0] == 0
    found, shown = json.loads(Path("fit.json").read_text()), json.loads(block("command_line.md", "json"))
    assert found.keys() == shown.keys()
    assert found["parameters"].keys() == {"object.cube.surface.mu", "object.cube.surface.stiffness"}
    mu, as_shown = (x["parameters"]["object.cube.surface.mu"] for x in (found, shown))
    assert mu.keys() == as_shown.keys() and found["residual_rms"].keys() <= shown["residual_rms"].keys()
    assert mu["estimate"] == pytest.approx(0.6, rel=0.05)


def test_the_refusal_is_what_is_shown(files, monkeypatch, capsys):
    monkeypatch.chdir(files)
    line, sentence, _, code = block("command_line.md", "console").splitlines()
    assert shell(line.removeprefix("$ "), capsys) == (int(code), f"{sentence}\n")


# The reference --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("package", [hapjax, hapjax_fitting, hapjax_devices])
def test_every_public_name_is_in_the_reference(package):
    own = re.findall(r"^from \.\S+ import \w+ as (\w+)$", Path(package.__file__).read_text(), re.MULTILINE)
    assert own
    pages = "".join(page.read_text() for page in DOCS.glob("*.md"))
    described = set(re.findall(r"^::: (\S+)$", pages, re.MULTILINE))
    linked = (DOCS / "reference.md").read_text()
    for name in (f"{package.__name__}.{n}" for n in own):
        assert name in described and re.search(rf"(::: |\[){re.escape(name)}\b", linked), name


# Figures that the text tells ------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_cube_settles_on_stiff_contacts_as_told():
    lines = " ".join((DOCS / "physics.md").read_text().split())
    assert "it settles at 20 kN/m and is thrown about at 50 kN/m" in lines
    assert "it settles at 1 MN/m and is thrown about at 10 MN/m" in lines
    for substeps, settles, does_not in ((1, 20e3, 50e3), (10, 1e6, 10e6)):
        assert highest(settles, substeps) < 0.0425  # on a face, or still on its way to one
        assert highest(does_not, substeps) > 0.1


def highest(stiffness, substeps):
    """How high (m) the 50 g cube is during the second after its first one on the floor."""
    tilted = np.array([0.94020, 0.13917, 0.30944, 0.02984])  # by 20, 35 and 10 degrees about x, y and z
    cube = hapjax.Object(hapjax.Box((0.06,) * 3), None, hapjax.Body(0.05), (0, 0, 0.08), tilted)
    pair = hapjax.Contact(stiffness, mu=0.5, damping=1.0, between=("cube", "floor"))
    scene = hapjax.Scene(
        {"cube": cube, "floor": hapjax.Object(hapjax.Plane())},
        {"cube_on_floor": pair},
        world=hapjax.World(gravity=(0, 0, -9.81), gyroscopic=True),
        integrator=hapjax.SemiImplicit(substeps=substeps),
    )
    hips = jnp.full((2000, 1, 3), 9.0)
    _, reply = hapjax.rollout(scene, hapjax.init(scene, hips[0]), hips)
    return float(reply.pose[1000:, 0, 2].max())
