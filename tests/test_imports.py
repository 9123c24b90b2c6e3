"""What importing brings with it: nothing that only some users need."""

import json
import subprocess
import sys
from importlib.resources import files

import pytest

import hapjax

# The libraries of the extras; what `hapjax_fitting` brings is in tests/fitting/test_report.py.
EXTRAS = "optimistix lineax jaxopt matplotlib iceoryx2 mcap mcap_ros2 usb websocket trimesh blackjax pyarrow mujoco viser"
# What only files need: so that `import hapjax` takes under 0.3 s beyond jax, which `make packages` measures.
FILES = "hapjax.exchange hapjax.recording hapjax.scene_file hapjax.mesh_file xml.etree.ElementTree tomllib tomli_w"


def test_imports_bring_only_what_is_needed():
    program = "import json, sys, jax, {}; print(json.dumps(list(sys.modules)))\n"
    program = "".join(program.format(name) for name in ("hapjax", "hapjax_devices"))
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    core, devices = (set(json.loads(line)) for line in ended.stdout.splitlines())
    assert "hapjax.simulate" in core and "hapjax_devices" in devices
    assert not core & {*FILES.split(), "hapjax.benchmark", "hapjax.cli", "hapjax.tuning", "scipy.optimize"}
    assert not {name.split(".")[0] for name in devices} & {*EXTRAS.split(), "hapjax_fitting"}


def test_what_is_loaded_later_is_there():
    names = [name for name in dir(hapjax) if not name.startswith("_")]
    assert {"load_scene", "load_mesh", "load_recording", "load_model", "save_urdf", "step"} <= set(names)
    for name in names:
        getattr(hapjax, name)
    with pytest.raises(AttributeError, match="load_things"):
        hapjax.load_things  # noqa: B018  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize("package", ["hapjax", "hapjax_fitting", "hapjax_devices"])
def test_a_package_says_that_it_is_typed(package):
    assert files(package).joinpath("py.typed").is_file()
