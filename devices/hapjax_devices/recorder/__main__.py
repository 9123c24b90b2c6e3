"""Records a run: python -m hapjax_devices.recorder RUN FILE.mcap [PATIENCE]."""

import sys

from .process import main

sys.exit(main(sys.argv[1:]))
