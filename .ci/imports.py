"""In an installed environment: the modules named as arguments import, hapjax fast and with nothing that it does not need."""

import importlib.util
import subprocess
import sys
from pathlib import Path

EXTRAS = (
    "matplotlib optimistix jaxopt lineax iceoryx2 mcap usb websocket trimesh blackjax pyarrow mujoco viser"
)
FOREIGN = set(EXTRAS.split())


def seconds(module):
    """Processor time that a fresh process takes to import a module, beyond jax: the least of five, as others are about."""
    program = (
        f"import jax; from time import process_time as t; before = t(); import {module}; print(t() - before)"
    )
    runs = [
        subprocess.run([sys.executable, "-c", program], capture_output=True, check=True) for _ in range(5)
    ]
    return min(float(run.stdout) for run in runs)


for name in ("hapjax", "hapjax_fitting", "hapjax_devices"):
    spec = importlib.util.find_spec(name)
    assert spec and "site-packages" in str(spec.origin), spec
    assert Path(str(spec.origin)).with_name("py.typed").is_file(), name
import hapjax  # noqa: E402, F401

assert not FOREIGN & set(sys.modules), FOREIGN & set(sys.modules)
for name in sys.argv[1:]:
    importlib.import_module(name)
took = seconds("hapjax")
assert took < 0.3, (
    f"import hapjax takes {took:.2f} s beyond jax; allowed: below 0.3 s, on a machine with nothing else to do"
)
print(f"import hapjax: {1e3 * took:.0f} ms beyond jax")
