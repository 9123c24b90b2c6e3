"""Spells of contact that run side by side say what the whole path says."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from hapjax import Box, LuGre, Object, Plane, Recording, Scene, SemiImplicit, Surface, init, rollout
from hapjax_fitting.parameters import free_parameters
from hapjax_fitting.problem import grouped
from hapjax_fitting.spells import forces_in, spells_of

MU = "object.thing.surface.mu"


def scene_of(shape, **surface):
    surface = Surface(mu=0.7, stiffness=500.0, **surface)
    return Scene(object={"thing": Object(shape, surface=surface)}, integrator=SemiImplicit(dt=0.001))


def visits(seed=0, steps=1200):
    """Two fingers that wander through a cube of 40 mm and out of it again, (T, 2, 3) m."""
    time = np.linspace(0, 1, steps)[:, None, None]
    rate, phase = np.random.default_rng(seed).uniform((3, 0), (9, 2 * np.pi), (2, 3, 2)).transpose(2, 0, 1)
    return 0.045 * np.sin(2 * np.pi * rate * time + phase)


@pytest.mark.parametrize(
    "scene",
    [
        scene_of(Box([0.04, 0.04, 0.04]), damping=0.5),
        scene_of(Plane(), friction=LuGre(bristle_damping=1.0)),
    ],
    ids=["box", "LuGre"],
)
def test_spells_say_what_the_whole_path_says(scene):
    path = jnp.asarray(visits())
    if isinstance(scene.object["thing"].shape, Plane):
        path = path.at[..., 2].add(0.035)
    whole = jax.jit(rollout)(scene, init(scene, path[0]), path)[1].force
    spells = spells_of(scene, path[None])
    assert spells is not None
    spells = spells[0]
    force, lost = jax.jit(forces_in)(scene, path, spells)
    assert spells.shape[0] > 2 and 2 * spells.shape[1] <= len(path) and not lost.any()
    assert np.abs(whole).max() > 1
    np.testing.assert_allclose(force, whole, rtol=0, atol=1e-12)


def test_a_recording_that_begins_and_ends_in_contact():
    scene = scene_of(Plane())
    height = np.where(np.arange(100) % 40 < 10, -0.002, 0.01)  # 0 to 9, 40 to 49, 80 to 89
    height[95:] = -0.001
    path = jnp.asarray(np.stack([np.linspace(0, 0.05, 100), 0 * height, height], axis=-1)[:, None])
    whole = rollout(scene, init(scene, path[0]), path)[1].force
    spells = spells_of(scene, path[None])
    assert spells is not None
    force, _ = forces_in(scene, path, spells[0])
    np.testing.assert_allclose(force, whole, rtol=0, atol=1e-15)
    assert np.abs(whole[0]).max() > 0 and np.abs(whole[-1]).max() > 0


def test_where_the_whole_path_is_run():
    scene = scene_of(Plane())
    assert spells_of(scene, jnp.full((1, 50, 1, 3), -0.001)) is None  # one spell as long as the path
    times = np.arange(1200) / 1000
    hip = visits() + [0, 0, 0.035]
    recording = Recording(hip=hip, hip_t=times, force=0 * hip, force_t=times)

    def cut(path):
        given = free_parameters(scene, path)
        return grouped(scene, [recording], ("force",), ["r"], given)[0].spells is not None

    assert cut(MU)
    assert not cut("object.thing.position")  # when they touch depends on it
