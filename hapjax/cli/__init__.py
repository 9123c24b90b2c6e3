"""The command `hapjax`: a file for each command, which is the shortest way from its arguments to the library."""

from ._program import COMMANDS as COMMANDS
from ._program import main as main
