"""Recording: what was logged, each channel with its own clock."""

from .finding import Finding as Finding
from .recording import Recording as Recording
from .recording import load_recording as load_recording
