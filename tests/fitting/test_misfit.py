"""Residuals beyond the noise: of which channel, recording and axis it is said."""

from dataclasses import replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from fitting_cases import BOTH, SIGMA, floor, held_cube, problem_for, recorded, shaken_cube
from hapjax_fitting.misfit import misfit
from hapjax_fitting.problem import residuals_at


def said(scene, recordings, free, given=("force",), loss="squares", noise=SIGMA):
    problem = problem_for(scene, recordings, free, loss=loss)
    problem = replace(problem, noise=replace(problem.noise, force=jnp.asarray(noise)))
    residuals = residuals_at(problem.start(), problem)
    return misfit(residuals, problem, [f"r{i}" for i in range(len(recordings))], given)


def pulled(recording, by, axis=1):
    """A force that is more along one axis than any model says."""
    return replace(recording, force=recording.force + by * np.eye(3)[axis])


def test_what_the_model_explains_is_no_misfit():
    assert not said(floor(), [recorded(floor(), seed) for seed in range(3)], BOTH)
    rounded = pulled(recorded(floor(), sigma=0), 1e-3)
    assert not said(floor(), [rounded], BOTH, (), noise=1e-6) and said(floor(), [rounded], BOTH, noise=1e-6)


@pytest.mark.parametrize("given", [("force",), ()])
def test_channel_axis_and_size_are_named(given):
    (found,) = said(floor(), [pulled(recorded(floor()), 30 * SIGMA)], BOTH, given)
    assert (found.channel, found.kind, found.recording) == ("force", "misfit", "")
    assert f"17.4 times the noise, 0.02 N as it was {'given' if given else 'estimated'};" in found.sentence
    assert "most along y of finger 0, 30 times: " in found.sentence


def test_of_several_recordings_the_worst_is_named():
    """Of unequal lengths, so that they do not run side by side, or with ends that only fill up."""
    true, other = recorded(floor(), steps=400), recorded(floor(), 1, steps=350)
    every = [true, pulled(other, 10 * SIGMA, 2), pulled(recorded(floor(), steps=200), 4 * SIGMA)]
    (found,) = said(floor(), every, BOTH)
    assert found.recording == "r1" and found.count == 2
    assert ", in 2 of 3 recordings beyond 2 times; most along z of finger 0, 9.8" in found.sentence


def test_poses_are_named_by_object_and_axis():
    true: Any = shaken_cube()
    (found,) = said(
        held_cube(), [replace(true, pose=true.pose + 2e-3 * np.eye(7)[1])], ["object.cube.body.mass"]
    )
    assert found.channel == "pose" and "residuals of position are 11" in found.sentence
    assert "0.0001 m as it was estimated; most along y of cube, 20" in found.sentence


@pytest.mark.parametrize(("loss", "off"), [("huber", False), ("student", False), ("squares", True)])
def test_outliers_that_do_not_count_are_no_misfit(loss, off):
    true: Any = recorded(floor())
    force = true.force.copy()
    force[::20] += 100 * SIGMA
    assert bool(said(floor(), [replace(true, force=force)], BOTH, loss=loss)) == off
