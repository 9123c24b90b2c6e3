"""The recorder: a process of its own that writes what is on the bus to an MCAP file."""

from .process import RecorderProcess as RecorderProcess
from .record import record as record
