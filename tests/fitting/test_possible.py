"""What a fit finds just beyond what can be: the scene stays one that can be loaded, and says what differs."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from fitting_cases import held_cube
from hapjax import InputError, Surface, load_scene, save_scene
from hapjax_fitting.possible import possible


def test_what_cannot_be_is_moved_to_the_nearest_that_can(tmp_path):
    scene = held_cube()
    surface = Surface(800.0, mu_static=[0.5] * 6, mu_kinetic=[0.4] * 6)
    scene = eqx.tree_at(lambda s: s.object["cube"].surface, scene, surface)
    same, said = possible(scene)
    assert said == () and eqx.tree_equal(same, scene)
    moments, kinetic = jnp.array([6.0, 12.3, 6.0]) * 1e-5, jnp.array([0.4] * 5 + [0.6])
    wrong = eqx.tree_at(
        lambda s: (s.object["cube"].body.inertia, s.object["cube"].surface.mu_kinetic),
        scene,
        (moments, kinetic),
    )
    save_scene(wrong, tmp_path / "wrong.toml")
    with pytest.raises(InputError):
        load_scene(tmp_path / "wrong.toml")
    scene, said = possible(wrong)
    assert len(said) == 2 and "6.1e-05, 1.22e-04, 6.1e-05" in " ".join(said).replace("0.000122", "1.22e-04")
    save_scene(scene, tmp_path / "right.toml")
    cube: Any = load_scene(tmp_path / "right.toml").object["cube"]
    np.testing.assert_allclose(cube.body.inertia, [6.1e-5, 12.2e-5, 6.1e-5], rtol=1e-6)
    np.testing.assert_allclose(cube.surface.mu_static, [0.5] * 5 + [0.6], rtol=1e-6)
