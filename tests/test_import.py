"""MJCF and URDF as scenes: what MuJoCo makes of the same file is the truth; files that are refused."""

import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

import hapjax
from hapjax.body import centre_within, inertia_of
from hapjax.cli import main
from helpers import matrix
from test_export import SHAPES, dropped

mujoco: Any = pytest.importorskip("mujoco")
BOX = trimesh.creation.box((0.06, 0.04, 0.02))

MJCF = """
<mujoco>
  <compiler angle="radian" eulerseq="XYZ" meshdir="parts" strippath="true"/>
  <option gravity="0 0 -1"/><option gravity="0 0 -9.7" timestep="0.001"/>
  <default><geom density="500"/></default>
  <default>
    <default class="heavy"><geom density="4000" type="box" size="0.01 0.02 0.03"/></default>
    <default class="turned"><geom euler="0.1 0.2 0.3" density="2000"/></default>
    <default class="seen"><geom contype="0" conaffinity="0" mass="0"/></default>
  </default>
  <asset><mesh name="brick" file="far/away/brick.stl" scale="0.5 0.5 0.5"/></asset>
  <worldbody>
    <light pos="0 0 3"/>
    <geom name="floor" type="plane" size="1 1 0.1"/>
    <body name="by class" pos="0 0 1" childclass="heavy"><freejoint/><geom/></body>
    <body name="by hand" pos="1 0 1" euler="0.1 0.2 0.3"><freejoint/>
      <inertial pos="0.01 0.02 0.03" mass="0.3" quat="1 2 3 4" diaginertia="2e-4 3e-4 4e-4"/>
      <geom type="cylinder" size="0.02 0.03" pos="0.1 0 0" axisangle="0 1 1 0.5"/>
      <geom class="seen" type="sphere" size="0.5"/></body>
    <body name="full" pos="1 1 1" xyaxes="0 1 0 -1 0.5 0"><joint type="free"/>
      <inertial pos="0.01 0 0" mass="0.3" fullinertia="2e-4 3e-4 4e-4 1e-5 2e-5 3e-5"/>
      <geom type="capsule" size="0.02" fromto="0.1 0 0 0.1 0.2 0.1"/></body>
    <body name="mesh" pos="2 0 1" zaxis="1 0 1"><freejoint/><geom type="mesh" mesh="brick" mass="0.4"/></body>
    <frame pos="0 3 0" quat="1 0 0 1"><body name="of several" pos="0 0 1"><freejoint/>
      <geom type="box" size="0.01" fromto="0 0 0 0.1 0.1 0"/>
      <body pos="0.1 0 0" quat="1 1 0 0"><geom class="seen" type="sphere" size="0.03" mass="0.2"/></body>
      <body pos="0 0.1 0" quat="1 0 1 0"><geom class="seen" type="sphere" size="0.03" mass="9"/>
        <inertial pos="0 0 0.1" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/></body>
    </body></frame>
    <body name="own way" pos="0 5 1" childclass="turned"><freejoint/>
      <geom type="box" size="0.01 0.02 0.03" quat="1 0 0 1"/></body>
    <body name="post" pos="4 0 0"><geom type="sphere" size="0.03"/></body>
  </worldbody>
</mujoco>
"""

URDF = """
<robot name="2 pieces">
  <material name="grey"><color rgba="1 1 1 1"/></material>
  <link name="base"><inertial><origin xyz="0.01 0 0" rpy="0.1 0.2 0.3"/><mass value="0.2"/>
    <inertia ixx="2e-4" ixy="1e-5" ixz="0" iyy="3e-4" iyz="0" izz="4e-4"/></inertial>
    <visual><geometry><sphere radius="0.5"/></geometry></visual>
    <collision><origin xyz="0 0 0.05" rpy="0 0.4 0"/><geometry><box size="0.06 0.04 0.02"/></geometry></collision></link>
  <link name="tip"><inertial><mass value="0.1"/>
    <inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/></inertial></link>
  <link name="cap"><inertial><origin xyz="0 0.02 0"/><mass value="0.05"/>
    <inertia ixx="1e-5" ixy="0" ixz="0" iyy="2e-5" iyz="0" izz="1e-5"/></inertial></link>
  <joint name="more" type="fixed"><parent link="tip"/><child link="cap"/><origin xyz="0.1 0 0" rpy="1 0 0"/></joint>
  <joint name="glue" type="fixed"><parent link="base"/><child link="tip"/><origin xyz="0 0 0.1" rpy="0 0 1"/></joint>
</robot>
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "parts").mkdir()
    BOX.export(tmp_path / "parts" / "brick.stl")
    (tmp_path / "model.xml").write_text(MJCF)
    (tmp_path / "robot.urdf").write_text(URDF)
    return tmp_path


def as_here(thing, body, place):
    """Whether an object weighs what MuJoCo's body does, about the same point of space."""
    turn, inertia = matrix(thing.orientation), np.asarray(inertia_of(thing.body, thing.shape))
    inertia = np.diag(inertia) if inertia.ndim == 1 else inertia
    centre = centre_within(thing.body, thing.shape)
    centre = np.zeros(3) if centre is None else np.asarray(centre)
    axes = place.ximat.reshape(3, 3)
    assert float(thing.body.mass) == pytest.approx(body.mass[0])
    assert np.asarray(thing.position) + turn @ centre == pytest.approx(place.xipos, abs=1e-9)
    assert turn @ inertia @ turn.T == pytest.approx(
        axes @ np.diag(body.inertia) @ axes.T, rel=1e-6, abs=1e-12
    )


def test_mjcf_is_read_as_mujoco_reads_it(folder):
    scene = hapjax.load_model(folder / "model.xml")
    spec = mujoco.MjSpec.from_file(str(folder / "model.xml"))
    spec.compiler.fusestatic = True
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    names = ["by class", "by hand", "full", "mesh", "of several", "own way"]
    assert list(scene.object) == ["floor", *(n.replace(" ", "_") for n in names), "post"]
    for name in names:
        as_here(scene.object[name.replace(" ", "_")], model.body(name), data.body(name))
    assert scene.moving() == list(scene.object)[1:-1]
    kinds = [type(thing.shape).__name__ for thing in scene.object.values()]
    assert kinds == ["Plane", "Box", "Cylinder", "Capsule", "Mesh", "Box", "Box", "Sphere"]
    for name, kind in zip(names, kinds[1:], strict=False):
        thing: Any
        thing, geom = scene.object[name.replace(" ", "_")], int(model.body(name).geomadr[0])
        if kind == "Mesh":
            assert float(thing.shape.volume()) == pytest.approx(BOX.volume / 8)
            continue
        sizes = {
            "Box": lambda s: s.size / 2,
            "Cylinder": lambda s: np.array([s.radius, s.length / 2]),
            "Capsule": lambda s: np.array([s.radius, s.length / 2]),
        }[kind](thing.shape)
        assert np.asarray(sizes) == pytest.approx(model.geom_size[geom][: len(sizes)])
        assert np.asarray(thing.position) == pytest.approx(data.geom_xpos[geom])
        assert matrix(thing.orientation) == pytest.approx(data.geom_xmat[geom].reshape(3, 3))
    assert np.asarray(scene.world.gravity) == pytest.approx(model.opt.gravity)
    body = scene.object["by_class"].body
    assert body is not None and body.inertia is None  # of uniform density, and it says so


def test_urdf_is_read_as_mujoco_reads_it(folder):
    scene = hapjax.load_model(folder / "robot.urdf")
    spec = mujoco.MjSpec.from_file(str(folder / "robot.urdf"))
    spec.compiler.fusestatic = True
    spec.body("base").add_freejoint()
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert list(scene.object) == ["_2_pieces"]
    as_here(scene.object["_2_pieces"], model.body("base"), data.body("base"))
    assert np.asarray(scene.object["_2_pieces"].position) == pytest.approx([0, 0, 0.05])


@pytest.mark.parametrize(("geom", "mass"), [("mass='3'", 3.0), ("mass='0'", 2.0), ("density='0'", 2.0)])
def test_an_inertial_counts_where_no_geom_weighs(geom, mass, tmp_path):
    inside = f"<freejoint/><geom size='1' {geom}/><inertial pos='0.1 0 0' mass='2' diaginertia='1 1 1'/>"
    text = world(inside).replace("<worldbody>", "<compiler inertiafromgeom='true'/><worldbody>")
    (tmp_path / "m.xml").write_text(text)
    body = hapjax.load_model(tmp_path / "m.xml").object["b"].body
    assert body is not None and float(body.mass) == pytest.approx(mass)
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "m.xml"))
    assert model.body_mass[1] == pytest.approx(mass)


def test_gravity_that_is_off_is_none(tmp_path):
    option = "<option gravity='1 0 0'><flag gravity='disable'/></option>"
    (tmp_path / "m.xml").write_text(f"<mujoco>{option}<worldbody><geom size='1'/></worldbody></mujoco>")
    assert np.asarray(hapjax.load_model(tmp_path / "m.xml").world.gravity) == pytest.approx([0, 0, 0])


@pytest.mark.parametrize("kind", SHAPES)
def test_what_was_written_is_read_again(kind, tmp_path):
    scene = dropped(kind)
    if SHAPES[kind][-1]:  # it turns
        hapjax.save_mjcf(scene, tmp_path / "scene.xml")
        again = hapjax.load_model(tmp_path / "scene.xml")
        assert list(again.object) == ["thing", "floor"] and again.moving() == ["thing"]
        same(scene.object["thing"], again.object["thing"])
        assert np.asarray(again.object["thing"].position) == pytest.approx(scene.object["thing"].position)
    hapjax.save_urdf(scene, tmp_path / "thing.urdf")
    same(scene.object["thing"], hapjax.load_model(tmp_path / "thing.urdf").object["thing"])


def same(first, second):
    """Whether two objects weigh the same and have the same shape."""
    for measure in ("volume", "inertia_per_mass", "centre"):
        ours, theirs = getattr(first.shape, measure)(), getattr(second.shape, measure)()
        assert ours is theirs or np.asarray(ours) == pytest.approx(np.asarray(theirs), abs=1e-9)
    assert float(first.body.mass) == pytest.approx(float(second.body.mass))


def test_names_are_made_such_as_objects_have(tmp_path):
    geom = "<geom size='1'/>"
    (tmp_path / "m.xml").write_text(
        f"<mujoco><worldbody>{geom}{geom}<geom name='geom_2' size='1'/><geom name='2 b-c' size='1'/></worldbody></mujoco>"
    )
    assert list(hapjax.load_model(tmp_path / "m.xml").object) == ["geom", "geom_2", "geom_2_2", "_2_b_c"]


def test_a_hull_need_not_be_closed(folder):
    trimesh.Trimesh(BOX.vertices, BOX.faces[1:], process=False).export(folder / "parts" / "brick.stl")
    with pytest.raises(hapjax.InputError, match=r"model.xml: body mesh: .*beside a hole"):
        hapjax.load_model(folder / "model.xml")
    shape = hapjax.load_model(folder / "model.xml", hull=True).object["mesh"].shape
    assert isinstance(shape, hapjax.Convex) and float(shape.volume()) == pytest.approx(BOX.volume / 8)


def test_the_command_writes_a_scene_that_loads(folder, capsys):
    assert main(["import", str(folder / "model.xml"), "--out", str(folder / "scene.toml")]) == 0
    assert f"{folder / 'scene.toml'}: object.by_hand: cylinder, 0.3 kg\n" in capsys.readouterr().out
    scene, model = hapjax.load_scene(folder / "scene.toml"), hapjax.load_model(folder / "model.xml")
    assert list(scene.object) == list(model.object)
    assert scene.object["mesh"].shape.volume() == pytest.approx(model.object["mesh"].shape.volume())
    assert main(["import", str(folder / "model.xml"), "--out", str(folder / "model.xml")]) == 2
    assert "allowed: .toml" in capsys.readouterr().err and (folder / "model.xml").read_text() == MJCF
    (folder / "elsewhere").mkdir()
    assert main(["import", str(folder / "model.xml"), "--out", str(folder / "elsewhere" / "s.toml")]) == 2
    assert "object.mesh.file" in capsys.readouterr().err and not list((folder / "elsewhere").iterdir())


# Files that are refused -----------------------------------------------------------------------------------

LAUGHS = (
    '<?xml version="1.0"?><!DOCTYPE lolz [<!ENTITY lol "lol"><!ENTITY b "&lol;&lol;">]><mujoco>&b;</mujoco>'
)
OUTER = '<!DOCTYPE mujoco [<!ENTITY x SYSTEM "file:///etc/passwd">]><mujoco model="a">&x;</mujoco>'


def world(inside):
    return f"<mujoco><worldbody><body name='b'>{inside}</body></worldbody></mujoco>"


def robot(inside, joint=""):
    return f"<robot name='r'><link name='a'>{inside}</link><link name='b'/>{joint}</robot>"


REFUSED = [
    (LAUGHS, "declares a document type"),
    (OUTER, "declares a document type"),
    ("<mujoco>", "is not XML: no element found"),
    ('<?xml version="1.0" encoding="klingon"?><mujoco/>', "is not XML: .*klingon"),
    ("", "is not XML"),
    ("<sdf/>", "begins with 'sdf'; allowed: mujoco .* or robot"),
    ("<mujoco/>", "has no body"),
    ("<a>" * 200 + "</a>" * 200, "is nested more than 100 deep"),
    (
        "<mujoco><include file='/etc/passwd'/></mujoco>",
        "includes '/etc/passwd'; allowed: a model in one file",
    ),
    ("<mujoco><compiler coordinate='global'/></mujoco>", "coordinate is 'global'"),
    ("<mujoco><compiler settotalmass='5'/></mujoco>", "settotalmass is '5'; allowed: -1"),
    ("<mujoco><compiler boundmass='1'/></mujoco>", "boundmass is '1'; allowed: 0"),
    ("<mujoco><compiler boundinertia='1'/></mujoco>", "boundinertia is '1'; allowed: 0"),
    ("<mujoco><compiler inertiagrouprange='3 3'/></mujoco>", "inertiagrouprange is '3 3'; allowed: 0 5"),
    (
        "<mujoco><asset><mesh name='m' inertia='shell' vertex='0 0 0'/></asset></mujoco>",
        "mesh m inertia is 'shell'; allowed: exact, legacy",
    ),
    (
        "<mujoco><compiler inertiafromgeom='false'/><worldbody><body name='b'><freejoint/><geom size='1'/></body>"
        "</worldbody></mujoco>",
        "body b: mass is 0.0; allowed: above 0 kg",
    ),
    (world("<freejoint/><geom size='1' shellinertia='true'/>"), "body b: has a geom with shellinertia"),
    (world("<geom size='1' quat='1 0 0 0' euler='0 0 0'/>"), "orientation is given as quat and euler"),
    (world("").replace("'b'", "'b' gravcomp='1'"), "body b: gravcomp is '1'; allowed: 0"),
    ("<mujoco><option gravity='0 0'/><worldbody><geom size='1'/></worldbody></mujoco>", "gravity is '0 0'"),
    (world(""), "body b: has no shape"),
    (world("<geom size='1'/><geom size='2'/>"), "body b: has 2 shapes that collide and 0"),
    (world("<geom type='mesh' mesh='m'/>"), "body b: geom mesh is 'm'; allowed: none"),
    (world("<geom type='ellipsoid' size='1 1 1'/>"), "geom type is 'ellipsoid'"),
    (world("<geom type='box' size='1 1'/>"), "geom size has 2 numbers; allowed: 3 for a box"),
    (world("<geom type='box' size='1 1 x'/>"), "geom size is '1 1 x'; allowed: finite numbers"),
    (world("<geom size='1' pos='0 0 nan'/>"), "pos is '0 0 nan'; allowed: 3 finite numbers"),
    (world("<geom size='-1'/>"), "radius is -1.0; allowed: above 0 m"),
    (world("<geom size='1' mass='0'/>"), "mass is 0.0; allowed: above 0 kg"),
    (world("<geom size='1' mass='-1'/>"), "geom weighs -1.0; allowed: 0 or above"),
    (world("<geom size='1' quat='0 0 0 0'/>"), "quat is 0 0 0 0"),
    (world("<geom size='1' zaxis='0 0 0'/>"), "zaxis has the direction 0 0 0"),
    (world("<geom size='1' class='c'/>"), "class is 'c'"),
    (world("<geom type='plane'/><freejoint/>"), "body b: has a plane that weighs something"),
    (world("<geom size='1'/><joint/>"), "body b: has a joint that is hinge; allowed: free"),
    (world("<geom size='1'/><body name='c'><joint type='free'/></body>"), "body c: moves in another body"),
    (world("<composite/>"), "body b: body has a composite"),
    (
        world("<geom size='1'/><inertial mass='1' diaginertia='1 1 9' pos='0 0 0'/>"),
        "body b: inertia has the",
    ),
    (
        world("<geom size='1'/><inertial mass='' diaginertia='1 1 1'/>"),
        "inertial mass is ''; allowed: 1 finite",
    ),
    (robot(""), "robot has 2 links that hang on no joint; allowed: 1"),
    ("<robot/>", "robot has no link"),
    (robot("", "<joint name='j' type='revolute'/>"), "joint j is 'revolute'; allowed: fixed"),
    (robot("", "<joint name='j' type='fixed'/>"), "joint has no parent"),
    (
        robot("", "<joint name='j' type='fixed'><parent link='a'/><child link='c'/></joint>"),
        "joint j names the link 'c'; allowed: a, b",
    ),
    ("<robot><link name='a'><collision/></link></robot>", "link a: collision has no geometry"),
    (
        "<robot><link name='a'><visual><geometry><cone/></geometry></visual></link></robot>",
        "geometry is cone",
    ),
    ("<robot><link/></robot>", "link has no name"),
]


@pytest.mark.parametrize(("text", "words"), REFUSED, ids=[words[:40] for _, words in REFUSED])
def test_a_faulty_model_is_refused_in_a_sentence(text, words, tmp_path, capsys):
    (tmp_path / "model.xml").write_text(text)
    with pytest.raises(hapjax.InputError, match=words) as refused:
        hapjax.load_model(tmp_path / "model.xml")
    assert str(refused.value).startswith(f"{tmp_path / 'model.xml'}: ")
    assert main(["import", str(tmp_path / "model.xml"), "--out", str(tmp_path / "s.toml")]) == 2
    assert capsys.readouterr().err.count("\n") == 1 and not (tmp_path / "s.toml").exists()


@pytest.mark.parametrize("file", ["../brick.stl", "/tmp/brick.stl", "{outside}/brick.stl", "link.stl"])
def test_no_file_outside_the_folder_is_read(file, folder, tmp_path_factory):
    outside = tmp_path_factory.mktemp("outside")
    BOX.export(outside / "brick.stl")
    (folder / "link.stl").symlink_to(outside / "brick.stl")
    file = file.format(outside=outside)
    mesh = f"<collision><geometry><mesh filename='{file}'/></geometry></collision>"
    (folder / "m.urdf").write_text(f"<robot><link name='a'>{mesh}</link></robot>")
    with pytest.raises(
        hapjax.InputError, match="file is .*; allowed: a relative path to a file in the folder"
    ):
        hapjax.load_model(folder / "m.urdf")
    text = MJCF.replace('"parts" strippath="true"', '"."').replace("far/away/brick.stl", file)
    (folder / "m.xml").write_text(text)
    with pytest.raises(
        hapjax.InputError, match="file is .*; allowed: a relative path to a file in the folder"
    ):
        hapjax.load_model(folder / "m.xml")


@pytest.mark.parametrize(
    ("element", "is_usual"),
    [("<a/>", False), ("<a b=''/>", False), ("<a>b</a>", False), ("<a b='' c='' d=''/>", False)]
    + [("<geom type='box' size='1 1 1'/>", True), ("<geom name='a b c'/>\n", False)],
)
def test_memory_is_in_proportion_to_the_file(element, is_usual, tmp_path):
    (tmp_path / "model.xml").write_text(f"<mujoco>{element * 12_000}</mujoco>")
    size = (tmp_path / "model.xml").stat().st_size
    fault = "has no body" if is_usual else "has too many elements for its size"
    tracemalloc.start()
    try:
        with pytest.raises(hapjax.InputError, match=fault):
            hapjax.load_model(tmp_path / "model.xml")
        assert tracemalloc.get_traced_memory()[1] < max(20 * size, 2**20)
    finally:
        tracemalloc.stop()


def test_more_bodies_than_a_scene_has_are_refused(tmp_path):
    (tmp_path / "model.xml").write_text(
        "<mujoco><worldbody>" + "<geom size='1'/>" * 101 + "</worldbody></mujoco>"
    )
    with pytest.raises(hapjax.InputError, match="has 101 bodies; allowed: at most 100"):
        hapjax.load_model(tmp_path / "model.xml")


def test_a_file_of_absurd_size_is_refused(tmp_path):
    with Path(tmp_path / "huge.xml").open("wb") as file:
        file.truncate(2**40)
    with pytest.raises(hapjax.InputError, match="has 1099511627776 bytes"):
        hapjax.load_model(tmp_path / "huge.xml")
