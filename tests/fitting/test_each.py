"""Numbers that recordings share, and numbers that each has for itself."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from fitting_cases import MU, SIGMA, STIFFNESS, floor, recorded
from hapjax import InputError
from hapjax_fitting import fit
from hapjax_fitting.replay import replay

NAMES, FREE = ["dry", "wet"], [MU, STIFFNESS]
OPTIONS: dict[str, Any] = {"noise": {"force": SIGMA}, "starts": 2}
DRY, WET = f"{MU} @ dry", f"{MU} @ wet"
OFF = floor(mu=0.6, stiffness=600.0)


def found(result, name) -> Any:
    p = result.parameters[name]
    assert p.identified
    return p.estimate, p.standard_error


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
