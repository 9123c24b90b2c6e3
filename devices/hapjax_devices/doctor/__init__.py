"""The doctor: what this machine can hold, and what to change."""

from .check import Check as Check
from .examine import examine as examine
