"""`python -m hapjax_devices.session JSON`: the servo's process, as a session starts it."""

import sys

from .process import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
