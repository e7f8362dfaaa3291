"""The searches: ``hybrid``, the default, and ``cmaes``, the paper's."""

from regtorch.registration.search.driver import hybrid
from regtorch.registration.search.paper import cmaes
from regtorch.registration.search.settings import Settings, Stage

__all__ = ["Settings", "Stage", "cmaes", "hybrid"]
