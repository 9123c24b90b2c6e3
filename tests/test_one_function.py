"""Programs compiled into one function, and what stands in for what."""

import platform

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import hapjax
from hapjax._one_function import one_function
from hapjax._stand_in import stand_in
from hapjax_devices import demo

pytestmark = pytest.mark.skipif(
    jax.default_backend() != "cpu" or platform.machine() != "x86_64", reason="made for these CPUs alone"
)


def compiled(f, x):
    """What `f` finds of a vector, in one function."""
    quick = one_function(f, jax.ShapeDtypeStruct(x.shape, x.dtype))
    assert quick is not None
    given = jnp.concatenate([x, jnp.zeros(1, x.dtype)])
    program = jax.jit(quick).lower(given).compile()
    assert "xla_cpu_small_call" in str(program.as_text())
    found = np.asarray(program(given))
    assert found[-1] == 0
    return found[:-1]


def folded(x):
    """Each kind of fold and of product, over several axes, with a table of numbers."""
    x = x.reshape(3, 4)
    table = np.linspace(-1, 1, 12).reshape(3, 4).astype(x.dtype)
    parts = [
        jnp.sum(x * table, axis=(0, 1)),
        jnp.max(x),
        jnp.min(x),
        jnp.sum(jnp.sin(2 * x * x) / (1 + x * x)),
    ]
    choices = [jnp.any(x > 0.9), jnp.all(x > -2)]
    rows = [jnp.sum(jnp.square(x), axis=0), jnp.argmax(x, axis=1).astype(x.dtype)]
    return jnp.concatenate([jnp.stack(parts), jnp.stack(choices).astype(x.dtype), *rows])


def many(x):
    """A reduction that becomes a call of a library."""
    return jnp.sum(jnp.sin(x[:1] * jnp.arange(500, dtype=x.dtype)))[None]


def none(x):
    """A reduction of no numbers."""
    return x + jnp.sum(x[:0])


def wide(x):
    return jnp.sin(x[:1] * jnp.arange(2000, dtype=x.dtype))


def test_one_function_finds_what_the_program_does(dtype):
    x = jnp.asarray(np.random.default_rng(0).uniform(-1, 1, 12), dtype)
    expected = np.asarray(folded(x))
    assert compiled(folded, x) == pytest.approx(expected, abs=50 * float(jnp.finfo(dtype).eps))


@pytest.mark.parametrize("row", [[1, 3, 3, 2], [1, np.nan, 5, np.nan], [-np.inf] * 4])
def test_the_largest_is_the_first_of_equals_or_of_nans(row, dtype):
    def largest(x):
        return jnp.argmax(x[None], axis=1).astype(x.dtype)

    np.testing.assert_array_equal(compiled(largest, jnp.asarray(row, dtype)), [np.argmax(row)])


@pytest.mark.parametrize("times", [1.0, 2.0])
def test_a_product_is_rounded_before_the_sum(times, dtype):
    """A compiler that rounds both at once, as it does not in haste, finds other bits in about a third of these."""

    def f(numbers):
        x, y, z = numbers.reshape(3, 64)
        return times * (x * y) + z - (x * z + y)

    x, y, z = numbers = np.random.default_rng(1).uniform(-1, 1, (3, 64)).astype(dtype)
    expected = dtype.type(times) * (x * y) + z - (x * z + y)
    np.testing.assert_array_equal(compiled(f, jnp.asarray(numbers.ravel())), expected)


def test_a_program_that_reads_nothing_compiles(dtype):
    """XLA would end the process."""
    np.testing.assert_array_equal(
        compiled(lambda x: jnp.where(x > 0, 1, jnp.ones_like(x)), jnp.full(3, 2, dtype)), [1, 1, 1]
    )


@pytest.mark.parametrize("flags", ["--xla_cpu_experimental_ynn_fusion_type=-reduce", "flags.txt"])
def test_flags_that_make_other_programs_leave_all(flags, monkeypatch):
    like = jax.ShapeDtypeStruct((3,), jnp.float32)
    assert one_function(jnp.sin, like) is not None
    monkeypatch.setenv("XLA_FLAGS", flags)
    assert one_function(jnp.sin, like) is None


@pytest.mark.parametrize(
    "f", [jnp.sort, lambda x: jax.lax.while_loop(lambda x: x[0] < 5, lambda x: x + 1, x), many, wide, none]
)
def test_what_has_no_place_in_one_function_is_left(f):
    assert one_function(f, jax.ShapeDtypeStruct((3,), jnp.float32)) is None


def test_the_step_of_a_grasped_cube_is_one_function():
    task = demo.three_finger_lift(0)
    hip = np.stack([np.asarray(device.path[0]) for device in task.devices])
    packed = hapjax.pack(task.scene, hip, 1e-3)
    assert packed.flat.in_one and "xla_cpu_small_call" in packed.call.func.as_text()


def test_a_stand_in_computes_and_what_it_stands_for_is_differentiated_and_mapped():
    def stood_for(x, y):
        return {"it": x["a"] ** 2 * y, "is": x["a"] > 1}

    @jax.jit
    def f(x, y):
        return stand_in(stood_for, lambda x, y: {"it": x["a"] ** 2 * y + 100, "is": x["a"] > 2}, x, y)

    def it(x, y):
        return f(x, y)["it"]

    x, y = {"a": jnp.asarray(3.0)}, jnp.asarray(2.0)
    assert f(x, y) == {"it": 118, "is": True}
    assert jax.grad(it)(x, y)["a"] == 12
    assert jax.grad(it, argnums=1)(x, y) == 9
    found, rates = jax.jvp(f, (x, y), (x, y))
    assert found == {"it": 18, "is": True} and rates["it"] == 54
    many = {"a": jnp.arange(4.0)}
    np.testing.assert_array_equal(jax.vmap(it, (0, None))(many, y), 2 * jnp.arange(4.0) ** 2)
    np.testing.assert_array_equal(jax.vmap(jax.grad(it), (0, None))(many, y)["a"], 4 * jnp.arange(4.0))
    rows = jax.jacfwd(lambda y: jax.vmap(it, (0, None))(many, y))(y)
    np.testing.assert_array_equal(rows, jnp.arange(4.0) ** 2)
