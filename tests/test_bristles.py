"""Dahl's and the LuGre law against closed forms, their differential equations, and what was published of them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import hapjax
from friction_cases import drag, line, pressed
from helpers import order

# Canudas de Wit et al. 1995, Table I: a mass of 1 kg, here under a normal force of 1 N.
PUBLISHED = dict(sigma0=1e5, sigma1=np.sqrt(1e5), sigma2=0.4, coulomb=1.0, stiction=1.5, velocity=1e-3)


def published() -> hapjax.Surface:
    p = PUBLISHED
    law = hapjax.LuGre(p["sigma1"], p["sigma2"], p["velocity"])
    return hapjax.Surface(p["sigma0"], friction=law, mu_static=p["stiction"], mu_kinetic=p["coulomb"])


def rates(v, z):
    """dz/dt and the friction of the published equations."""
    p = PUBLISHED
    g = p["coulomb"] + (p["stiction"] - p["coulomb"]) * np.exp(-((v / p["velocity"]) ** 2))
    dz = v - p["sigma0"] * abs(v) / g * z
    return dz, p["sigma0"] * z + p["sigma1"] * dz + p["sigma2"] * v


# Dahl -----------------------------------------------------------------------------------------------------


def test_dahls_loop_is_the_closed_form(dtype):
    """Each branch nears the limit exponentially, whatever the steps; the loop closes at L tanh(k X / L)."""
    k, mu, load, far = 2000.0, 0.4, 1.5, 4e-4
    rng = np.random.default_rng(0)
    legs = [np.sort(rng.uniform(-far, far, 60))[:: 1 - 2 * (i % 2)] for i in range(12)]
    ends = [np.append(leg, far * (1 - 2 * (i % 2))) for i, leg in enumerate(legs)]
    x = np.concatenate([[0.0], *ends])
    law = hapjax.Surface(np.asarray(k, dtype), np.asarray(mu, dtype), friction=hapjax.Dahl())
    way = line(x).astype(dtype)
    force = -np.asarray(drag(law, way, jnp.asarray([load], dtype)))[:, 0, 0]
    expected, limit = [0.0], mu * load
    for leg in [ends[0], *ends[1:]]:  # within the first leg x wanders: each step is a branch of its own
        for here in leg:
            before = x[len(expected) - 1]
            end = limit * np.sign(here - before)
            expected.append(end + (expected[-1] - end) * np.exp(-k * abs(here - before) / limit))
    assert force == pytest.approx(np.array(expected), rel=1e-9, abs=1e-12 if dtype == np.float64 else 1e-5)
    turn = limit * np.tanh(k * far / limit)
    assert np.abs(force[[-1, -62]]) == pytest.approx(turn, rel=1e-3)
    assert turn < 0.9 * limit  # before sliding


def test_dahls_force_depends_on_the_path_alone():
    x = 1e-3 * np.cumsum(np.random.default_rng(1).standard_normal(200))
    law = hapjax.Surface(2000.0, 0.4, friction=hapjax.Dahl())
    slow, fast = (np.asarray(drag(law, line(x), jnp.ones(1), dt)) for dt in (1.0, 1e-5))
    assert np.array_equal(slow, fast)


# LuGre ----------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_lugre_follows_its_differential_equation():
    """A slow to and fro that slides, against an ODE solver; of first order, as velocities are differences."""
    amplitude, rate, end = 3e-5, 2 * np.pi * 10, 0.25

    def speed(t):
        return amplitude * rate * np.sin(rate * t)

    truth = solve_ivp(
        lambda t, z: rates(speed(t), z[0])[:1],
        (0, end),
        [0.0],
        method="LSODA",
        rtol=1e-10,
        atol=1e-14,
        max_step=1e-4,
        dense_output=True,
    )
    steps, errors = np.array([1e-4, 5e-5, 2.5e-5, 1.25e-5]), []
    for dt in steps:
        t = np.arange(0, end + dt / 2, dt)
        x = amplitude * (1 - np.cos(rate * t))
        force = -np.asarray(drag(published(), line(x), jnp.ones(1), dt))[:, 0, 0]
        z = truth.sol(t)[0]
        expected = np.array([rates(v, s)[1] for v, s in zip(speed(t), z, strict=True)])
        errors.append(np.sqrt(np.mean((force - expected)[5:] ** 2)))
    assert 1.1 < expected.max() < 1.5  # more than the Coulomb force: it breaks away
    assert errors[-1] < 2e-3 and 0.9 < order(steps, errors) < 1.3


def test_lugre_in_presliding_is_a_closed_loop():
    """A pull that goes to and fro below the limit: the loop of force over place closes, and is not a line."""
    x = 4e-6 * np.sin(np.arange(4001) / 100 * np.pi)
    law = hapjax.Surface(1e5, 1.2, friction=hapjax.LuGre(1.0, 0.0))
    force = -np.asarray(drag(law, line(x), jnp.ones(1), 1e-3))[:, 0, 0]
    last, before = force[-201:], force[-401:-200]
    assert last == pytest.approx(before, abs=1e-4)
    assert np.abs(last).max() < 0.5
    area = np.sum((last[1:] + last[:-1]) / 2 * np.diff(x[-201:]))
    assert 1e-8 < area < 8e-6 * 0.5  # J, what a turn takes


@jax.jit
def pulled(law, ramp, dt, times):
    """The velocity (T,) m/s of 1 kg on the surface under a force that grows from 0 at `ramp` (N/s)."""

    def one(memory, t):
        v, offset = memory
        offset, force, _ = pressed(law, offset, v, None, 0.0, dt)
        v = v + dt * (ramp * t + force)
        return (v, offset), v

    zero = jnp.zeros(())
    return jax.lax.scan(one, (zero, zero), times)[1]


def test_lugre_breaks_away_at_less_the_faster_the_pull_grows():
    """Canudas de Wit et al. 1995, figure 4: the break-away force falls with the rate of the force."""
    steps, broken = 30_000, []
    for ramp in (1.0, 5.0, 20.0, 50.0):
        end = 1.7 / ramp
        times = jnp.linspace(0, end, steps)
        v = np.asarray(pulled(published(), jnp.array(ramp), times[1], times))
        broken.append(ramp * float(times[np.argmax(v > 2e-3)]))

        def motion(t, y, ramp=ramp):
            dz, force = rates(y[0], y[1])
            return [ramp * t - force, dz]

        away = lambda t, y: y[0] - 2e-3  # noqa: E731
        away.terminal = True
        truth = solve_ivp(motion, (0, end), [0.0, 0.0], method="LSODA", rtol=1e-8, atol=1e-12, events=away)
        assert broken[-1] == pytest.approx(ramp * truth.t[-1], rel=5e-3)
    assert np.all(np.diff(broken) < 0)
    assert 1.4 < broken[0] < 1.5 and broken[-1] < 1.35


def test_bristles_let_go_where_the_normal_force_falls():
    for friction in (hapjax.Dahl(), hapjax.LuGre()):
        law = hapjax.Surface(1000.0, 0.3, friction=friction)
        args = (None, jnp.zeros(()), jnp.array(1e-3))
        offset, force, _ = pressed(law, jnp.array(-5e-4), jnp.array(0.0), *args)
        assert (float(offset), float(force)) == pytest.approx((-3e-4, -0.3))
