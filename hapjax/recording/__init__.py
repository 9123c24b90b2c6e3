"""Recording: what was logged, each channel with its own clock."""

from .recording import Recording as Recording
