"""Friction laws in scene files: read, written, refused in one sentence; and what a contact makes of one."""

from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hapjax
from friction_cases import LAWS, TWO, surface
from hapjax import friction
from helpers import moving

FILE = """
[object.cube]
shape = "box"
size = [0.06, 0.06, 0.06]

[object.cube.surface]
stiffness = 800.0
tangential_stiffness = 500.0
mu_static = 0.6
mu_kinetic = 0.4
anisotropy = 0.5
grain = [1.0, -1.0, 0.0]

[object.cube.surface.friction]
law = "lugre"
bristle_damping = 0.01
viscous = 0.2
stribeck_velocity = 0.005

[object.cube.body]
mass = 0.1

[object.floor]
shape = "plane"

[contact.cube_on_floor]
between = ["cube", "floor"]
stiffness = 5000.0
mu = 0.5

[contact.cube_on_floor.friction]
law = "dahl"
"""


def test_laws_of_surfaces_and_contacts_are_read(tmp_path):
    (tmp_path / "scene.toml").write_text(FILE)
    scene = hapjax.load_scene(tmp_path / "scene.toml")
    felt = scene.object["cube"].surface
    assert felt is not None and isinstance(felt.friction, hapjax.LuGre)
    assert float(felt.friction.viscous) == pytest.approx(0.2)
    assert isinstance(scene.contact["cube_on_floor"].friction, hapjax.Dahl)


@pytest.mark.parametrize("name", LAWS)
def test_what_is_written_is_read_again_to_the_last_bit(name, tmp_path, dtype):
    kind: dict[str, Any] = dict(tangential_stiffness=1234.567, anisotropy=1 / 3, damping=0.7)
    kind |= dict(grain=(0.1, -2 / 3, 0.0), finger_mu=(1 / 3, 1.0))
    law, mu = LAWS[name]
    scene = hapjax.Scene(
        {
            "it": hapjax.Object(hapjax.Box((0.1,) * 3), surface(name, **kind), hapjax.Body(0.1)),
            "floor": hapjax.Object(hapjax.Plane()),
        },
        {"pair": hapjax.Contact(1000.0, between=("it", "floor"), friction=law, **mu)},
    )
    scene = hapjax.cast(scene, dtype)
    hapjax.save_scene(scene, tmp_path / "scene.toml")
    again = hapjax.cast(hapjax.load_scene(tmp_path / "scene.toml"), dtype)
    assert jax.tree.structure(again) == jax.tree.structure(scene)
    assert all(np.array_equal(a, b) for a, b in zip(*map(jax.tree.leaves, (again, scene)), strict=True))


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('law = "lugre"\n', "", "object.cube.surface.friction.law is missing; allowed: cone, viscous"),
        (
            '"lugre"',
            '"coulomb"',
            "object.cube.surface.friction.law is 'coulomb'; allowed: cone, viscous, str",
        ),
        (
            "viscous = 0.2",
            "sigma = 0.2",
            "surface.friction.sigma is not known; allowed: bristle_damping, vis",
        ),
        ("viscous = 0.2", "viscous = -0.2", "surface.friction.viscous is -0.2; allowed: 0 s/m or above"),
        ("velocity = 0.005", "velocity = 0", "friction.stribeck_velocity is 0.0; allowed: above 0 m/s"),
        (
            "stribeck_velocity = 0.005\n",
            "",
            "surface.friction: stribeck_velocity is missing; allowed: above 0",
        ),
        ("mu_static = 0.6\nmu_kinetic = 0.4", "mu = 0.4", "stribeck_velocity is given with mu alone"),
        ("mu = 0.5", "mu_static = 0.5\nmu_kinetic = 0.4", "contact.cube_on_floor.friction: the dahl law has"),
        ('[contact.cube_on_floor.friction]\nlaw = "dahl"', "friction = 3", "friction is 3; allowed: a table"),
    ],
)
def test_a_malformed_law_gets_one_sentence(old, new, says, tmp_path):
    assert old in FILE
    (tmp_path / "scene.toml").write_text(FILE.replace(old, new))
    with pytest.raises(hapjax.InputError) as refused:
        hapjax.load_scene(tmp_path / "scene.toml")
    assert says in str(refused.value) and "\n" not in str(refused.value)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: hapjax.Viscous(-1.0), "coefficient is -1.0; allowed: 0 s/m or above"),
        (lambda: hapjax.Stribeck(0.0), "stribeck_velocity is 0.0; allowed: above 0 m/s"),
        (lambda: hapjax.Stribeck(0.1, np.nan), "viscous is nan"),
        (lambda: hapjax.Karnopp(0.0), "velocity_band is 0.0; allowed: above 0 m/s"),
        (lambda: hapjax.LuGre(-1.0), "bristle_damping is -1.0"),
        (lambda: hapjax.Surface(1.0, 0.3, friction=hapjax.Stribeck(0.1)), "the stribeck law has mu alone"),
        (lambda: hapjax.Surface(1.0, friction=hapjax.Dahl(), **TWO), "the dahl law has mu_static and mu_kin"),
    ],
)
def test_numbers_out_of_range_are_refused(make, says):
    with pytest.raises(hapjax.InputError) as refused:
        make()
    assert says in str(refused.value)


@pytest.mark.parametrize("name", ["dahl", "lugre", "viscous"])
def test_drag_asks_for_the_time_only_where_friction_depends_on_it(name):
    points = jnp.zeros((2, 1, 3))
    if name == "dahl":
        hapjax.drag(surface(name), points, jnp.ones(1))
    else:
        with pytest.raises(hapjax.InputError, match="dt is missing; allowed: the time between points"):
            hapjax.drag(surface(name), points, jnp.ones(1))


@pytest.mark.parametrize("law", [hapjax.Viscous(0.8), hapjax.LuGre(0.01, 0.8)], ids=["viscous", "lugre"])
def test_a_sliding_block_is_slowed_by_the_law_of_its_contact(law):
    """m v' = -m g (mu + b v), by the block's corners on a plane."""
    mu, b, g, v0 = 0.2, 0.8, 9.81, 1.0
    block = hapjax.Object(
        hapjax.Box((0.2, 0.2, 0.02)), None, hapjax.Body(0.5, rotation=False), (0, 0, 0.01 - 1e-4)
    )
    pair = hapjax.Contact(0.5 * g / 4 / 1e-4, mu, friction=law, between=("block", "floor"))
    scene = hapjax.Scene(
        {"block": block, "floor": hapjax.Object(hapjax.Plane())},
        {"pair": pair},
        world=hapjax.World(gravity=(0, 0, -g)),
        integrator=hapjax.SemiImplicit(2e-4),
    )
    hips = jnp.full((500, 1, 3), 9.0)
    start = moving(hapjax.init(scene, hips[0]), "block", velocity=(v0, 0, 0))
    end, _ = hapjax.rollout(scene, start, hips)
    expected = (v0 + mu / b) * np.exp(-b * g * 0.1) - mu / b
    assert 0.2 < expected < 0.4
    assert float(end.motion["block"].velocity[0]) == pytest.approx(expected, abs=4e-3)


def test_the_law_in_the_documentation_is_read(tmp_path):
    page = (Path(__file__).resolve().parents[1] / "docs" / "friction.md").read_text()
    shown = page.split("```toml\n")[1].split("```")[0]
    box = '[object.cube]\nshape = "box"\nsize = [0.06, 0.06, 0.06]\n'
    (tmp_path / "scene.toml").write_text(box + shown)
    felt = hapjax.load_scene(tmp_path / "scene.toml").object["cube"].surface
    assert felt is not None and isinstance(felt.friction, hapjax.LuGre) and felt.mu_static is not None
    assert set(LAWS) == set(friction.LAWS) == {name for name in LAWS if f"\n| `{name}` |" in page}
