"""Where a search ends on a plateau, it looks elsewhere, says up to where it reaches, and is no success."""

from typing import Any

import numpy as np
import pytest

from fitting_cases import SIGMA, forces
from hapjax import Body, Box, Object, Recording, Scene, Sphere, Surface
from hapjax_fitting import fit
from hapjax_fitting.report import in_words
from hapjax_fitting.success import why_not

RADIUS, STEPS = "object.ball.radius", 60
T = 1e-3 * np.arange(STEPS)


def ball(radius: float) -> Scene:
    return Scene(object={"ball": Object(Sphere(radius), Surface(800.0, mu=0.5))})


def pressed(lowest: float) -> Recording:
    """A finger comes down on a ball of 50 mm, or not quite."""
    path = np.linspace([0.0, 0.0, 0.06], [0.0, 0.0, lowest], STEPS)[:, None]
    force = forces(ball(0.05), path) + SIGMA * np.random.default_rng(0).standard_normal(path.shape)
    return Recording(hip=path, hip_t=T, force=force, force_t=T)


def fitted(lowest: float, radius: float) -> Any:
    return fit(ball(radius), pressed(lowest), [RADIUS], noise={"force": SIGMA}, starts=1)


@pytest.mark.slow
def test_a_number_without_influence_is_looked_for_elsewhere():
    p = fitted(0.048, 0.002).parameters[RADIUS]
    assert p.identified and abs(p.estimate - 0.05) < 4 * p.standard_error < 1e-4


def test_a_number_that_shows_nowhere_near_has_a_bound():
    result = fitted(0.055, 0.02)
    p = result.parameters[RADIUS]
    assert result.converged and not p.identified and p.interval95[0] is None
    assert p.interval95[1] == pytest.approx(0.055, rel=0.02)
    assert in_words(p).startswith("at most 0.055") and "any smaller one explains" in p.reason


def test_starts_that_agree_where_nothing_has_influence_are_no_success():
    assert why_not(True, 290.0, 2, 2, flat=[]) is None and why_not(True, 1.0, 2, 2, flat=[RADIUS]) is None
    assert f"{RADIUS} has no influence there" in str(why_not(True, 290.0, 2, 2, flat=[RADIUS]))


@pytest.mark.slow
def test_beside_a_whole_body_too():
    """A finger pushes a cube, and never comes near the ball."""
    cube = Object(Box((0.06,) * 3), Surface(800.0, mu=0.5), Body(0.2), position=(0.0, 0.0, -0.1))
    scene = Scene(object={"ball": Object(Sphere(0.02), Surface(800.0, mu=0.5)), "cube": cube})
    path = np.array([0.0, 0.0, -0.069]) - np.outer(np.linspace(0, 1, STEPS), [0, 0, 0.004])
    recording = Recording(hip=path[:, None], hip_t=T, force=forces(scene, path[:, None]), force_t=T)
    free = [RADIUS, "object.cube.body.pseudo_inertia"]
    p = fit(scene, recording, free, noise={"force": SIGMA}, starts=1).parameters[RADIUS]
    assert not p.identified and p.interval95[0] is None and p.interval95[1] == pytest.approx(0.069, rel=0.02)
