"""Calls that are computed by the thread that makes them."""

import subprocess
import sys

import pytest

PROGRAM = """
import jax, jax.numpy as jnp, hapjax
{}
x = jnp.full(20_000, 0.5)
long = jax.jit(lambda x: jax.lax.fori_loop(0, 300, lambda i, x: jnp.sin(x) + 0.1, x)).lower(x).compile()
print(long(x).is_ready())
"""


@pytest.mark.parametrize(("first", "ready"), [("", "False"), ("hapjax.compute_at_once()", "True")])
def test_a_result_is_there_when_the_call_returns(first, ready):
    done = subprocess.run(
        [sys.executable, "-c", PROGRAM.format(first)], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == ready
