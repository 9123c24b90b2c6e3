"""Fits of what is dragged over a plane along a known motion: against friction ellipses and moments known by hand."""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from hapjax import InputError, Surface
from hapjax_fitting import Drags, fit_drags

LOADS, ARMS = np.array([2.0, 3.0]), np.array([[0.05, 0.0, 0.0], [-0.03, 0.0, 0.0]])
GYRATION = 0.04
SURFACE = Surface(1e7, mu=0.4, anisotropy=1.5, grain=[1.0, 0.0, 0.0])


def drags(angles, mu=0.3, across=2.0, out=1.0, noise=0.0, seed=0, dtype=None):
    """An object on two feet, straight along each angle: mu along x, `across` times mu along y, an ellipse between."""
    along = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=-1)
    way = np.linspace(0, 0.05, 20)[None, :, None] * along[:, None]
    size = mu / np.sqrt(np.cos(angles) ** 2 + (np.sin(angles) / across) ** 2)
    force = (size[:, None] * along)[:, None] * LOADS[None, :, None]  # of what drags, on each foot (P, V, 3)
    moment = np.sum(np.cross(out * ARMS[None], force)[..., 2], axis=1)
    wrench = np.column_stack([force.sum(axis=1)[:, :2], moment / GYRATION])[:, None]
    wrench = np.repeat(wrench, 20, axis=1) + noise * np.random.default_rng(seed).normal(
        size=(len(angles), 20, 3)
    )
    wrench[:, 0] = 0  # nothing pulls yet
    arms = np.broadcast_to(ARMS, (*way.shape[:2], 2, 3))
    values = (way[:, :, None] + arms, arms, LOADS, wrench, GYRATION)
    return Drags(*(jnp.asarray(x, dtype) for x in values))


@pytest.mark.slow
def test_finds_a_friction_ellipse_and_how_far_out_the_feet_stand():
    angles = np.linspace(0.1, 6.0, 9)
    found = fit_drags(
        SURFACE,
        (drags(angles, out=1.2, noise=0.01), drags(angles + 0.3, out=1.2, noise=0.03, seed=1)),
        ("surface.mu", "surface.anisotropy", "arms"),
    )
    assert found.starts_at_best == found.starts and found.drags == 18
    for path, truth in {"surface.mu": 0.3, "surface.anisotropy": 2.0, "arms": 1.2}.items():
        estimate: Any = found.parameters[path]
        assert abs(estimate.estimate - truth) < 3 * estimate.standard_error < 0.05 * truth
        low, high = estimate.interval95
        assert low < estimate.estimate < high
    mu = found.surface.mu
    assert mu is not None and float(mu) == found.parameters["surface.mu"].estimate
    np.testing.assert_allclose(found.noise, [[0.01, 0.01], [0.03, 0.03]], rtol=0.2)


def test_in_float32_too(dtype):
    found = fit_drags(SURFACE, drags(np.linspace(0.1, 6.0, 9), noise=0.01, dtype=dtype), "surface.mu")
    estimate: Any = found.parameters["surface.mu"]
    assert abs(estimate.estimate - 0.3 * 4 / 3) < 0.1


@pytest.mark.parametrize(
    ("given", "free", "sentence"),
    [
        ((), "surface.mu", "felt: 0 drags are given; allowed: at least 2"),
        ((drags(np.array([0.3])),), "surface.mu", "felt: 1 drags are given; allowed: at least 2"),
        (
            (drags(np.array([0.3, 1.0])),),
            "surface.rough",
            "surface has no rough; allowed: surface.stiffness, surface.mu",
        ),
        (
            (drags(np.zeros(3)),),
            ("surface.mu", "surface.anisotropy"),
            "felt: the drags do not determine surface.anis",
        ),
    ],
)
def test_a_refusal_is_one_sentence(given, free, sentence):
    with pytest.raises(InputError) as told:
        fit_drags(SURFACE, given, free, name="felt")
    assert sentence in str(told.value) and "\n" not in str(told.value)


@pytest.mark.parametrize(
    ("field", "value", "sentence"),
    [
        ("feet", np.zeros((2, 3)), "feet has the shape (2, 3); allowed: (P, S, V, 3)"),
        ("wrench", np.zeros((3, 20, 3)), "wrench has the shape (3, 20, 3); allowed: (2, 20, 3)"),
        ("wrench", np.full((2, 20, 3), np.nan), "wrench is nan at [0, 0, 0]; allowed: finite numbers"),
        ("loads", np.array([1.0, -1.0]), "loads is [1.0, -1.0]; allowed: 0 N or above"),
        ("gyration", 0.0, "gyration is 0.0; allowed: above 0 m"),
    ],
)
def test_drags_that_do_not_fit_together_are_refused(field, value, sentence):
    with pytest.raises(InputError) as told:
        replace(drags(np.array([0.3, 1.0])), **{field: value})
    assert sentence in str(told.value) and len(str(told.value)) < 200
