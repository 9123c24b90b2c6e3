"""Numbers that recordings share, and numbers that each has for itself."""

from dataclasses import replace
from typing import Any

import jax
import numpy as np
import pytest

from fitting_cases import MU, SIGMA, STIFFNESS, floor, problem_for, recorded
from hapjax import InputError
from hapjax_fitting import fit
from hapjax_fitting.grip import cost_of_grip, raised
from hapjax_fitting.noise import correlation_time
from hapjax_fitting.problem import channels_of, loss_at, residuals_at, stacked_residuals, with_loss
from hapjax_fitting.replay import replay
from hapjax_fitting.scores import widened
from hapjax_fitting.solve import jacobian
from hapjax_fitting.uncertainty import certainty

NAMES, FREE = ["dry", "wet"], [MU, STIFFNESS]
OPTIONS: dict[str, Any] = {"noise": {"force": SIGMA}, "starts": 2}
DRY, WET = f"{MU} @ dry", f"{MU} @ wet"
OFF = floor(mu=0.6, stiffness=600.0)


def found(result, name) -> Any:
    p = result.parameters[name]
    assert p.identified
    return p.estimate, p.standard_error


@pytest.mark.slow
def test_two_mus_and_one_stiffness():
    recordings = [recorded(floor(0.9), 0), recorded(floor(0.4), 1)]
    result = fit(OFF, recordings, FREE, each=MU, names=NAMES, **OPTIONS)
    assert result.converged and list(result.parameters) == [DRY, WET, STIFFNESS]
    for name, truth in ((DRY, 0.9), (WET, 0.4), (STIFFNESS, 800.0)):
        estimate, error = found(result, name)
        assert abs(estimate - truth) < 4 * error < 0.05 * truth
    for name, path in (("dry", DRY), ("wet", WET)):
        surface = result.scene_of(name).object["floor"].surface
        assert surface is not None and surface.mu is not None
        assert float(surface.mu) == pytest.approx(result.parameters[path].estimate)
    (touching,) = replay(result, recordings[1], "wet").touching
    assert touching.mu == {"mu": pytest.approx(result.parameters[WET].estimate)}


@pytest.mark.slow
def test_with_nothing_shared_it_is_each_fit_alone():
    recordings = [recorded(floor(0.9, 700.0), 0), recorded(floor(0.4, 900.0), 1, steps=300)]  # of two lengths
    together = fit(OFF, recordings, FREE, each=FREE, names=NAMES, **OPTIONS)
    for recording, name in zip(recordings, NAMES, strict=True):
        alone = fit(OFF, recording, FREE, **OPTIONS)
        for path in FREE:
            both = found(together, f"{path} @ {name}"), found(alone, path)
            np.testing.assert_allclose(*both, rtol=1e-5)
    assert together.correlation[0, 1] == pytest.approx(0, abs=1e-6)


def test_one_that_never_slips_has_a_bound_of_its_own():
    recordings = [recorded(floor(0.9), 0), recorded(floor(0.4), 1, length=2e-4)]
    result = fit(OFF, recordings, FREE, each=[MU], names=NAMES, **OPTIONS)
    assert found(result, DRY)[0] == pytest.approx(0.9, rel=0.02)
    wet = result.parameters[WET]
    assert not wet.identified and wet.reason is not None and "slipped" in wet.reason
    assert wet.interval95[0] is not None and 0 < wet.interval95[0] < 0.4


@pytest.mark.slow
def test_sensors_of_each():
    recordings = [recorded(floor(), 0), recorded(floor(), 1)]
    assert recordings[1].force is not None
    recordings[1] = replace(recordings[1], force=recordings[1].force + np.array([0.0, 0.5, 0.0]))
    bias = "sensor.force_bias[1]"
    result = fit(floor(), recordings, bias, each=bias, names=NAMES, priors={bias: (0.0, 10.0)}, **OPTIONS)
    for name, truth in zip(NAMES, (0.0, 0.5), strict=True):
        estimate, error = found(result, f"{bias} @ {name}")
        assert abs(estimate - truth) < 4 * error
        assert np.asarray(result.sensors_of(name).force_bias)[1] == estimate


def test_numbers_of_many_recordings_are_looked_at_all_at_once(monkeypatch):
    """What a larger mu costs, and how much wider noise that grows with the force makes intervals: as one by one."""
    recordings = [recorded(floor(), i, sigma=SIGMA * (1 + i), steps=60) for i in range(3)]
    assert recordings[2].force is not None
    grown = recordings[2].force * np.random.default_rng(0).normal(1, 0.1, recordings[2].force.shape)
    recordings[2] = replace(recordings[2], force=grown)
    problem = problem_for(floor(), recordings, FREE, FREE)
    free, calls = problem.start() + 0.01, []
    residuals = residuals_at(free, problem)
    matrix = np.asarray(jax.jit(lambda x, p: jacobian(stacked_residuals, x, p)[0])(free, problem))
    known = certainty(matrix, np.ones(len(matrix)), np.full(6, np.inf), np.ones(6, bool))
    pulls = (matrix @ known.inverse).reshape(-1, 3, 6) * residuals.reshape(-1, 3)[..., None]
    alike = correlation_time([r for _, r in channels_of(residuals, problem)])
    variance = np.sum(np.sum(pulls, axis=1) ** 2, axis=0) * alike * len(matrix) / (len(matrix) - 6)
    losses = [loss_at(raised(free, p, i), problem) for i, p in enumerate(problem.parameters[:3])]
    one_by_one = 2 * (np.array(losses) - loss_at(free, problem))

    def counted(*args):
        calls.append(args)
        return with_loss(*args)

    monkeypatch.setattr("hapjax_fitting.problem.with_loss", counted)
    np.testing.assert_allclose(cost_of_grip(free, problem)[:3], one_by_one, rtol=1e-9)
    factors = widened(free, problem, residuals, matrix, None, known, None, {})
    assert len(calls) == 3 + 2
    np.testing.assert_allclose(
        factors, np.sqrt(np.maximum(1, variance / np.diag(known.covariance))), rtol=1e-3
    )
    assert (factors > 1.1).any()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"each": STIFFNESS}, f"each names {STIFFNESS}, which is not free; allowed: {MU}"),
        ({"each": MU, "names": ["a", "a"]}, "names has a twice"),
        ({"each": MU, "names": NAMES, "bounds": {f"{MU} @ dry": (2.0, 3.0)}}, "starts at 0.6"),
    ],
)
def test_refusals(options, message):
    with pytest.raises(InputError, match=message):
        fit(floor(), [recorded(floor())] * 2, MU, **options)
