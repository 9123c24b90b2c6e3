"""In an installed environment: the modules named as arguments import, hapjax fast and with nothing that it does not need."""

import importlib.util
import subprocess
import sys
from pathlib import Path

EXTRAS = (
    "matplotlib optimistix jaxopt lineax iceoryx2 mcap usb websocket trimesh blackjax pyarrow mujoco viser"
)
FOREIGN = set(EXTRAS.split())


def seconds():
    """Processor time that a fresh process takes to import jax, and hapjax beyond it: the least of five of each."""
    program = "from time import process_time as t; a = t(); import jax; b = t(); import hapjax; print(b - a, t() - b)"
    runs = [
        subprocess.run([sys.executable, "-c", program], capture_output=True, check=True) for _ in range(5)
    ]
    return map(min, zip(*(map(float, run.stdout.split()) for run in runs), strict=True))


for name in ("hapjax", "hapjax_fitting", "hapjax_devices"):
    spec = importlib.util.find_spec(name)
    assert spec and "site-packages" in str(spec.origin), spec
    assert Path(str(spec.origin)).with_name("py.typed").is_file(), name
import hapjax  # noqa: E402, F401

assert not FOREIGN & set(sys.modules), FOREIGN & set(sys.modules)
for name in sys.argv[1:]:
    importlib.import_module(name)
of_jax, took = seconds()
allowed = max(0.3, 0.65 * of_jax)  # where that is more, the machine is slow, or others use its caches
assert took < allowed, (
    f"import hapjax takes {took:.2f} s beyond jax's {of_jax:.2f} s; allowed: below {allowed:.2f} s"
)
print(f"import hapjax: {1e3 * took:.0f} ms beyond jax's {1e3 * of_jax:.0f} ms")
