"""The bus: what the servo loop says at each tick, over shared memory, to whoever listens."""

from .about import About as About
from .numbers import Inbox as Inbox
from .numbers import Numbers as Numbers
from .publisher import Broadcast as Broadcast
from .publisher import TickPublisher as TickPublisher
from .reader import NotBegun as NotBegun
from .reader import TickReader as TickReader
from .services import runs as runs
