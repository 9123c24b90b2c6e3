"""Mesh files take at most 20 times their size in memory, beside what a small mesh takes: or they are refused."""

import struct
import tracemalloc

import numpy as np
import pytest
import trimesh

import hapjax
from hapjax.mesh_file import _read

SMALL = 2**22  # bytes: what is looked at together
TORUS = trimesh.creation.torus(1.0, 0.4, major_sections=200, minor_sections=100)
XYZ = "element vertex {}\nproperty {type} x\nproperty {type} y\nproperty {type} z\n"


def peak(act) -> int:
    """The most bytes that NumPy and Python hold at a time."""
    tracemalloc.start()
    try:
        act()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("suffix", ["ply", "glb", "stl", "obj", "ascii.ply", "ascii.stl"])
def test_a_file_is_read_in_little_room(suffix, tmp_path):
    form = {"ascii.ply": {"encoding": "ascii"}}.get(suffix, {})
    mesh = TORUS if suffix in ("ply", "glb", "stl") else trimesh.creation.icosphere(4)
    content = mesh.export(file_type="stl_ascii" if suffix == "ascii.stl" else suffix[-3:], **form)
    path = tmp_path / f"a.{suffix}"
    path.write_bytes(content if isinstance(content, bytes) else str(content).encode())
    assert peak(lambda: _read(path)) < 10 * path.stat().st_size + SMALL / 8


@pytest.mark.slow
def test_a_mesh_is_built_in_little_room():
    """A triangle of a GLB file has 18 bytes; the file itself is no longer in memory."""
    vertices, triangles = np.array(TORUS.vertices), np.array(TORUS.faces)
    assert peak(lambda: hapjax.Mesh(vertices, triangles)) < 20 * 18 * len(triangles) + 2 * SMALL


def ragged() -> bytes:
    """Text of triangles and squares in turn, as short as can be."""
    head = "ply\nformat ascii 1.0\n" + XYZ.format(9, type="float")
    head += "element face 6000\nproperty list uchar int vertex_index\nend_header\n"
    return (head + "0 0 0\n" * 9 + "3 1 2 3\n4 1 2 3 4\n" * 3_000).encode()


def others() -> bytes:
    head = "ply\nformat ascii 1.0\nelement edge 40000\nproperty int a\n" + XYZ.format(1, type="float")
    return (
        head
        + "element face 0\nproperty list uchar int vertex_index\nend_header\n"
        + "1\n" * 40_000
        + "0 0 0\n"
    ).encode()


def of_bytes() -> bytes:
    head = "ply\nformat binary_little_endian 1.0\n" + XYZ.format(9, type="uchar")
    head += "element face 400\nproperty list uchar uchar vertex_index\nend_header\n"
    return head.encode() + bytes(27) + (b"\xff" + b"\1\2\3" * 85) * 400


def in_turn() -> bytes:
    """Numbers of triangles and squares in turn."""
    head = "ply\nformat binary_little_endian 1.0\n" + XYZ.format(9, type="uchar")
    head += "element face 4000\nproperty list uchar uchar vertex_index\nend_header\n"
    return head.encode() + bytes(27) + b"\3\1\2\3\4\1\2\3\4" * 2_000


def strip() -> bytes:
    """A GLB of one strip, a byte a triangle."""
    about = (
        b'{"scenes":[{"nodes":[0]}],"nodes":[{"mesh":0}],"meshes":[{"primitives":[{"attributes":{"POSITION":0},"indices":1,'
        b'"mode":5}]}],"accessors":[{"bufferView":0,"componentType":5126,"count":4,"type":"VEC3"},{"bufferView":1,'
        b'"componentType":5121,"count":400000,"type":"SCALAR"}],"bufferViews":[{"buffer":0,"byteLength":48},{"buffer":0,'
        b'"byteOffset":48,"byteLength":400000}],"buffers":[{"byteLength":400048}]}'
    )
    about += b" " * (-len(about) % 4)
    binary = struct.pack("<12f", *np.eye(4, 3).ravel()) + b"\0\1\2\3" * 100_000
    rest = struct.pack("<I4s", len(binary), b"BIN\0") + binary
    return (
        struct.pack("<4sIII4s", b"glTF", 2, 20 + len(about) + len(rest), len(about), b"JSON") + about + rest
    )


ODD = {
    "short lines.obj": b"v 0 0 0\n" * 8_000 + b"f 1 2 3\n" * 8_000,
    "squares.obj": b"v 0 0 0\n" * 9 + b"f 1 2 3 4\n" * 6_000,
    "polygons.obj": b"v 0 0 0\n" * 9 + (b"f" + b" 1 2 3" * 10_000 + b"\n") * 2,
    "one long line.obj": b"f" + b" 1" * 200_000,
    "one long name.stl": b"solid" + b" a" * 200_000,
    "short lines.stl": b"vertex 0 0 0\n" * 6_000,
    "ragged.ply": ragged(),
    "others.ply": others(),
    "of bytes.ply": of_bytes(),
    "in turn.ply": in_turn(),
    "strip.glb": strip(),
}


@pytest.mark.parametrize("name", ODD)
def test_what_is_no_mesh_is_refused_in_little_room(name, tmp_path):
    (tmp_path / name).write_bytes(ODD[name])

    def load():
        with pytest.raises(hapjax.InputError):
            hapjax.load_mesh(tmp_path / name)

    assert peak(load) < 20 * len(ODD[name]) + SMALL


def test_needles_are_refused_before_they_take_room(tmp_path):
    path = tmp_path / "fan.ply"
    trimesh.creation.cylinder(1.0, 1.0, sections=12_000).export(path)

    def load():
        with pytest.raises(
            hapjax.InputError, match=r"fan.ply: has 48000 triangles that would take \d+ bytes in memory; "
        ):
            hapjax.load_mesh(path)

    assert peak(load) < 10 * path.stat().st_size
