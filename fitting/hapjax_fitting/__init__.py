"""Identification: friction, stiffness, torsional grip and inertia from recordings, with honest intervals."""

from .compare import Comparison as Comparison
from .compare import Model as Model
from .compare import compare as compare
from .dragged import DragFit as DragFit
from .dragged import Drags as Drags
from .dragged import fit_drags as fit_drags
from .fit import fit as fit
from .laws import with_laws as with_laws
from .posterior import Posterior as Posterior
from .posterior import posterior as posterior
from .profile import Profile as Profile
from .profile import profile as profile
from .report import table as table
from .report import write_report as write_report
from .result import Estimate as Estimate
from .result import FitResult as FitResult
from .section import Section as Section
from .sensors import Sensors as Sensors
from .start import Start as Start
from .suggest import Suggestion as Suggestion
from .suggest import suggest as suggest
