"""The answer of a search method."""

from dataclasses import dataclass

from jaxtyping import Float
from torch import Tensor

from regtorch.registration.trace import Step
from regtorch.registration.trust.evidence import Evidence


@dataclass(frozen=True)
class Found:
    """The answer of a search method.

    Args:
        parameters: The nine parameters (mm, rad).
        similarity: Of the answer.
        starts: Where the starts ended, best first, by which the method chose the place.
        start_similarity: Of these starts.
        evaluations: Poses that were looked at.
        evidence: For and against the answer.
        covariance: Of the nine parameters (mm, rad), if the method knows it.
        trace: The steps of the search.
    """

    parameters: Float[Tensor, "9"]
    similarity: float
    starts: Float[Tensor, "n 9"]
    start_similarity: Float[Tensor, " n"]
    evaluations: int
    evidence: Evidence
    covariance: Float[Tensor, "9 9"] | None = None
    trace: tuple[Step, ...] = ()
