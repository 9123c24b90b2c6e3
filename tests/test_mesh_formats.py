"""Mesh files of every form: the triangles that trimesh finds in them, and what is refused."""

import io
import struct

import numpy as np
import pytest
import trimesh

import hapjax
from hapjax import obj, ply, stl
from hapjax.errors import InputError

READERS = {"obj": obj.triangles_of, "ply": ply.triangles_of, "stl": stl.triangles_of}
POINTS = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0.5 0.5 1e0\n"
PYRAMID = POINTS + "f 4 3 2 1\nf 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\n"
CORNERS = [line[2:] for line in POINTS.splitlines()]
FACES = ["4 3 2 1 0", "3 0 1 4", "3 1 2 4", "3 2 3 4", "3 3 0 4"]
XYZ = "property float x\nproperty float y\nproperty float z\n"
LIST = "property list uchar int vertex_indices\n"
PLACES = np.array([list(map(float, line.split())) for line in CORNERS])
SIDES = [[3, 2, 1], [3, 1, 0], [0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]]


def text_ply(vertex=XYZ, face=LIST, corners=CORNERS, faces=FACES, before="", after="", first="", last=""):
    """PLY as text, with what is said of other elements, and their lines, before the vertices and after the faces."""
    head = (
        f"{before}element vertex {len(corners)}\n{vertex}element face {len(faces)}\n{face}{after}end_header\n"
    )
    return f"ply\nformat ascii 1.0\ncomment of a test\n{head}" + "\n".join(
        [*first.splitlines(), *corners, *faces, *last.splitlines(), ""]
    )


def packed(order, point="3f", vertex=XYZ, count="B", number="i", face=LIST, between=b"", said=""):
    """The pyramid as PLY of numbers."""
    name = "little" if order == "<" else "big"
    head = f"element vertex 5\n{vertex}{said}element face 5\n{face}end_header\n"
    rows = [struct.pack(order + point, *map(float, line.split())) for line in CORNERS]
    for line in FACES:
        own = list(map(int, line.split()))
        rows.append(struct.pack(f"{order}{count}{own[0]}{number}", *own))
    data = b"".join(rows[:5]) + between + b"".join(rows[5:])
    return f"ply\nformat binary_{name}_endian 1.0\n{head}".encode() + data


def solid(name, shift=0.0):
    """A box as STL of text."""
    return (
        trimesh.creation.box((1, 2, 3)).apply_translation((shift, 0, 0)).export(file_type="stl_ascii") + "\n"
    )


FILES = {
    "plain.obj": PYRAMID.replace("f 4 3 2 1", "f 4 3 2\nf 4 2 1"),
    "polygons.obj": PYRAMID,
    "from the end.obj": PYRAMID.replace("f 1 2 5", "f -5 -4 -1"),
    "textured.obj": "mtllib a.mtl\no a\n"
    + PYRAMID.replace("f 1 2 5", "vt 0 0\nvn 0 0 1\ng b\nf 1/1/1 2/1/1 5/1/1").replace(
        "f 2 3 5", "f 2//1 3//1 5//1"
    ),
    "coloured.obj": PYRAMID.replace("v 1 1 0", "v 1 1 0 0.5 0.5 0.5 # a remark"),
    "continued.obj": PYRAMID.replace("f 4 3 2 1", "f 4 3 \\\n2 1\r"),
    "plain.ply": text_ply(faces=["3 3 2 1", "3 3 1 0", *FACES[1:]]),
    "polygons.ply": text_ply(),
    "much else.ply": text_ply(
        "property uchar red\nproperty double z\nproperty double x\nproperty float y\n",
        "property float quality\nproperty list uchar float texcoord\nproperty list int uint vertex_index\n",
        [f"9 {line.split()[2]} {line.split()[0]} {line.split()[1]}" for line in CORNERS],
        [f"0.5 2 0.1 0.2 {line}" for line in FACES],
        "element camera 1\nproperty float view\n",
        "element edge 2\nproperty int vertex1\nproperty int vertex2\n",
        "7\n",
        "0 1\n1 2\n",
    ),
    "little.ply": packed("<"),
    "triangles.ply": trimesh.Trimesh(PLACES, SIDES, process=False).export(file_type="ply"),
    "big.ply": packed(
        ">", "3d", XYZ.replace("float", "double"), "i", "H", "property list int ushort vertex_index\n"
    ),
    "spare.ply": packed(
        "<",
        "3fxx",
        XYZ + "property short about\n",
        said="element edge 2\nproperty uint a\n",
        between=bytes(8),
    ),
    "text.stl": solid("a") + solid("b", 5.0),
    "numbers.stl": trimesh.creation.box((1, 2, 3)).export(file_type="stl"),
}


# Binary PLY of polygons that differ, colours of some vertices, lists before the corners: trimesh gives up or goes astray.
OURS = {"coloured.obj", "much else.ply", "little.ply", "big.ply", "spare.ply"}


def surface(points, triangles):
    """The triangles by the places of their corners, each from its least on."""
    corners = np.round(np.asarray(points, float)[np.asarray(triangles)], 6).tolist()
    return sorted(min(t[i:] + t[:i] for i in range(3)) for t in corners)


@pytest.mark.parametrize("name", FILES)
def test_a_file_has_the_triangles_that_trimesh_finds(name, tmp_path):
    data = FILES[name] if isinstance(FILES[name], bytes) else FILES[name].encode()
    (tmp_path / name).write_bytes(data)
    with (tmp_path / name).open("rb") as file:
        ours = surface(*READERS[name[-3:]](file, 100))
    if "stl" not in name:
        assert ours == surface(PLACES, SIDES)
    if name not in OURS:
        theirs = trimesh.load_scene(io.BytesIO(data), file_type=name[-3:]).to_mesh()
        assert ours == surface(theirs.vertices, theirs.faces)


@pytest.mark.parametrize(
    ("name", "content", "fault"),
    [
        ("a.obj", "v 1 2\n", "line 1 has a vertex of 2 numbers"),
        ("a.obj", PYRAMID + "f 1 2\n", "has a face of 2 corners"),
        ("a.obj", PYRAMID + "f 1 2 6\n", "has a triangle of vertex 5, counted from 0; allowed: from 0 to 4"),
        ("a.obj", PYRAMID + "f 1 2 0\n", "has a triangle of vertex -1, counted from 0"),
        ("a.obj", PYRAMID + "f 1 2 -6\n", "has a triangle of vertex -1, counted from 0"),
        ("a.obj", PYRAMID + "f 1 2 x\n", "is no mesh that can be read"),
        ("a.obj", PYRAMID + "f" + " 1" * 70_000, "line 11 has more than 131072 bytes"),
        ("a.obj", PYRAMID + "f" + " 1 \\\n" * 70_000, r"line \d+ goes on to more than 131072 bytes"),
        ("a.ply", "ply\nformat ascii 2\n", "has no description of a PLY file"),
        ("a.ply", text_ply(vertex="property float x\n"), "has vertices without x, y or z"),
        ("a.ply", text_ply(face="property int vertex_indices\n"), "has faces without a list"),
        (
            "a.ply",
            text_ply(face="property list uchar half vertex_indices\n"),
            "line 9 is 'property list uchar half",
        ),
        ("a.ply", text_ply(face=LIST + "property int more\n"), "numbers in a row of 'face'"),
        ("a.ply", text_ply(after="element edge 2\nproperty int a\n"), "ends within its 2 elements 'edge'"),
        ("a.ply", packed("<")[:-1], "ends within its 5 elements 'face'"),
        (
            "a.ply",
            packed("<", face=LIST.replace("uchar", "char"), count="b").replace(b"\3\3", b"\xff\3"),
            "list",
        ),
        (
            "a.ply",
            packed("<", number="I", face=LIST.replace("int ", "uint ")).replace(b"\4\0\0\0", b"\4\0\0\xff"),
            "has a triangle of vertex 4278190084",
        ),
        ("a.stl", solid("a").replace("vertex", "#", 1), "ends a triangle of 2 vertices"),
        ("a.stl", "vertex 1 2\n", "line 1 has a vertex of 2 numbers"),
        ("a.stl", "vertex 1 2 3\n", "ends within a triangle"),
    ],
)
def test_what_is_not_of_the_form_is_refused(name, content, fault, tmp_path):
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError, match=fault) as refused:
        hapjax.load_mesh(tmp_path / name)
    assert str(refused.value).startswith(str(tmp_path / name)) and "\n" not in str(refused.value)
