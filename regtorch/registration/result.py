"""What a registration found, how sure that is, and what it cost."""

import math
from dataclasses import dataclass
from typing import Any, Literal

from jaxtyping import Float
from torch import Tensor

from regtorch import __version__
from regtorch.errors import RegtorchError
from regtorch.geometry import Detector, parameters_to_dict
from regtorch.registration.uncertainty import projection_covariance

Status = Literal["ok", "doubtful", "failed"]


@dataclass(frozen=True)
class Registration:
    """Where source, patient and detector stood.

    ``parameters`` and ``initial`` are the nine (mm, rad; float64). ``image_from_patient`` maps LPS mm to (column, row)
    of the image seen from the source, whose rows and columns ``detector`` tells, and ``pixel_from_patient`` to those of
    the image as its file stores it, by ``stored_from_pixel``: ``mirrored``, it may be, or on its side. ``message`` says
    in one sentence why ``status`` is what it is; ``warnings`` are one line each. ``similarity`` is that of the finest
    level, between -1 and 1, and by ``hybrid`` with what the DRR does not explain marked down. ``starts`` is where the
    starts of a coarse level ended, best first, and ``start_similarity`` how well.

    ``covariance`` is that of the nine parameters (mm, rad), as parts of the image disagree about them; where some are
    frozen and do not fit, it holds besides how far all go once these are free. ``error_rms_mm`` is what it makes of the
    anatomy in the detector plane. They are None and not a number where the method or the similarity gives none.
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
    warnings: tuple[str, ...]
    similarity: float
    starts: Float[Tensor, "n 9"]
    start_similarity: Float[Tensor, " n"]
    evaluations: int
    covariance: Float[Tensor, "9 9"] | None
    error_rms_mm: float
    origin_patient_mm: Float[Tensor, "3"]
    seconds: float
    device: str
    seed: int

    @property
    def pixel_from_patient(self) -> Float[Tensor, "3 4"]:
        return self.stored_from_pixel @ self.image_from_patient

    def to_dict(self) -> dict[str, Any]:
        """As written to ``result.json``: plain values, mm and degrees."""
        return {
            "status": self.status,
            "message": self.message,
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

    def expected_pde_mm(self, points_mm: Float[Tensor, "n 3"] | None = None) -> tuple[float, float] | None:
        """The PDE to expect of points (LPS mm; the anatomy in the image unless given), and what 95 % are below; in mm.

        None where that cannot be told. Where errors are alike in both directions their mean is 0.89 of the root mean
        square, and 1.73 of that holds 95 % (Rayleigh).
        """
        if self.covariance is None:
            return None
        if points_mm is None:
            rms = self.error_rms_mm
        else:
            rms = float(self.expected_errors_mm(points_mm).square().mean().sqrt())
        return (math.sqrt(math.pi) / 2 * rms, math.sqrt(-math.log(0.05)) * rms) if math.isfinite(rms) else None

    def _uncertainty(self) -> dict[str, Any]:
        told = self.expected_pde_mm()
        if self.covariance is None or told is None:
            return {}
        return {
            "standard_deviations": parameters_to_dict(self.covariance.diagonal().sqrt()),
            "expected_pde_mm": told[0],
            "pde_95_mm": told[1],
        }
