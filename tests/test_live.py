"""Numbers that can be changed between two calls of the packed step, and numbers by their paths."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hapjax
from hapjax.paths import number_at, with_numbers

MU, STIFFNESS = "object.cube.surface.mu", "object.cube.surface.stiffness"
HIP = np.array([[0.029, 0.0, 0.03]])


def scene(dtype, mu=0.6, stiffness=800.0, body=True):
    surface = hapjax.Surface(stiffness, mu=mu, damping=1.0)
    body = hapjax.Body(0.2, inertia=(1e-4,) * 3) if body else None
    cube = hapjax.Object(hapjax.Box((0.06,) * 3), surface, body, (0, 0, 0.03))
    return hapjax.cast(hapjax.Scene({"cube": cube}, world=hapjax.World((0.0, 0.0, -9.81))), dtype)


def felt(packed, memory: Any, hips) -> tuple[np.ndarray, Any]:
    """The forces of calls one after the other, and the last memory."""
    forces = []
    for hip in hips:
        memory = packed.call(memory, hip)
        forces.append(packed.force(memory))
    return np.array(forces), memory


def test_new_numbers_are_those_of_the_next_call(dtype):
    """Halfway they change: from there on it is the step of a scene that has them, in the same state."""
    hips = (HIP + np.arange(20)[:, None, None] * [-1e-5, 2e-4, 0]).astype(dtype)
    live = hapjax.pack(scene(dtype, body=False), HIP.astype(dtype), live=(MU, STIFFNESS))
    fixed = [
        hapjax.pack(scene(dtype, *x, body=False), HIP.astype(dtype)) for x in ((0.6, 800.0), (0.2, 500.0))
    ]
    before, memory = felt(live, live.start, hips[:10])
    expected, state = felt(fixed[0], fixed[0].start, hips[:10])
    tolerance = 1e3 * float(jnp.finfo(dtype).eps)
    assert before == pytest.approx(expected, abs=tolerance)
    memory = np.array(memory)
    memory[live.live[MU]], memory[live.live[STIFFNESS]] = 0.2, 500.0
    after, memory = felt(live, memory, hips[10:])
    assert after == pytest.approx(felt(fixed[1], state, hips[10:])[0], abs=tolerance)
    assert np.hypot(after[-1, 0, 1], after[-1, 0, 2]) == pytest.approx(0.2 * after[-1, 0, 0], rel=1e-3)
    assert np.asarray(memory)[live.live[STIFFNESS]] == [500]  # and stay
    assert jax.tree.map(jnp.shape, live.state(memory)) == jax.tree.map(jnp.shape, fixed[0].state(state))
    assert not live.is_lost(memory)


def test_what_is_not_live_costs_nothing():
    """No number in the memory, and what follows from numbers that stay is not found anew in each call."""
    made, inertia = scene(float, body=True), "object.cube.body.inertia"
    none, some, more = (hapjax.pack(made, HIP, live=live) for live in ((), (inertia,), (inertia, MU)))
    assert len(none.start) == len(some.start) - 3 == len(more.start) - 4
    assert instructions(none) < instructions(some)


def instructions(packed: Any) -> int:
    """How many a compiled step has."""
    return sum(" = " in line for line in packed.call.func.as_text().splitlines())


def test_a_number_is_found_by_its_path():
    made = scene(float)
    assert float(number_at(made, STIFFNESS)) == 800
    changed = with_numbers(made, {MU: 0.3, "object.cube.body.inertia": [1e-4, 1.1e-4, 1.2e-4]})
    assert float(number_at(changed, MU)) == 0.3 and float(number_at(made, MU)) == 0.6
    assert number_at(changed, "object.cube.body.inertia")[2] == 1.2e-4
    assert [*changed.object] == ["cube"] and number_at(changed, MU).dtype == number_at(made, MU).dtype


REFUSED = {
    "no such number": ({"object.cube.surface.nu": 1.0}, ["object.cube.surface has no nu", "surface.mu"]),
    "no such object": ({"object.ball.surface.mu": 1.0}, ["object has no ball", "object.cube"]),
    "no number": ({"object.cube.surface": 1.0}, ["not a number", "object.cube.surface.mu"]),
    "a time step": ({"integrator.dt": 1e-3}, ["integrator", "object, world"]),
    "below 0": ({MU: -0.1}, ["object.cube.surface.mu is -0.1", "0 or above"]),
    "not finite": ({STIFFNESS: np.nan}, ["object.cube.surface.stiffness", "nan"]),
    "another shape": ({MU: [0.1, 0.2]}, ["object.cube.surface.mu", "(2,)", "()"]),
    "impossible": ({"object.cube.body.inertia": [1e-4, 1e-4, 9e-4]}, ["object.cube.body.inertia", "sum"]),
}


@pytest.mark.parametrize("case", REFUSED)
def test_numbers_that_a_scene_cannot_have_are_refused(case):
    values, words = REFUSED[case]
    with pytest.raises(hapjax.InputError) as refused:
        with_numbers(scene(float), values)
    for word in words:
        assert word in str(refused.value)


def test_live_numbers_are_named_once_and_are_there():
    with pytest.raises(hapjax.InputError, match="each path once"):
        hapjax.pack(scene(float), HIP, live=(MU, MU))
    with pytest.raises(hapjax.InputError, match="has no nu"):
        hapjax.pack(scene(float), HIP, live=("object.cube.surface.nu",))
