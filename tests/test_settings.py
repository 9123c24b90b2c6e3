"""The suite's own settings: what would let a wrong precision or shape pass unseen is switched on."""

import subprocess
import sys

import jax.numpy as jnp
import pytest


def test_precisions_do_not_mix(dtype):
    with pytest.raises(ValueError, match="jax_numpy_dtype_promotion=strict"):
        jnp.add(jnp.ones(3, dtype), jnp.ones(3, jnp.float16))
    assert jnp.ones(3, dtype).dtype == dtype


def test_ranks_do_not_mix(dtype):
    with pytest.raises(ValueError, match="jax_numpy_rank_promotion='raise'"):
        jnp.add(jnp.ones(3, dtype), jnp.ones((2, 3), dtype))


def test_importing_hapjax_leaves_jax_as_it_was():
    program = """
import jax
before = dict(jax.config.values)
import hapjax, hapjax_fitting, hapjax_devices
after = dict(jax.config.values)
assert before == after, {k: (before.get(k), v) for k, v in after.items() if before.get(k) != v}
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
