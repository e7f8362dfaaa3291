"""Registration of one radiograph to one CT: initialise, search from many starts, refine, judge."""

from regtorch.registration.initial import initial_parameters
from regtorch.registration.register import register
from regtorch.registration.result import Registration

__all__ = ["Registration", "initial_parameters", "register"]
