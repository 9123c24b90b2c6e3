"""A recording in which the model leaves the range of sense: dropped and counted."""

from typing import Any

import numpy as np

import hapjax
from fitting_cases import BOTH, SIGMA, floor, recorded
from hapjax import Recording
from hapjax_fitting import fit


def with_ball(scene):
    """The floor, and beside it a ball so stiff that a finger in it meets a force beyond all sense."""
    ball = hapjax.Object(
        hapjax.Sphere(0.05), hapjax.Surface(1e16, mu=0.5), hapjax.Body(0.01), position=(1.0, 0.0, 1.0)
    )
    return hapjax.Scene(object=dict(scene.object) | {"ball": ball}, integrator=scene.integrator)


def test_a_lost_recording_is_dropped_and_counted():
    good = recorded(floor(), steps=200)
    hip = np.array(good.hip)
    hip[100:] = [1.0, 0.0, 1.01]
    bad = Recording(hip=hip, hip_t=good.hip_t, force=good.force, force_t=good.force_t)
    off = with_ball(floor(mu=0.9, stiffness=500.0))
    options: dict[str, Any] = dict(noise={"force": SIGMA}, starts=2, observe="force")
    alone = fit(off, good, BOTH, **options)
    both = fit(off, [good, bad], BOTH, **options)
    assert (alone.lost, both.lost) == (0, 1)
    assert both.to_dict()["lost"] == 1
    for name in BOTH:
        one, other = alone.parameters[name], both.parameters[name]
        assert one.estimate is not None and other.estimate is not None and one.standard_error is not None
        assert abs(one.estimate - other.estimate) < 1e-3 * one.standard_error
    np.testing.assert_allclose(both.residual_rms["force"], alone.residual_rms["force"], rtol=1e-3)


def test_the_report_says_that_recordings_were_dropped(tmp_path):
    from dataclasses import replace

    from hapjax_fitting.report import _warnings

    result = fit(floor(mu=0.9), recorded(floor(), steps=200), BOTH, noise={"force": SIGMA}, starts=1)
    assert not any("range of sense" in w for w in _warnings(result))
    assert any(
        "In 1 of 1 recording the model left the range of sense" in w
        for w in _warnings(replace(result, lost=1))
    )
