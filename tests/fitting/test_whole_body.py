"""Mass, centre and inertia together: always those of a real body, and found again from a grasp."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import hapjax
from hapjax import Body, Box, InputError, Object, Recording, Scene, Surface, World, init
from hapjax_fitting import fit
from hapjax_fitting.parameters import find_leaf, free_parameters, report, reported, values_of, with_values
from hapjax_fitting.whole_body import body_of, made_explicit, numbers_of
from helpers import well_compiled

CUBE, PATH = "object.cube.body", "object.cube.body.pseudo_inertia"
CENTRE = np.array([0.005, -0.004, 0.003])
INERTIA = np.array([[1.6e-4, 1.5e-5, -1.0e-5], [1.5e-5, 1.3e-4, 2.0e-5], [-1.0e-5, 2.0e-5, 1.1e-4]])
ENTRIES = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)]
NAMES = [f"{CUBE}.mass", *(f"{CUBE}.centre[{i}]" for i in range(3))]
NAMES += [f"{CUBE}.inertia[{i}][{j}]" for i, j in ENTRIES]
TRUTH = dict(zip(NAMES, [0.2, *CENTRE, *(INERTIA[i, j] for i, j in ENTRIES)], strict=True))


def cube(body) -> Scene:
    thing = Object(Box((0.06,) * 3), Surface(2000.0, mu=1.5, damping=2.0), body)
    return Scene(object={"cube": thing}, world=World(gravity=(0.0, 0.0, -9.81)))


def test_whatever_the_numbers_the_body_is_a_real_one(dtype):
    numbers = jnp.asarray(np.random.default_rng(0).uniform(-1.5, 1.5, (200, 10)), dtype)
    mass, centre, inertia = jax.jit(jax.vmap(body_of))(numbers)
    assert mass.dtype == centre.dtype == inertia.dtype == dtype
    assert np.all(mass > 0)
    np.testing.assert_array_equal(centre, numbers[:, 7:])
    np.testing.assert_array_equal(inertia, np.swapaxes(inertia, 1, 2))
    principal = np.linalg.eigvalsh(np.asarray(inertia, np.float64))
    rounding = 20 * jnp.finfo(dtype).eps * principal[:, 2]
    assert np.all(principal[:, 0] > 0)
    assert np.all(principal[:, 2] < principal[:, 0] + principal[:, 1] + rounding)


def test_the_ten_numbers_are_the_factor_of_the_pseudo_inertia():
    mass, centre, inertia = jnp.asarray(0.2), jnp.asarray(CENTRE), jnp.asarray(INERTIA)
    a, d1, d2, d3, s12, s23, s13, *t = np.asarray(numbers_of(mass, centre, inertia))
    upper = np.exp(a) * np.array(
        [
            [np.exp(d1), s12, s13, t[0]],
            [0, np.exp(d2), s23, t[1]],
            [0, 0, np.exp(d3), t[2]],
            [0, 0, 0, 1],
        ]
    )
    about_origin = INERTIA + 0.2 * (CENTRE @ CENTRE * np.eye(3) - np.outer(CENTRE, CENTRE))
    expected = np.zeros((4, 4))
    expected[:3, :3] = 0.5 * np.trace(about_origin) * np.eye(3) - about_origin
    expected[:3, 3] = expected[3, :3] = 0.2 * CENTRE
    expected[3, 3] = 0.2
    np.testing.assert_allclose(upper @ upper.T, expected, rtol=1e-12, atol=1e-18)


def test_there_and_back(dtype):
    numbers = jnp.asarray(np.random.default_rng(1).uniform(-1, 1, (50, 10)), dtype)
    again = jax.jit(jax.vmap(lambda x: numbers_of(*body_of(x))))(numbers)
    np.testing.assert_allclose(again, numbers, atol=1e-12 if dtype == jnp.float64 else 2e-4)


def test_derivatives_are_those_of_differences():
    numbers = numbers_of(jnp.asarray(0.2), jnp.asarray(CENTRE), jnp.asarray(INERTIA))

    inertia = jax.jit(lambda x: body_of(x)[2])
    slopes = jax.jit(jax.jacrev(inertia))(numbers)
    np.testing.assert_allclose(jax.jit(jax.jacfwd(inertia))(numbers), slopes, rtol=1e-12, atol=1e-18)
    for i in range(10):
        step = 1e-6 * jnp.eye(10)[i]
        difference = (inertia(numbers + step) - inertia(numbers - step)) / 2e-6
        np.testing.assert_allclose(slopes[..., i], difference, atol=1e-11)


@pytest.mark.parametrize(
    "body", [Body(0.3), Body(0.3, inertia=(1e-4, 2e-4, 2.5e-4)), Body(0.3, inertia=INERTIA, centre=CENTRE)]
)
def test_what_a_scene_leaves_out_is_written_out(body):
    scene = made_explicit(cube(body), [PATH])
    parameters = free_parameters(scene, PATH)
    assert len(parameters) == 10 and [p.name for p in reported(parameters)] == NAMES
    same = with_values(scene, parameters, values_of(scene, parameters))
    expected = body.inertia if body.inertia is not None else [0.3 * 0.06**2 / 6] * 3
    expected = np.diag(expected) if np.ndim(expected) == 1 else expected
    np.testing.assert_allclose(find_leaf(same, f"{CUBE}.inertia"), expected, rtol=1e-9, atol=1e-18)
    np.testing.assert_allclose(find_leaf(same, f"{CUBE}.mass"), 0.3, rtol=1e-12)
    np.testing.assert_allclose(
        find_leaf(same, f"{CUBE}.centre"), 0 * CENTRE if body.centre is None else CENTRE
    )


def test_results_are_in_mass_centre_and_inertia():
    scene = made_explicit(cube(Body(0.2, inertia=INERTIA, centre=CENTRE)), [PATH])
    parameters = free_parameters(scene, [f"{CUBE[:-5]}.surface.mu", PATH])
    said = reported(parameters)
    free = jnp.stack(
        [p.transform.free(v) for p, v in zip(parameters, values_of(scene, parameters), strict=True)]
    )
    values = [p.transform.value(x) for p, x in zip(said, report(parameters, free), strict=True)]
    np.testing.assert_allclose(values, [1.5, *TRUTH.values()], rtol=1e-9)


def swung(steps=500, seed=0) -> Recording:
    """Three fingers hold the cube and turn and shake it about all axes."""
    t = 2e-3 * np.arange(steps)
    grip = np.array([[-0.0285, 0.015, 0.012], [-0.0285, -0.015, 0.012], [0.027, 0.0, -0.012]])
    ease = np.minimum(t / 0.2, 1)[:, None]
    turned = Rotation.from_rotvec(0.5 * ease * np.sin(np.outer(t, [14.0, 19.0, 23.0])))
    place = 0.01 * ease * np.sin(np.outer(t, [17.0, 11.0, 21.0]))
    path = np.stack([turned.apply(g) + place for g in grip], axis=1)
    scene = at(Body(0.2, inertia=INERTIA, centre=CENTRE))
    hips = jnp.asarray(path)
    _, reply = well_compiled(hapjax.rollout)(scene, init(scene, hips[0]), hips)
    random = np.random.default_rng(seed)
    force, pose = np.asarray(reply.force), np.asarray(reply.pose).copy()
    pose[..., :3] += 1e-4 * random.standard_normal(pose[..., :3].shape)
    noise = 0.02 * random.standard_normal(force.shape)
    return Recording(hip=path, hip_t=t, force=force + noise, force_t=t, pose=pose, pose_t=t + 2e-3)


def at(body) -> Scene:
    scene = cube(body)
    return Scene(object=scene.object, world=scene.world, integrator=hapjax.SemiImplicit(dt=2e-3))


@pytest.mark.slow
def test_a_swung_body_is_found_whole():
    noise: dict[str, Any] = {"force": 0.02, "position": 1e-4, "angle": 1e-3}
    result = fit(at(Body(0.15)), swung(), PATH, noise=noise, starts=1)
    assert result.converged, result.reason
    assert list(result.parameters) == NAMES
    for name, truth in TRUTH.items():
        p = result.parameters[name]
        assert p.identified and p.estimate is not None and p.standard_error is not None, name
        assert abs(p.estimate - truth) < 3 * p.standard_error, name
        assert p.standard_error < (0.1 * abs(truth) if "centre" not in name else 1e-3) + 1e-5, name
    assert float(find_leaf(result.scene, f"{CUBE}.mass")) == result.parameters[NAMES[0]].estimate


@pytest.mark.slow
def test_a_prior_of_a_mass_holds_the_free_numbers():
    t = 1e-3 * np.arange(20)
    path = np.full((20, 1, 3), 10.0)
    pose = np.tile([0.0, 0, 0, 1, 0, 0, 0], (20, 1))
    pose[:, 2] = -0.5 * 9.81 * t**2
    recording = Recording(hip=path, hip_t=t, pose=pose[::3], pose_t=t[::3])  # too few for windows
    noise, priors = {"position": 1e-3, "angle": 1e-2}, {f"{CUBE}.mass": (0.25, 0.1)}
    result = fit(cube(Body(0.3)), recording, PATH, noise=noise, priors=priors, starts=1)
    mass = result.parameters[f"{CUBE}.mass"]
    assert mass.estimate == pytest.approx(0.25, rel=1e-3)
    assert mass.standard_error == pytest.approx(0.025, rel=0.01)
    assert not result.parameters[f"{CUBE}.inertia[0][0]"].identified


@pytest.mark.parametrize(
    ("free", "bounds", "message"),
    [
        ([f"{PATH}[0]"], {}, "is not free alone; allowed: object.cube.body.pseudo_inertia, all"),
        ([PATH, f"{CUBE}.mass"], {}, "free names object.cube.body.mass twice"),
        ([PATH], {PATH: (0.1, 1.0)}, "allowed: priors on mass, centre and inertia"),
        (["object.cube.surface.pseudo_inertia"], {}, "only a body has one"),
    ],
)
def test_refusals(free, bounds, message):
    scene = made_explicit(cube(Body(0.2)), free)
    with pytest.raises(InputError, match=message):
        free_parameters(scene, free, bounds)


def test_a_body_that_does_not_turn_has_no_inertia():
    with pytest.raises(InputError, match="the body does not rotate"):
        made_explicit(cube(Body(0.2, rotation=False)), [PATH])
