"""Scenes as MJCF and URDF, loaded by MuJoCo: what they weigh, how they come to rest, when they slip."""

import itertools
import xml.etree.ElementTree as ET
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import hapjax
from hapjax.benchmark.cases.ball import rebound
from hapjax.exchange.softness import mujoco_solref
from helpers import G, away, matrix, quaternion, well_compiled

mujoco: Any = pytest.importorskip("mujoco")
MASS, MU, STIFFNESS = 0.2, 0.5, 5000.0
HELD, SLIPS = np.arctan(0.95 * MU), np.arctan(1.05 * MU)
# A prism with a step in it: not convex, and its centre beside the middle.
STEP = np.array([(0, 0), (0.06, 0), (0.06, 0.02), (0.03, 0.02), (0.03, 0.05), (0, 0.05)])
TETRAHEDRON = 0.05 * np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0.2, 0.2, 1)])


def stepped():
    """The prism, lying on its broad side, 40 mm deep along y."""
    ends = [np.column_stack([STEP[:, 0], np.full(6, y), STEP[:, 1]]) for y in (0.0, 0.04)]
    cap = [(0, 1, 2), (0, 2, 3), (0, 3, 5), (3, 4, 5)]
    sides = [t for i in range(6) for j in [(i + 1) % 6] for t in ((i, i + 6, j), (j, i + 6, j + 6))]
    triangles = [*cap, *[(c + 6, b + 6, a + 6) for a, b, c in cap], *sides]
    return hapjax.Mesh(np.concatenate(ends), triangles)


# Each with the height of its origin over its lowest point, on how many points MuJoCo has it stand, and whether it may turn.
SHAPES: dict[str, tuple[Any, float, int, bool]] = {
    "box": (hapjax.Box((0.06, 0.05, 0.04)), 0.02, 4, True),
    "cylinder": (hapjax.Cylinder(0.03, 0.04), 0.02, 3, True),
    "sphere": (hapjax.Sphere(0.03), 0.03, 1, False),
    "capsule": (hapjax.Capsule(0.02, 0.05), 0.045, 1, False),
    "convex": (hapjax.Convex(TETRAHEDRON, scale=0.8), 0.0, 3, True),
    "mesh": (stepped(), 0.0, 4, True),
}


def dropped(kind, height=0.005, damping: float | None = 2.0, **options) -> hapjax.Scene:
    """An object a little above a floor."""
    shape, low, _, turns = SHAPES[kind]
    body = hapjax.Body(MASS, rotation=turns)
    pair = hapjax.Contact(STIFFNESS, mu=MU, damping=damping, between=("thing", "floor"))
    objects = {"thing": hapjax.Object(shape, None, body, (0.1, 0, low + height))}
    objects["floor"] = hapjax.Object(hapjax.Plane())
    return hapjax.Scene(
        objects, {"thing_on_floor": pair}, world=hapjax.World(gravity=(0, 0, -G), gyroscopic=turns), **options
    )


class Run:
    """A model in MuJoCo, from a file that was written."""

    def __init__(self, scene, path, own_floor=False):
        self.left_out = hapjax.save_mjcf(scene, path)
        spec = mujoco.MjSpec.from_file(str(path))
        if own_floor:
            spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1])
        self.model = spec.compile()
        self.data = mujoco.MjData(self.model)
        mujoco.mj_forward(self.model, self.data)

    def go(self, seconds, tilt=0.0, ramp=False):
        """Go on with gravity tilted by an angle, reached bit by bit where it is a ramp; how far things moved in x (m)."""
        before, pieces = self.data.body("thing").xpos[0], 50 if ramp else 1
        for i in range(pieces):
            angle = tilt * (i + 1) / pieces
            self.model.opt.gravity[:] = (G * np.sin(angle), 0, -G * np.cos(angle))
            mujoco.mj_step(self.model, self.data, round(seconds / pieces / self.model.opt.timestep))
        return self.data.body("thing").xpos[0] - before


@pytest.mark.parametrize("kind", SHAPES)
def test_what_is_dropped_comes_to_rest_and_slips_at_mu(kind, tmp_path):
    run = Run(dropped(kind), tmp_path / "scene.xml")
    run.go(2.0)
    thing, (_, low, points, _) = run.data.body("thing"), SHAPES[kind]
    assert np.abs(run.data.qvel).max() < 1e-4
    assert run.data.ncon == points
    # Where the points do not stand evenly about the centre, the origin sinks in more or less than their mean.
    share = 0.05 if kind not in ("convex", "mesh") else 0.9
    assert low - thing.xpos[2] == pytest.approx(MASS * G / (points * STIFFNESS), rel=share)
    run.go(1.0, HELD, ramp=True)
    assert run.go(0.5, HELD) < 1e-3
    run.go(0.1, SLIPS)
    assert run.go(0.5, SLIPS) > 0.9 * 0.5 * 0.5**2 * G * (np.sin(SLIPS) - MU * np.cos(SLIPS))


def holds_and_slips(run, kind):
    """Whether it rests as deep as here, and slips at mu, however the slope comes."""
    run.go(1.5)
    _, low, points, _ = SHAPES[kind]
    depth = low - run.data.body("thing").xpos[2]
    assert depth == pytest.approx(MASS * G / (points * STIFFNESS), rel=0.05)
    assert run.go(0.5, HELD, ramp=True) < 2e-4 and abs(run.go(0.3, HELD)) < 1e-5
    run.go(1.0)
    assert run.go(0.5, HELD) < 1e-3 and abs(run.go(0.3, HELD)) < 1e-5
    run.go(0.1, SLIPS)
    assert run.go(0.3, SLIPS) > 0.9 * 0.5 * 0.3**2 * G * (np.sin(SLIPS) - MU * np.cos(SLIPS))


@pytest.mark.parametrize("kind", ["box", "cylinder", "sphere"])
@pytest.mark.parametrize("damping", [None, 0.5, 2.0, 30.0])
def test_a_slope_that_comes_at_once_is_held_with_any_damping(kind, damping, tmp_path):
    scene = dropped(kind, height=0.001, damping=damping)
    holds_and_slips(Run(scene, tmp_path / "scene.xml"), kind)


@pytest.mark.parametrize("damping", [None, 0.5, 30.0])
def test_a_surface_holds_on_a_floor_of_the_users(damping, tmp_path):
    thing, surface = dropped("box", height=0.001), hapjax.Surface(STIFFNESS, mu=MU, damping=damping)
    box = hapjax.Object(thing.object["thing"].shape, surface, hapjax.Body(MASS), (0, 0, 0.021))
    scene = hapjax.Scene({"thing": box}, world=thing.world)
    holds_and_slips(Run(scene, tmp_path / "scene.xml", own_floor=True), "box")


def test_a_cube_put_on_a_slope_comes_to_rest(tmp_path):
    """It sinks in, and slips each time that it is light: by 7 mm here, with a step as short as there."""
    cube = hapjax.Object(hapjax.Box((0.06, 0.06, 0.06)), None, hapjax.Body(0.1), (0, 0, 0.03))
    scene = dropped("box", damping=0.5)
    run = Run(
        hapjax.Scene({**scene.object, "thing": cube}, scene.contact, world=scene.world), tmp_path / "s.xml"
    )
    assert run.go(1.0, HELD) < 7e-3
    assert abs(run.go(0.5, HELD)) < 1e-5


def test_what_slides_fast_stays_down(tmp_path):
    run = Run(dropped("box", height=0.0), tmp_path / "scene.xml")
    run.go(1.0)
    run.data.qvel[0], before = 1.0, run.data.body("thing").xpos[2]
    way = run.go(0.1)
    assert run.data.body("thing").xpos[2] - before < 2e-5
    assert way + run.go(0.5) == pytest.approx(0.5 / (MU * G), rel=0.02)


@pytest.mark.parametrize("damping", [None, 0.1])
def test_the_least_damping_is_told(damping, tmp_path):
    run = Run(dropped("box", damping=damping), tmp_path / "scene.xml")
    given = "none" if damping is None else "0.1 s/m"
    assert run.left_out == (
        f"contact.thing_on_floor.damping is {given}, with which little rests there: 0.5 s/m is written",
    )
    assert f"<!-- {run.left_out[0]} -->" in (tmp_path / "scene.xml").read_text()
    as_written = Run(dropped("box", damping=0.5), tmp_path / "other.xml")
    assert as_written.left_out == ()
    assert (run.model.pair_solref == as_written.model.pair_solref).all()


@pytest.mark.parametrize("kind", ["box", "mesh"])
def test_it_rests_as_here(kind, tmp_path):
    scene, hips = dropped(kind), away(1500)
    _, reply = well_compiled(hapjax.rollout)(scene, hapjax.init(scene, hips[0]), hips)
    rests, (_, low, _, _) = np.asarray(reply.pose[-1, 0]), SHAPES[kind]
    run = Run(scene, tmp_path / "scene.xml")
    run.go(2.0)
    thing, size = run.data.body("thing"), 0.06
    assert rests[2] < low - 5e-5  # it lies on the floor, and deep enough to compare
    assert thing.xpos == pytest.approx(rests[:3], abs=0.05 * size)
    assert thing.xpos[2] == pytest.approx(rests[2], abs=0.05 * (low - rests[2]) if kind == "box" else 1e-4)
    assert matrix(thing.xquat) == pytest.approx(matrix(rests[3:]), abs=0.01)


@pytest.mark.parametrize("kind", SHAPES)
def test_mass_and_inertia_are_those_of_the_object(kind, tmp_path):
    scene = dropped(kind)
    thing = scene.object["thing"]
    hapjax.save_mjcf(scene, tmp_path / "scene.xml")
    hapjax.save_urdf(scene, tmp_path / "thing.urdf")
    urdf = mujoco.MjSpec.from_file(str(tmp_path / "thing.urdf"))
    urdf.body("thing").add_freejoint()
    for model in (mujoco.MjModel.from_xml_path(str(tmp_path / "scene.xml")), urdf.compile()):
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        body, place = model.body("thing"), data.body("thing")
        centre, per_mass = thing.shape.centre(), np.asarray(thing.shape.inertia_per_mass())
        assert body.mass == pytest.approx(MASS)
        assert place.xipos - place.xpos == pytest.approx(
            np.zeros(3) if centre is None else np.asarray(centre), abs=1e-9
        )
        axes = place.ximat.reshape(3, 3)
        full = np.diag(per_mass) if per_mass.ndim == 1 else per_mass
        assert axes @ np.diag(body.inertia) @ axes.T == pytest.approx(MASS * full, rel=1e-6, abs=1e-12)


def test_a_given_centre_and_place_are_kept(tmp_path):
    inertia = np.diag([2e-4, 3e-4, 4e-4]) + 2e-5 * (np.ones((3, 3)) - np.eye(3))
    turn = np.array(quaternion((1, 2, 3), 0.7))
    thing = hapjax.Object(
        hapjax.Box((0.06, 0.05, 0.04)),
        None,
        hapjax.Body(MASS, inertia, (1e-3, 2e-3, 3e-3)),
        (1, 2, 3),
        2 * turn,
    )
    run = Run(hapjax.Scene({"thing": thing}), tmp_path / "scene.xml")
    place, body = run.data.body("thing"), run.model.body("thing")
    assert place.xpos == pytest.approx([1, 2, 3]) and place.xquat == pytest.approx(turn)
    assert place.xipos == pytest.approx([1, 2, 3] + matrix(turn) @ [1e-3, 2e-3, 3e-3])
    axes = matrix(turn).T @ place.ximat.reshape(3, 3)
    assert axes @ np.diag(body.inertia) @ axes.T == pytest.approx(inertia)
    assert run.model.opt.gravity == pytest.approx([0, 0, 0])


def test_names_are_not_given_twice(tmp_path):
    ball = hapjax.Sphere(0.03)
    objects = {"a": hapjax.Object(ball, None, hapjax.Body(MASS, rotation=False))}
    objects |= {f"a_{axis}": hapjax.Object(ball, None, hapjax.Body(MASS)) for axis in "xyz"}
    assert Run(hapjax.Scene(objects), tmp_path / "scene.xml").model.nv == 3 + 3 * 6
    with pytest.raises(hapjax.InputError, match="object is named 'world', .* allowed: any other"):
        hapjax.save_mjcf(hapjax.Scene({"world": objects["a"]}), tmp_path / "other.xml")
    assert not (tmp_path / "other.xml").exists()


# What touches what ----------------------------------------------------------------------------------------


def in_touch(model, data):
    mujoco.mj_forward(model, data)
    return {frozenset(model.geom(g).name for g in data.contact.geom[i]) for i in range(data.ncon)}


def test_only_named_pairs_touch_and_a_finger_feels_surfaces(tmp_path):
    """Three balls in one place, of which two are a pair and one is felt; and a finger of the user's there too."""
    ball = hapjax.Sphere(0.03)
    soft = hapjax.Surface(800.0, mu=0.4, damping=1.0)
    objects = {
        "felt": hapjax.Object(ball, soft, hapjax.Body(MASS)),
        "one": hapjax.Object(ball, None, hapjax.Body(MASS)),
        "two": hapjax.Object(ball, None, hapjax.Body(3 * MASS), (0.02, 0, 0)),
    }
    pair = hapjax.Contact(STIFFNESS, mu=MU, damping=0.5, between=("one", "two"))
    scene = hapjax.Scene(objects, {"pair": pair}, torsion=hapjax.SoftFinger(2e-3, 0.1))
    assert hapjax.save_mjcf(scene, tmp_path / "scene.xml") == ()
    spec = mujoco.MjSpec.from_file(str(tmp_path / "scene.xml"))
    finger = spec.worldbody.add_body(name="finger", mocap=True, pos=[0, 0, 0.0395])
    finger.add_geom(name="finger", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0, 0], friction=[9, 9, 9])
    model = spec.compile()
    data = mujoco.MjData(model)
    assert in_touch(model, data) == {frozenset(("one", "two")), frozenset(("felt", "finger"))}
    felt = next(c for c in data.contact if "felt" in [model.geom(g).name for g in c.geom])
    assert felt.friction[[0, 2]] == pytest.approx([0.4, 2e-3]) and felt.dim == 4
    # Held by the finger from above it yields by weight / stiffness; 1/m counts both balls of a pair.
    damping, both = 0.4 / (3 * np.pi) * np.sqrt(800 / MASS), 1 / MASS + 1 / (3 * MASS)
    assert felt.solref == pytest.approx(mujoco_solref(800.0, 1 / MASS, damping, felt.solimp[0]))
    damping = 0.2 / (3 * np.pi) * np.sqrt(STIFFNESS * both)
    assert model.pair_solref[0] == pytest.approx(mujoco_solref(STIFFNESS, both, damping, 0.001))


def test_a_finger_presses_with_the_stiffness_of_the_surface(tmp_path):
    """A ball that weighs on a fixed finger from above sinks into it by m g / k."""
    ball = hapjax.Object(
        hapjax.Sphere(0.03), hapjax.Surface(800.0, mu=0.4, damping=3.0), hapjax.Body(MASS, rotation=False)
    )
    hapjax.save_mjcf(hapjax.Scene({"thing": ball}, world=hapjax.World((0, 0, -G))), tmp_path / "scene.xml")
    spec = mujoco.MjSpec.from_file(str(tmp_path / "scene.xml"))
    finger = spec.worldbody.add_body(name="finger", mocap=True, pos=[0, 0, -0.04])
    finger.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0, 0])
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, 2000)
    assert -data.body("thing").xpos[2] == pytest.approx(MASS * G / 800.0, rel=0.01)


@pytest.mark.parametrize("stiffness", [500.0, 50_000.0])
def test_a_bounce_at_the_speed_of_putting_down_loses_as_much(stiffness, tmp_path):
    loss, speed = 1.5, 0.1
    ball = hapjax.Object(hapjax.Sphere(0.03), None, hapjax.Body(MASS), (0, 0, 0.031))
    pair = hapjax.Contact(stiffness, mu=MU, damping=loss, between=("thing", "floor"))
    scene = hapjax.Scene({"thing": ball, "floor": hapjax.Object(hapjax.Plane())}, {"pair": pair})
    run = Run(scene, tmp_path / "scene.xml")
    run.data.qvel[2] = -speed
    mujoco.mj_step(run.model, run.data, round(0.1 / run.model.opt.timestep))
    assert run.data.ncon == 0
    assert run.data.qvel[2] == pytest.approx(rebound(loss, speed), rel=0.02)


def test_a_stiff_contact_has_a_shorter_step(tmp_path):
    scene = dropped("box", integrator=hapjax.Implicit(dt=0.01))
    stiff = hapjax.Contact(1e6, mu=MU, damping=2.0, between=("thing", "floor"))
    run = Run(
        hapjax.Scene(scene.object, {"stiff": stiff}, None, scene.world, scene.integrator), tmp_path / "s.xml"
    )
    assert run.model.opt.timestep < 1e-4
    run.go(1.0)
    assert run.data.body("thing").xpos[2] == pytest.approx(0.02 - MASS * G / 4e6, abs=1e-7)


# What is left out, and refused ----------------------------------------------------------------------------


def test_what_has_no_word_is_told(tmp_path):
    surface = hapjax.Surface(
        800.0,
        mu_static=(0.3, 0.4, 0.5, 0.6, 0.7, 0.8),
        mu_kinetic=(0.2,) * 6,
        tangential_stiffness=500.0,
        anisotropy=0.5,
        grain=(1, 0, 0),
        friction=hapjax.Stribeck(0.01),
        finger_mu=(1.0,),
    )
    box = hapjax.Object(hapjax.Box((0.06, 0.05, 0.04)), surface, hapjax.Body(MASS))
    wall = hapjax.Object(stepped(), hapjax.Surface(500.0, mu=0.3))
    world = hapjax.World(dead_band=0.01)
    scene = hapjax.Scene({"box": box, "wall": wall}, torsion=hapjax.GravityDrop(1e-5), world=world)
    of_box = ["tangential_stiffness", "anisotropy", "finger_mu", "mu_kinetic", "friction", "mu"]
    told = [sentence.split(" ")[0] for sentence in hapjax.save_mjcf(scene, tmp_path / "scene.xml")]
    expected = ["torsion", "world.dead_band", *(f"object.box.surface.{each}" for each in of_box)]
    of_wall = ["object.wall.shape", "object.wall.surface.stiffness"]
    assert told == [*expected, *of_wall, "object.box.surface.damping"]
    geom = ET.parse(tmp_path / "scene.xml").getroot().find("worldbody/body/geom")
    assert geom is not None and float(geom.attrib["friction"].split()[0]) == pytest.approx(0.55)
    mujoco.MjModel.from_xml_path(str(tmp_path / "scene.xml"))
    told = [sentence.split(" ")[0] for sentence in hapjax.save_urdf(scene, tmp_path / "box.urdf")]
    expected.remove("object.box.surface.mu_kinetic")
    assert told == [*expected, "object.wall"]


def test_a_urdf_has_the_numbers_of_the_contact(tmp_path):
    scene = dropped("box")
    told = hapjax.save_urdf(scene, tmp_path / "thing.urdf")
    assert told == ("object.floor is left out: a URDF is of one object",)
    root = ET.parse(tmp_path / "thing.urdf").getroot()
    found = {e.tag.split("}")[-1]: float(e.attrib["value"]) for e in root.iter() if "value" in e.attrib}
    drake = {"point_contact_stiffness": STIFFNESS, "hunt_crossley_dissipation": 2.0, "mu_static": MU}
    swing = 0.4 / (3 * np.pi) * np.sqrt(STIFFNESS / MASS)
    bullet = {"lateral_friction": MU, "stiffness": STIFFNESS, "damping": 2.0 * MASS * (G + swing)}
    assert found == pytest.approx({"mass": MASS, "mu_dynamic": MU, **drake, **bullet})


def test_single_precision_is_written_by_its_own_decimals(tmp_path):
    scene = hapjax.cast(dropped("box"), jnp.float32)
    hapjax.save_urdf(scene, tmp_path / "thing.urdf")
    text = (tmp_path / "thing.urdf").read_text()
    assert '<mass value="0.2" />' in text and 'size="0.06 0.05 0.04"' in text


def test_nothing_is_written_by_halves(tmp_path, monkeypatch):
    scene, before = dropped("mesh"), b"<mujoco/>"
    (tmp_path / "scene.xml").write_bytes(before)
    (tmp_path / "scene_thing.obj").mkdir()
    with pytest.raises(hapjax.InputError, match=r"scene_thing.obj: cannot be written"):
        hapjax.save_mjcf(scene, tmp_path / "scene.xml")
    assert (tmp_path / "scene.xml").read_bytes() == before and len(list(tmp_path.iterdir())) == 2


def test_a_mesh_of_the_scene_is_not_overwritten(tmp_path):
    hapjax.save_mjcf(dropped("mesh"), tmp_path / "scene.xml")
    thing = hapjax.Object(hapjax.load_mesh(tmp_path / "scene_thing.obj", scale=0.1), None, hapjax.Body(1.0))
    for save, suffix in ((hapjax.save_mjcf, "xml"), (hapjax.save_urdf, "urdf")):
        with pytest.raises(hapjax.InputError, match=r"scene_thing.obj: is a mesh of the scene"):
            save(hapjax.Scene({"thing": thing}), tmp_path / f"scene.{suffix}")


def test_files_with_other_endings_and_absent_objects_are_refused(tmp_path):
    scene = dropped("box")
    for save, suffix in ((hapjax.save_mjcf, ".xml"), (hapjax.save_urdf, ".urdf")):
        with pytest.raises(hapjax.InputError, match=rf"ending '.txt'; allowed: {suffix}"):
            save(scene, tmp_path / "scene.txt")
    for name, words in (("floor", "'floor', .* allowed: thing"), ("wall", "'wall', .* allowed: thing")):
        with pytest.raises(hapjax.InputError, match=words):
            hapjax.save_urdf(scene, tmp_path / "thing.urdf", name)
    both = dict(itertools.chain(scene.object.items(), [("other", scene.object["thing"])]))
    with pytest.raises(hapjax.InputError, match="2 objects have a body, .* allowed: thing, other"):
        hapjax.save_urdf(hapjax.Scene(both), tmp_path / "thing.urdf")
    assert not list(tmp_path.iterdir())
