"""Meshes from files and in scene files, and the files that are refused."""

import jax
import numpy as np
import pytest
import trimesh

import hapjax

BOX = trimesh.creation.box((0.06, 0.04, 0.02))


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "glb"])
def test_a_box_is_read_from_every_format(suffix, tmp_path):
    path = tmp_path / f"box.{suffix}"
    BOX.export(path)
    mesh = hapjax.load_mesh(path, scale=0.5)
    assert mesh.vertices.shape == (8, 3) and mesh.triangles.shape == (12, 3)
    assert float(mesh.volume()) == pytest.approx(BOX.volume / 8, rel=1e-6)


def test_parts_of_a_glb_are_where_it_puts_them(tmp_path):
    scene = trimesh.Scene(BOX)
    scene.add_geometry(BOX, transform=trimesh.transformations.translation_matrix([0.1, 0, 0]))
    scene.export(tmp_path / "two.glb")
    mesh = hapjax.load_mesh(tmp_path / "two.glb")
    assert mesh.triangles.shape == (24, 3)
    np.testing.assert_allclose(mesh.vertices.max(axis=0), [0.13, 0.02, 0.01], rtol=1e-6)


def test_no_other_file_is_opened(tmp_path, monkeypatch):
    (tmp_path / "secret.mtl").write_text("newmtl a\nmap_Kd secret.png\n")
    path = tmp_path / "box.obj"
    path.write_text(f"mtllib secret.mtl\nusemtl a\n{BOX.export(file_type='obj', include_texture=False)}")
    opened = []
    real = open

    def watched(file, *args, **options):
        opened.append(str(file))
        return real(file, *args, **options)

    monkeypatch.setattr("builtins.open", watched)
    monkeypatch.setattr("io.open", watched)
    hapjax.load_mesh(path)
    assert not any("secret" in name for name in opened)


@pytest.mark.parametrize(
    ("name", "content", "fault"),
    [
        ("a.step", b"x", "has the ending '.step'; allowed: a file ending in .stl, .obj, .ply, .glb"),
        ("a.ply", b"x", "has no description of a PLY file"),
        ("a.glb", b"x", "is no mesh that can be read"),
        ("a.stl", b"", "has no triangles"),
        ("b.stl", None, "cannot be read"),
    ],
)
def test_what_is_no_mesh_is_refused(name, content, fault, tmp_path):
    if content is not None:
        (tmp_path / name).write_bytes(content)
    with pytest.raises(hapjax.InputError, match=fault) as refused:
        hapjax.load_mesh(tmp_path / name)
    assert str(refused.value).startswith(str(tmp_path / name)) and "\n" not in str(refused.value)


def test_a_file_of_absurd_size_is_refused(tmp_path):
    with (tmp_path / "huge.stl").open("wb") as file:
        file.truncate(2**40)
    with pytest.raises(hapjax.InputError, match="has 1099511627776 bytes"):
        hapjax.load_mesh(tmp_path / "huge.stl")


def test_a_faulty_mesh_is_refused_by_the_name_of_its_file(tmp_path):
    trimesh.Trimesh(BOX.vertices, BOX.faces[1:], process=False).export(tmp_path / "hole.ply")
    with pytest.raises(hapjax.InputError, match=r"hole.ply: 3 of the triangles are beside a hole"):
        hapjax.load_mesh(tmp_path / "hole.ply")


# Scene files ----------------------------------------------------------------------------------------------

SCENE = """
[object.part]
shape = "mesh"
file = "parts/box.stl"
scale = 0.5
shaded = true

[object.part.body]
density = 1000.0

[object.gem]
shape = "convex"
points = [[0, 0, 0], [0.02, 0, 0], [0, 0.02, 0], [0, 0, 0.02]]

[object.hull]
shape = "convex"
file = "parts/box.stl"

[object.cube.body]
density = 500.0

[object.cube]
shape = "box"
size = [0.1, 0.1, 0.1]
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "parts").mkdir()
    BOX.export(tmp_path / "parts" / "box.stl")
    (tmp_path / "scene.toml").write_text(SCENE)
    return tmp_path


def test_scene_files_have_meshes(folder):
    scene = hapjax.load_scene(folder / "scene.toml")
    part, gem, hull, cube = (scene.object[name] for name in ("part", "gem", "hull", "cube"))
    assert isinstance(part.shape, hapjax.Mesh) and part.shape.shaded
    assert isinstance(gem.shape, hapjax.Convex) and float(gem.shape.volume()) == pytest.approx(0.02**3 / 6)
    assert isinstance(hull.shape, hapjax.Convex) and len(hull.shape.faces) == 6
    assert part.body is not None and float(part.body.mass) == pytest.approx(0.006, rel=1e-6)
    assert cube.body is not None and float(cube.body.mass) == pytest.approx(0.5)

    hapjax.save_scene(scene, folder / "again.toml")
    again = hapjax.load_scene(folder / "again.toml")
    assert jax.tree.structure(scene) == jax.tree.structure(again)
    for ours, theirs in zip(jax.tree.leaves(scene), jax.tree.leaves(again), strict=True):
        np.testing.assert_array_equal(ours, theirs)


def test_a_mesh_of_no_file_is_not_saved(folder):
    loaded = hapjax.load_mesh(folder / "parts" / "box.stl")
    for mesh, fault in ((hapjax.Mesh(BOX.vertices, BOX.faces), "was not loaded"), (loaded, "in the folder")):
        scene = hapjax.Scene({"part": hapjax.Object(mesh)})
        (folder / "other").mkdir(exist_ok=True)
        with pytest.raises(hapjax.InputError, match=rf"object.part.file .*{fault}"):
            hapjax.save_scene(scene, folder / "other" / "scene.toml")
    assert not list((folder / "other").iterdir())
    moved = loaded.moved(loaded.vertices + 0.01)
    assert moved.file is None


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        (
            'file = "parts/box.stl"\nscale',
            'file = "../box.stl"\nscale',
            "object.part.file is '../box.stl'; allowed",
        ),
        (
            'file = "parts/box.stl"\nscale',
            'file = "/box.stl"\nscale',
            "object.part.file is '/box.stl'; allowed",
        ),
        ('file = "parts/box.stl"\nscale', "file = 3\nscale", "object.part.file is 3; allowed"),
        ('file = "parts/box.stl"\nscale', "scale", "object.part.file is missing"),
        ("scale = 0.5", "scale = -1", "object.part.*scale is -1.0; allowed: above 0"),
        ("shaded = true", "shaded = 1", "shaded is 1; allowed: true or false"),
        ("shaded = true", "points = []", "object.part.points is not known"),
        ("points = [[0, 0, 0],", "points = [", "object.gem.points"),
        (
            'shape = "convex"\nfile',
            'shape = "convex"\npoints = []\nfile',
            "object.hull.points and file are both",
        ),
        ("density = 1000.0", "density = 1000.0\nmass = 1.0", "object.part.body.density and .* both given"),
        ("density = 1000.0", "density = 0.0", "object.part.body.density is 0.0; allowed: above 0 kg/m"),
        (
            '"box"\nsize = [0.1, 0.1, 0.1]',
            '"plane"',
            "object.cube.body.density is given, but a plane has no volume",
        ),
    ],
)
def test_faulty_scene_files_are_refused(old, new, fault, folder):
    assert old in SCENE
    (folder / "scene.toml").write_text(SCENE.replace(old, new, 1))
    with pytest.raises(hapjax.InputError, match=fault):
        hapjax.load_scene(folder / "scene.toml")


def test_a_link_to_itself_is_refused(folder):
    (folder / "parts" / "box.stl").unlink()
    (folder / "parts" / "box.stl").symlink_to("box.stl")
    with pytest.raises(hapjax.InputError, match=r"object.part.file .*box.stl: cannot be read"):
        hapjax.load_scene(folder / "scene.toml")


def test_a_link_out_of_the_folder_is_refused(folder, tmp_path_factory):
    outside = tmp_path_factory.mktemp("outside") / "box.stl"
    BOX.export(outside)
    (folder / "parts" / "box.stl").unlink()
    (folder / "parts" / "box.stl").symlink_to(outside)
    with pytest.raises(hapjax.InputError, match="object.part.file is 'parts/box.stl'; allowed"):
        hapjax.load_scene(folder / "scene.toml")
