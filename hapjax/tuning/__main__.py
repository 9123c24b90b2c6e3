"""`python -m hapjax.tuning JSON PROCESS`: the process that estimates, as `hapjax run --tune` starts it."""

import sys

from .process import main

if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
