"""The settings that every test runs under, and shared fixtures. CONTRIBUTING.md says how to use them."""

import gc
import os
import sys
from pathlib import Path

os.environ.setdefault("JAX_PLATFORMS", "cpu")
# Two processes of the suite share the cores: threads of their own would only wait for each other.
os.environ.setdefault("NPROC", "1")
# The suite compiles far more than it runs: XLA's older code generator, without optimisation and in one piece, compiles in
# about a third of the time. What runs for long asks for more: see `well_compiled` in tests/helpers.py.
os.environ.setdefault(
    "XLA_FLAGS",
    "--xla_cpu_use_fusion_emitters=false --xla_backend_optimization_level=0 --xla_cpu_parallel_codegen_split_count=1",
)
# Its processes are many, and each reads what the first one compiled to bytecode, even where Python is told to keep none.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

import hypothesis  # noqa: E402
import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import pytest  # noqa: E402

if "JAX_ENABLE_X64" not in os.environ:
    jax.config.update("jax_enable_x64", True)
jax.config.update("jax_numpy_dtype_promotion", "strict")
jax.config.update("jax_numpy_rank_promotion", "raise")

# Tracing leaves millions of objects behind: looking through them as often as usual takes a sixth of the time.
gc.set_threshold(100_000, 50, 100)

# How fast a test runs depends on the machine: no example fails for being slow. The examples are the same each time, since a
# change is to pass for what it does; `--hypothesis-profile=search` looks for others.
hypothesis.settings.register_profile("hapjax", deadline=None, derandomize=True)
hypothesis.settings.register_profile("search", deadline=None)
hypothesis.settings.load_profile("hapjax")

X64 = jax.config.read("jax_enable_x64")
DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
MOST_MAPS = (
    25_000  # pieces of memory: Linux lets a process have 65,530, and a compiled program takes some dozens
)


def pytest_ignore_collect(collection_path):
    """With 64-bit numbers off, files that have no test for every precision are not even imported."""
    if not X64 and collection_path.suffix == ".py" and "dtype" not in collection_path.read_text():
        return True


def pytest_collection_modifyitems(config, items):
    """With 64-bit numbers off, only the tests that are written for every precision are run."""
    if not X64:
        kept = [item for item in items if "dtype" in getattr(item, "fixturenames", ())]
        config.hook.pytest_deselected(items=[item for item in items if item not in kept])
        items[:] = kept


@pytest.fixture(scope="module", autouse=True)
def _compiled_programs_are_let_go():
    """All that the suite compiles is more than one process may map, and XLA ends a process that is refused a piece."""
    yield
    maps = Path("/proc/self/maps")
    if maps.is_file() and maps.read_bytes().count(b"\n") > MOST_MAPS:
        jax.clear_caches()
        gc.collect()


@pytest.fixture(params=["float64", "float32"] if X64 else ["float32"])
def dtype(request):
    """The precision of a test's inputs; results must keep it."""
    return jnp.dtype(request.param)


@pytest.fixture(scope="session")
def data_dir():
    """The recordings of real experiments, beside the project."""
    if not DATA.is_dir():
        pytest.skip(f"the recordings of real experiments are absent: no folder {DATA}")
    return DATA
