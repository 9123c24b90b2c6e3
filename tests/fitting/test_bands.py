"""Numbers of which only the loss tells, and the mu of single fingers: found from far off, with honest bounds."""

from typing import Any

import numpy as np
import pytest

import hapjax
from fitting_cases import SIGMA, forces, stroke
from hapjax_fitting import fit

BAND, FACTOR = "world.dead_band", "object.floor.surface.finger_mu"


def recorded(scene, path) -> hapjax.Recording:
    t = 1e-3 * np.arange(len(path))
    clean = forces(scene, path)
    noise = SIGMA * np.random.default_rng(0).standard_normal(clean.shape)
    return hapjax.Recording(hip=path, hip_t=t, force=clean + noise, force_t=t)


def fitted(scene, recording, free) -> Any:
    return fit(scene, recording, [free], noise={"force": SIGMA}, starts=1)


def ball(dead_band: float) -> hapjax.Scene:
    body = hapjax.Body(0.2, inertia=(1e-4,) * 3)
    thing = hapjax.Object(hapjax.Sphere(0.03), hapjax.Surface(800.0, mu=0.8, damping=1.0), body)
    return hapjax.Scene({"it": thing}, world=hapjax.World(dead_band=dead_band))


def twisted() -> np.ndarray:
    """Two fingers hold the ball and turn it to and fro, further and further, (T, 2, 3) m."""
    t = np.linspace(0, 1, 250)
    squeeze, turn = np.interp(t, [0, 0.1], [0.0305, 0.027]), 0.15 * t * np.sin(20 * t)
    one = np.stack([squeeze * np.cos(turn), squeeze * np.sin(turn), 0 * t], axis=-1)
    return np.stack([one, one * [-1, -1, 1]], axis=1)


@pytest.mark.slow
def test_a_dead_band_is_found_from_ten_times_off():
    truth, path = 0.02, twisted()
    recording = recorded(ball(truth), path)
    for factor in (10, 0.1):
        result = fitted(ball(factor * truth), recording, BAND)
        found = result.parameters[BAND]
        assert result.converged and found.identified
        assert found.interval95[0] <= truth <= found.interval95[1]
        assert 0 < found.interval95[1] - found.interval95[0] < 0.1 * truth
        assert found.interval95[0] < found.estimate < found.interval95[1]
        assert float(result.scene.world.dead_band) == pytest.approx(truth, rel=0.03)
    # Of none at all the data say how large it is at most, of one that nothing overcomes how large at least.
    found = fitted(ball(truth), recorded(ball(1e-9), path), BAND).parameters[BAND]
    assert not found.identified and found.reason == "any smaller one explains the data as well"
    assert found.interval95[0] is None and 1e-9 < found.interval95[1] < truth
    found = fitted(ball(truth), recorded(ball(10.0), path), BAND).parameters[BAND]
    assert not found.identified and found.reason == "any larger one explains the data as well"
    assert found.interval95[1] is None and truth < found.interval95[0] < 10
    away = fitted(ball(truth), recorded(ball(truth), path + 1.0), BAND).parameters[BAND]
    assert (away.reason, away.interval95) == ("the data do not depend on it", (None, None))


def floor(*factors: float) -> hapjax.Scene:
    surface = hapjax.Surface(800.0, mu=0.5, finger_mu=factors)
    return hapjax.Scene({"floor": hapjax.Object(hapjax.Plane(), surface)})


@pytest.mark.slow
def test_the_mu_of_each_finger_is_found_or_bounded():
    one = stroke(300)[1]
    path = np.concatenate([one, one + [0, 0.05, -5e-4]], axis=1)
    truth, recording = (1.2, 0.6), recorded(floor(1.2, 0.6), path)
    for start in ((0.6, 1.2), (2.4, 0.3)):
        result = fitted(floor(*start), recording, FACTOR)
        assert result.converged
        for i, factor in enumerate(truth):
            found = result.parameters[f"{FACTOR}[{i}]"]
            assert (
                found.identified and abs(found.estimate - factor) < 3 * found.standard_error < 0.02 * factor
            )
    # The first finger hardly moves along the floor, and sticks: it pulls with 800 N/m.
    held = path * np.where(np.arange(2) == 0, 0.04, 1.0)[:, None] ** [1, 0, 0]
    result = fitted(floor(1.0, 1.0), recorded(floor(1.2, 0.6), held), FACTOR)
    first, second = result.parameters.values()
    x, depth = held[:, 0, 0], -held[:, 0, 2]
    largest = np.max((x - x[np.argmax(depth > 0)])[100:] / depth[100:]) / 0.5
    assert (first.reason, first.interval95[1]) == ("nothing slipped", None)
    assert first.interval95[0] == pytest.approx(largest, rel=1e-6) and largest < 1.2
    assert second.identified and abs(second.estimate - 0.6) < 3 * second.standard_error
