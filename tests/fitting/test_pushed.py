"""The pushed block of hapjax benchmark fit: its law, its bound, and the two programs that fit it."""

import io

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from rich.console import Console

from hapjax import InputError, cast, init, rollout
from hapjax_fitting.benchmark import beside_mujoco, mujoco_sysid, pushed, report

TRUTH = jnp.array(pushed.TRUTH)


def test_the_law_is_that_of_a_mass_on_a_spring_with_coulomb_friction():
    """Against steps of 2 us; the first slip does not lie on one of them, so that a step's error is left."""
    mu, mass, dt = 0.51, 0.203, 2e-6
    place = speed = 0.0
    seen = []
    for i in range(150_000):
        if i % 500 == 0:
            seen.append(place)
        pull = pushed.STIFFNESS * (pushed.SPEED * min(i * dt, pushed.LED) - place)
        if speed > 0 or pull > mu * mass * pushed.G:
            speed = max(0.0, speed + dt * (pull / mass - mu * pushed.G))
        place += dt * speed
    t = 500 * dt * np.arange(300)
    found, force = pushed.law(jnp.array([mu, mass]), t)
    np.testing.assert_allclose(found, seen, atol=1e-7)
    led = pushed.SPEED * np.minimum(t, pushed.LED)
    np.testing.assert_allclose(force, pushed.STIFFNESS * (led - np.array(seen)), atol=1e-4)
    assert np.ptp(np.asarray(force)[-50:]) == 0 < float(force[-1])  # at rest, still pressed


def test_the_bound_is_how_far_the_law_itself_fitted_to_noise_is_off():
    random, t = np.random.default_rng(0), np.arange(300) / pushed.RATE
    law = jax.jit(lambda numbers: jnp.concatenate(pushed.law(numbers, t)))
    scale = np.repeat([pushed.NOISE["position"], pushed.NOISE["force"]], 300)
    clean = np.asarray(law(TRUTH))

    def off():
        seen = clean + scale * random.standard_normal(600)
        return scipy.optimize.least_squares(
            lambda x: (np.asarray(law(jnp.asarray(x))) - seen) / scale, TRUTH, x_scale=pushed.TRUTH
        ).x

    spread = np.std([off() for _ in range(80)], axis=0)
    np.testing.assert_allclose(spread, pushed.least_errors(), rtol=0.25)


def test_the_scene_follows_the_law():
    clean = pushed.recorded(0)
    assert clean.hip is not None and clean.hip_t is not None
    t = pushed.DT * np.arange(599)
    path = np.stack([np.interp(t, clean.hip_t, clean.hip[:, 0, k]) for k in range(3)], axis=-1)[:, None]
    scene = cast(pushed.scene(*pushed.TRUTH), jnp.float64)
    reply = jax.jit(rollout)(scene, init(scene, jnp.asarray(path[0])), jnp.asarray(path))[1]
    place, _ = pushed.law(TRUTH, t + pushed.DT)
    _, force = pushed.law(TRUTH, t)
    np.testing.assert_allclose(reply.pose[:, 0, 0], place, atol=pushed.NOISE["position"] / 10)
    np.testing.assert_allclose(-reply.force[:, 0, 0], force, atol=pushed.NOISE["force"] / 10)


def test_mujocos_model_is_the_same_block():
    """From starts that are near; 10 standard errors are what its contact may be off."""
    pytest.importorskip("mujoco.sysid")
    found, width = mujoco_sysid.fit(pushed.recorded(0), (0.51, 0.198))
    bound = pushed.least_errors()
    assert np.all(np.abs(found - pushed.TRUTH) < 10 * bound)
    np.testing.assert_allclose(width, 1.96 * bound, rtol=0.5)


@pytest.mark.slow
def test_both_programs_get_the_same_recording():
    pytest.importorskip("mujoco.sysid")
    told = []
    figures = beside_mujoco.measure(1, lambda *said: told.append(said))
    assert told == [(name, 0.5) for name in figures["programs"]]
    ours, theirs = figures["programs"]["hapjax"], figures["programs"]["mujoco.sysid"]
    assert ours["arrived"] == 1 and max(ours["error"]) < 4 and max(theirs["error"]) < 10
    np.testing.assert_allclose(ours["width"], 1, atol=0.1)
    assert min(p[key] for p in (ours, theirs) for key in ("warm_s", "first_s")) > 0
    said = printed(figures)
    assert "1 of 1" in said and f"{ours['error'][0]:.2f}, {ours['error'][1]:.2f}" in said


def test_without_mujoco_the_section_says_so(monkeypatch):
    def missing():
        raise InputError("mujoco is not installed; allowed with it: pip install 'hapjax[bench]'")

    monkeypatch.setattr(mujoco_sysid, "programs", missing)
    said = printed(report.beside(1))
    assert said.startswith("Not beside mujoco.sysid: mujoco is not installed") and "[bench]" in said


def test_figures_are_taken_over_the_bound():
    bound, truth = np.array([0.01, 0.001]), np.array(pushed.TRUTH)
    near = [(truth + bound, 1.959964 * bound), (truth - 3 * bound, 2 * 1.959964 * bound)]
    far = [(1.01 * truth, bound), (truth * [1.0, 1.1], bound)]
    found = beside_mujoco._figures(bound, near, far, [1.0, 3.0])
    np.testing.assert_allclose(found["error"], np.sqrt(5))
    np.testing.assert_allclose(found["width"], 1.5)
    assert found["hold"] == [1.0, 1.0] and found["arrived"] == 1 and found["warm_s"] == 2


def printed(figures) -> str:
    """The section as it is printed."""
    text = io.StringIO()
    Console(file=text, width=120).print(report.beside_table(figures), markup=False)
    return text.getvalue()
