"""`python -m hapjax_devices.session JSON PARENT`: the servo's process, as a session starts it."""

import sys

import hapjax

from .process import main

if __name__ == "__main__":
    hapjax.compute_at_once()
    sys.exit(main(sys.argv[1:]))
