"""Scene files that little text makes large are refused before they are."""

import tracemalloc

import pytest

import hapjax
from hapjax.scene_text import tables

BALL = 'shape = "sphere"\nradius = 0.01\n'
LARGE = {
    "a deep key": ("a" + ".a" * 200_000 + " = 1", "line 1 has 200000 dots outside of numbers; allowed: 16"),
    "a deep table": ("# a.b\n[a" + " . 1.1" * 40 + "]", "line 2 has 40 dots outside of numbers; allowed: 16"),
    "many deep keys": ("a.a.a.a.b = 1\n" * 3000, "has 12000 dots outside of numbers; allowed: 10000"),
    "many tables": ("".join(f"[a{i}]\n" for i in range(20_000)), "has 20000 tables; allowed: 1000"),
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


def test_numbers_and_remarks_may_have_as_many_dots_as_they_like():
    points = ", ".join(f"[{i}.5, -1_0.25, +1.0e-3]" for i in range(100))
    text = f"# {'.' * 100}\n[object.a]\npoints = [{points}]\nfile = 'a.b.stl'\n"
    assert len(tables(text.encode())["object"]["a"]["points"]) == 100
