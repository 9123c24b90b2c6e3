"""The Novint Falcon: kinematics, the protocol on its serial line, its firmware's upload, the driver, and an emulator."""

from .driver import Falcon as Falcon
from .driver import let_go as let_go
from .line import attached_falcons as attached_falcons
