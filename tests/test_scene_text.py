"""Scene files that little text makes large are refused before they are."""

import tracemalloc

import pytest

import hapjax
from hapjax import scene_text
from hapjax.scene_text import tables

BALL = 'shape = "sphere"\nradius = 0.01\n'
LARGE = {
    "a deep key": ("a" + ".a" * 200_000 + " = 1", "line 1 has 200000 dots outside of numbers; allowed: 16"),
    "a deep table": ("# a.b\n[a" + " . 1.1" * 40 + "]", "line 2 has 79 dots outside of numbers; allowed: 16"),
    "many deep keys": ("a.a.a.a.b = 1\n" * 3000, "has 12000 dots outside of numbers; allowed: 4000"),
    "keys that look like numbers": (
        "".join(f"{i}.1 = []\n" for i in range(9000)),
        "has 9000 dots outside of numbers; allowed: 4000",
    ),
    "a deep key behind what is no remark": (
        'a = ["""\n#""", {a' + ".a" * 200_000 + " = 1}]",
        "line 2 has 200000 dots",
    ),
    "many tables": ("".join(f"[a{i}]\n" for i in range(20_000)), "has 20000 tables; allowed: 2000"),
    "tables that look like numbers": ("".join(f"[{i}]\n" for i in range(20_000)), "has 20000 tables"),
    "many tables in lines": ("a = [" + "{a={}}, " * 60_000 + "]", "has 120000 tables; allowed: 2000"),
    "many keys": ("".join(f"a{i} = []\n" for i in range(40_000)), "has 40000 keys; allowed: 10000"),
    "many lists": ("a = [" + "[[]]," * 100_000 + "]", "has 200001 lists; allowed: 50000"),
    "many bytes": ("#" * 600_000, "bytes or more; allowed: a scene file of at most 524288 bytes"),
    "many objects": (
        "".join(f"[object.a{i}]\n{BALL}" for i in range(101)),
        "object has 101 tables; allowed: 100",
    ),
    "many contacts": (
        f"[object.a]\n{BALL}[contact]\n" + "".join(f"c{i} = 1\n" for i in range(501)),
        "contact has 501",
    ),
}


@pytest.mark.parametrize("case", LARGE)
def test_what_would_take_far_more_memory_than_its_size_is_refused(case, tmp_path):
    text, said = LARGE[case]
    (tmp_path / "scene.toml").write_text(text)
    tracemalloc.start()
    try:
        with pytest.raises(hapjax.InputError) as refusal:
            hapjax.load_scene(tmp_path / "scene.toml")
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert str(refusal.value).startswith(f"{tmp_path / 'scene.toml'}: ") and said in str(refusal.value)
    assert peak < 20 * max(len(text), 2**17)


FULL = """
[object.a{i}]
shape = "convex"
points = [
    [0.0, 0.0, 0.1], [0.1, 0.0, 0.0],
    [1.5]
]
position = [0.0, 0.0, 0.5]  # m, about 0.5 above the floor
# --- felt --- {{}} = [[]] ---
[object.a{i}.surface]
mu = 0.5
stiffness = 800
anisotropy = 0.5
grain = [1.0, 0.0, 0.0]
[object.a{i}.surface.friction]
law = "lugre"
bristle_stiffness = 1e5
[object.a{i}.body]
mass = 0.2
inertia = [1e-4, 1.25e-4, 1.4e-4]
"""
PAIRS = """[contact.c{i}]
between = ["a1", "a2"]
stiffness = 5000.0
mu_static = 0.6
mu_kinetic = 0.5
friction = {{ law = "dahl" }}
"""


def test_the_largest_scene_is_read():
    text = "".join(FULL.format(i=i) for i in range(100)) + "".join(PAIRS.format(i=i) for i in range(500))
    found = tables(text.encode())
    assert len(found["object"]) == 100 and len(found["contact"]) == 500


def test_reading_takes_at_most_twenty_times_the_size_and_16_megabytes():
    """A tenth of what is allowed of all that takes much beside its size, and a tenth of that."""
    dots, headers, keys, lists = (most // 10 for most in scene_text._MOST.values())
    deep = dots // 16
    parts = [
        "".join(f"k{i} = []\n" for i in range(keys - 1)),
        "b = [",
        "[]," * (lists - keys - headers),
        "]\n",
    ]
    parts += [f"[t{i}{'.a' * 16}]\n" for i in range(deep)] + [f"[{i}]\n" for i in range(headers - deep)]
    data = "".join(parts).encode()
    tracemalloc.start()
    try:
        assert len(tables(data)) == keys + headers
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak < 20 * len(data) + 1.6e6


def test_numbers_and_remarks_may_have_as_many_dots_as_they_like():
    points = ", ".join(f"[{i}.5, -1_0.25, +1.0e-3]" for i in range(100))
    text = f"# {'.' * 100}\n[object.a]\npoints = [{points}]\nfile = 'a.b.stl'\n"
    assert len(tables(text.encode())["object"]["a"]["points"]) == 100
