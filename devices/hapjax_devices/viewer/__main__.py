"""Shows a run: python -m hapjax_devices.viewer RUN HOST PORT [PATIENCE [PARENT [PROCESS]]]."""

import sys

from .process import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
