"""Registration of one radiograph to one CT: initialise, search from many starts, refine, judge."""

from regtorch.registration.pipeline import register
from regtorch.registration.result import Registration
from regtorch.registration.search import Settings, Stage, cmaes, hybrid
from regtorch.registration.start import initial_parameters
from regtorch.registration.trust import Evidence, Reason
from regtorch.registration.unknowns import COORDINATES, detector_frame, selection

__all__ = [
    "COORDINATES",
    "Evidence",
    "Reason",
    "Registration",
    "Settings",
    "Stage",
    "cmaes",
    "detector_frame",
    "hybrid",
    "initial_parameters",
    "register",
    "selection",
]
