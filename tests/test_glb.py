"""GLB files: their parts at their places, read as trimesh reads them, and what is refused before it takes room."""

import io
import json
import struct
import tempfile

import numpy as np
import pytest
import trimesh

import hapjax
from hapjax.glb import triangles_of

BALL = trimesh.creation.icosphere(4)
CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], "<f4")
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], "<u4")


def glb(about, binary=b"") -> bytes:
    text = json.dumps(about).encode()
    text += b" " * (-len(text) % 4)
    rest = struct.pack("<I4s", len(binary), b"BIN\0") + binary if binary else b""
    return struct.pack("<4sIII4s", b"glTF", 2, 20 + len(text) + len(rest), len(text), b"JSON") + text + rest


def read(data: bytes) -> tuple[np.ndarray, np.ndarray]:
    with tempfile.TemporaryFile() as file:
        file.write(data)
        file.seek(0)
        return triangles_of(file, 10_000)


def described(points, order) -> tuple[dict, bytes]:
    """One part, where it is: what its file says of it, and its numbers."""
    parts = [np.ascontiguousarray(points).tobytes(), np.ascontiguousarray(order).tobytes()]
    views = [
        {"buffer": 0, "byteOffset": at, "byteLength": len(part)}
        for at, part in zip((0, len(parts[0])), parts, strict=True)
    ]
    kinds = {"<f4": 5126, "<i2": 5122, "<u4": 5125, "|u1": 5121}
    accessors = [
        {"bufferView": 0, "componentType": kinds[points.dtype.str], "count": len(points), "type": "VEC3"},
        {"bufferView": 1, "componentType": kinds[order.dtype.str], "count": order.size, "type": "SCALAR"},
    ]
    about = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": sum(map(len, parts))}],
    }
    return about, b"".join(parts)


def test_parts_are_where_nested_nodes_put_them():
    """Turned, stretched, mirrored and shown twice: as trimesh has it, and still closed, with its volume outward."""
    about, binary = described(CORNERS, FACES)
    about["nodes"] = [
        {"children": [1, 2], "matrix": [0, 2, 0, 0, -2, 0, 0, 0, 0, 0, 3, 0, 5, 6, 7, 1]},
        {"mesh": 0, "rotation": [0.5, 0.5, 0.1, 0.7], "translation": [1, 2, 3], "scale": [-1, 2, 0.5]},
        {"mesh": 0, "children": [3]},
        {"mesh": 0, "translation": [0, 0, 9], "scale": [1, 1, -1]},
    ]
    data = glb(about, binary)
    theirs = trimesh.load_scene(io.BytesIO(data), file_type="glb").to_mesh()
    ours = trimesh.Trimesh(*read(data), process=False)
    assert ours.faces.shape == theirs.faces.shape == (12, 3)
    middles = (sorted(mesh.triangles_center.round(4).tolist()) for mesh in (ours, theirs))
    np.testing.assert_allclose(next(middles), next(middles), atol=1e-6)
    assert ours.volume == pytest.approx(theirs.volume, rel=1e-6) and ours.volume > 0


@pytest.mark.parametrize(
    ("mode", "order"),
    [(5, [0, 2, 1, 3, 0, 2]), (6, [0, 1, 3, 2, 1]), (None, None), (1, [0, 1, 2, 3])],
    ids=["strip", "fan", "without numbers", "lines"],
)
def test_triangles_come_in_every_form(mode, order):
    about, binary = described(CORNERS, np.array(order or [0], "|u1"))
    primitive = about["meshes"][0]["primitives"][0]
    if mode is None:
        about, binary = described(CORNERS[FACES.ravel()], FACES)
        del about["meshes"][0]["primitives"][0]["indices"]
    else:
        primitive["mode"] = mode
    points, faces = read(glb(about, binary))
    found = {tuple(np.roll(t, -np.argmin(t)).tolist()) for t in faces}
    if mode == 5:
        assert found == {(0, 2, 1), (1, 2, 3), (0, 1, 3), (0, 3, 2)}
    elif mode == 6:
        assert found == {(0, 1, 3), (0, 3, 2), (0, 2, 1)}
    elif mode == 1:
        assert not found
    else:
        np.testing.assert_array_equal(points[faces], CORNERS[FACES])


def test_numbers_may_lie_apart_and_be_parts_of_the_largest():
    """Interleaved with something else, as 16-bit integers of which the largest is 1."""
    table = np.full((4, 4), 77, "<i2")
    table[:, :3] = np.where(CORNERS > 0, 32767, 0)
    about, binary = described(CORNERS, FACES)
    about["accessors"][0] |= {"componentType": 5122, "normalized": True}
    about["bufferViews"][0] |= {"byteLength": 32, "byteStride": 8}
    points, faces = read(glb(about, table.tobytes() + bytes(16) + FACES.tobytes()))
    np.testing.assert_array_equal(points, CORNERS)
    np.testing.assert_array_equal(faces, FACES)


def unpacked(about):
    about["accessors"][0] = {"componentType": 5126, "count": 30_000_000, "type": "VEC3"}


def sparse(about):
    about["accessors"][0]["sparse"] = {"count": 1}


def repeated(about):
    about["bufferViews"][0]["byteStride"] = 0
    about["accessors"][0]["count"] = 30_000_000


def beyond(about):
    about["accessors"][1]["count"] = 13


def short(about):
    about["bufferViews"][0]["byteLength"] = 36


def negative(about):
    about["accessors"][0]["byteOffset"] = -12


def outside(about):
    about["buffers"][0]["uri"] = "/etc/passwd"


def many_nodes(about):
    about["nodes"] = [{"mesh": 0}] * 5000
    about["scenes"][0]["nodes"] = list(range(5000))


def many_primitives(about):
    about["meshes"][0]["primitives"] *= 5000


def doubling(about):
    about["nodes"] += [{"children": [i, i]} for i in range(30)]
    about["scenes"][0]["nodes"] = [30]


def ring(about):
    about["nodes"][0]["children"] = [0]


def nowhere(about):
    about["scenes"][0]["nodes"] = [-1]


def wild(about):
    about["accessors"][0]["count"] = 3


def talk(about):
    about["extras"] = [[]] * 2**18


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        (unpacked, "has accessor 0 without numbers of its own"),
        (sparse, "has accessor 0 without numbers of its own"),
        (repeated, "has the 30000000 numbers of accessor 0 not within it"),
        (beyond, "has the 13 numbers of accessor 1 not within it"),
        (short, "has the 4 numbers of accessor 0 not within it"),
        (negative, "has the 4 numbers of accessor 0 not within it"),
        (outside, "has the numbers of accessor 0 in another file"),
        (many_nodes, "or more in all their places; allowed: at most"),
        (many_primitives, "or more in all their places; allowed: at most"),
        (doubling, "has node 29 in two nodes"),
        (ring, "has node 0 in two nodes"),
        (nowhere, "has -1 as one of its 1 nodes"),
        (wild, "has a triangle of vertex 3; allowed: below 3"),
        (talk, "bytes of JSON; allowed: at most"),
    ],
)
def test_what_would_take_room_or_lies_elsewhere_is_refused(change, fault, tmp_path):
    large = change in (many_nodes, many_primitives)
    about, binary = described(
        *(BALL.vertices.astype("<f4"), BALL.faces.astype("<u4")) if large else (CORNERS, FACES)
    )
    change(about)
    path = tmp_path / "a.glb"
    path.write_bytes(glb(about, binary))
    with pytest.raises(hapjax.InputError, match=fault) as refused:
        hapjax.load_mesh(path)
    assert str(refused.value).startswith(f"{path}: ") and "\n" not in str(refused.value)


def test_pictures_are_not_looked_at():
    about, binary = described(CORNERS, FACES)
    about["images"] = [{"bufferView": 7, "mimeType": "image/png"}]
    about["materials"] = [{"pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}]
    about["meshes"][0]["primitives"][0]["material"] = 0
    np.testing.assert_array_equal(read(glb(about, binary))[1], FACES)


@pytest.mark.parametrize(
    "data", [b"", b"glTF" + bytes(40), glb([]), glb({"scenes": 3}), glb({"scenes": [[]]})]
)
def test_what_is_no_glb_is_refused(data, tmp_path):
    path = tmp_path / "a.glb"
    path.write_bytes(data)
    with pytest.raises(hapjax.InputError, match=r"a.glb: (is no mesh that can be read|has 0 as one)"):
        hapjax.load_mesh(path)
