"""Records a run: python -m hapjax_devices.recorder RUN FILE.mcap [PATIENCE [PROCESS]]."""

import sys

from .process import main

sys.exit(main(sys.argv[1:]))
