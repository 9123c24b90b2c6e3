"""Identification: friction, stiffness, torsional grip and inertia from recordings, with honest intervals."""

from .fit import fit as fit
from .report import table as table
from .report import write_report as write_report
from .result import Estimate as Estimate
from .result import FitResult as FitResult
from .sensors import Sensors as Sensors
