"""What importing brings with it: nothing that only some users need."""

import json
import subprocess
import sys
from importlib.resources import files

import pytest

# The libraries of the extras; what `hapjax_fitting` brings is in tests/fitting/test_report.py.
EXTRAS = "optimistix lineax jaxopt matplotlib iceoryx2 mcap mcap_ros2 usb websocket trimesh blackjax pyarrow mujoco viser"


def test_core_and_devices_import_no_library_of_an_extra():
    program = (
        "import json, sys, hapjax_devices; print(json.dumps([name.split('.')[0] for name in sys.modules]))"
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    brought = set(json.loads(ended.stdout))
    assert {"hapjax", "hapjax_devices"} <= brought
    assert not brought & {*EXTRAS.split(), "hapjax_fitting"}


@pytest.mark.parametrize("package", ["hapjax", "hapjax_fitting", "hapjax_devices"])
def test_a_package_says_that_it_is_typed(package):
    assert files(package).joinpath("py.typed").is_file()
