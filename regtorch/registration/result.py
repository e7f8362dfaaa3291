"""The result of a registration: the answer, its uncertainty and its cost."""

import math
from dataclasses import asdict, dataclass
from typing import Any

from jaxtyping import Float
from torch import Tensor

from regtorch import __version__
from regtorch.errors import RegtorchError
from regtorch.geometry import Detector, parameters_to_dict
from regtorch.registration.trace import Step
from regtorch.registration.trust.evidence import Evidence
from regtorch.registration.trust.rules import Reason, Status
from regtorch.registration.trust.uncertainty import projection_covariance

_MEAN, _BOUND = math.sqrt(math.pi) / 2, math.sqrt(-math.log(0.05))
"""Mean and 95 % bound of a length, over its root mean square, where both directions vary alike (Rayleigh)."""


@dataclass(frozen=True)
class Registration:
    """Where source, patient and detector stood.

    Args:
        parameters: The nine parameters (mm, rad; float64).
        initial: Those of the start.
        view: How the patient stands at zero rotation.
        detector: Rows, columns and pixel size of the image seen from the source.
        mirrored: Whether the file stores the image as seen from the detector.
        image_from_patient: Projection from LPS mm to (column, row) of the image seen from the source.
        stored_from_pixel: From there to (column, row) of the image as its file stores it.
        status: ``ok``, ``doubtful`` or ``failed``.
        message: Why, in one sentence.
        reasons: Every rule that the result has broken, with its code and sentence.
        evidence: The numbers that the rules judged.
        warnings: Other things a reader should know, one line each.
        similarity: Of the finest level, -1 to 1; robustly weighted by ``hybrid``.
        starts: Where the starts ended on the level that chose the place, best first.
        start_similarity: Of these starts.
        evaluations: Poses that were looked at.
        trace: The steps of the search.
        covariance: Of the nine parameters (mm, rad); None where the method or the similarity gives none. Where frozen
            parameters do not fit, it holds besides how far all go once these are free.
        origin_patient_mm: The CT's centre, LPS mm.
        device: Where DRRs were made.
        seed: Of all random numbers.
        seconds: How long it took.
    """

    parameters: Float[Tensor, "9"]
    initial: Float[Tensor, "9"]
    view: str
    detector: Detector
    mirrored: bool
    image_from_patient: Float[Tensor, "3 4"]
    stored_from_pixel: Float[Tensor, "3 3"]
    status: Status
    message: str
    reasons: tuple[Reason, ...]
    evidence: Evidence
    warnings: tuple[str, ...]
    similarity: float
    starts: Float[Tensor, "n 9"]
    start_similarity: Float[Tensor, " n"]
    evaluations: int
    trace: tuple[Step, ...]
    covariance: Float[Tensor, "9 9"] | None
    origin_patient_mm: Float[Tensor, "3"]
    device: str
    seed: int
    seconds: float = 0.0

    @property
    def pixel_from_patient(self) -> Float[Tensor, "3 4"]:
        return self.stored_from_pixel @ self.image_from_patient

    def to_dict(self) -> dict[str, Any]:
        """As written to ``result.json``: plain values, mm and degrees."""
        return {
            "status": self.status,
            "message": self.message,
            "reasons": [asdict(reason) for reason in self.reasons],
            "evidence": self.evidence.to_dict(),
            "warnings": list(self.warnings),
            "parameters": parameters_to_dict(self.parameters),
            "initial_parameters": parameters_to_dict(self.initial),
            **self._uncertainty(),
            "view": self.view,
            "mirrored": self.mirrored,
            "detector": {
                "rows": self.detector.rows,
                "columns": self.detector.columns,
                "pixel_mm": self.detector.pixel_mm,
            },
            "stored_from_pixel": self.stored_from_pixel.tolist(),
            "pixel_from_patient": self.pixel_from_patient.tolist(),
            "similarity": self.similarity,
            "evaluations": self.evaluations,
            "seconds": round(self.seconds, 3),
            "trace": [asdict(step) for step in self.trace],
            "device": self.device,
            "seed": self.seed,
            "version": __version__,
        }

    def expected_errors_mm(self, points_mm: Float[Tensor, "n 3"]) -> Float[Tensor, " n"]:
        """Root mean square error to expect of where each point (LPS mm) is projected to, mm in the detector plane.

        Raises ``RegtorchError`` where there is no covariance.
        """
        if self.covariance is None:
            raise RegtorchError("no covariance: expected gradient correlation as the similarity")
        place = self.detector, self.view, self.origin_patient_mm
        each = projection_covariance(self.parameters, self.covariance, points_mm.double(), *place)
        return each.diagonal(dim1=1, dim2=2).sum(1).sqrt()

    @property
    def error_rms_mm(self) -> float:
        """Expected error of the anatomy in the detector plane, root mean square, mm; not a number where unknown."""
        return math.nan if self.evidence.expected_mm is None else self.evidence.expected_mm

    def expected_pde_mm(self, points_mm: Float[Tensor, "n 3"] | None = None) -> tuple[float, float] | None:
        """Expected PDE of points (LPS mm; the anatomy in the image unless given) and its 95 % bound, mm.

        None where that cannot be told.
        """
        if self.covariance is None:
            return None
        if points_mm is None:
            rms = self.error_rms_mm
        else:
            rms = float(self.expected_errors_mm(points_mm).square().mean().sqrt())
        return (_MEAN * rms, _BOUND * rms) if math.isfinite(rms) else None

    def _uncertainty(self) -> dict[str, Any]:
        told = self.expected_pde_mm()
        if self.covariance is None or told is None:
            return {}
        return {
            "standard_deviations": parameters_to_dict(self.covariance.diagonal().sqrt()),
            "expected_pde_mm": told[0],
            "pde_95_mm": told[1],
        }
