"""What a registration found, how sure that is, and what it cost."""

from dataclasses import dataclass
from typing import Any, Literal

from jaxtyping import Float
from torch import Tensor

from regtorch import __version__
from regtorch.geometry import Detector, parameters_to_dict

Status = Literal["ok", "doubtful", "failed"]


@dataclass(frozen=True)
class Registration:
    """Where source, patient and detector stood.

    ``parameters`` and ``initial`` are the nine (mm, rad; float64). ``image_from_patient`` maps LPS mm to (column, row)
    of the image seen from the source, ``pixel_from_patient`` to those of the image as its file stores it, which may be
    ``mirrored``. ``message`` says in one sentence why ``status`` is what it is. ``similarity`` is that of the finest
    level, between -1 and 1. ``starts`` is where the starts of a coarse level ended, best first,
    and ``start_similarity`` how well.
    """

    parameters: Float[Tensor, "9"]
    initial: Float[Tensor, "9"]
    view: str
    detector: Detector
    mirrored: bool
    image_from_patient: Float[Tensor, "3 4"]
    pixel_from_patient: Float[Tensor, "3 4"]
    status: Status
    message: str
    similarity: float
    starts: Float[Tensor, "n 9"]
    start_similarity: Float[Tensor, " n"]
    evaluations: int
    seconds: float
    device: str
    seed: int

    def to_dict(self) -> dict[str, Any]:
        """As written to ``result.json``: plain values, mm and degrees."""
        return {
            "status": self.status,
            "message": self.message,
            "parameters": parameters_to_dict(self.parameters),
            "initial_parameters": parameters_to_dict(self.initial),
            "view": self.view,
            "mirrored": self.mirrored,
            "detector": {
                "rows": self.detector.rows,
                "columns": self.detector.columns,
                "pixel_mm": self.detector.pixel_mm,
            },
            "pixel_from_patient": self.pixel_from_patient.tolist(),
            "similarity": self.similarity,
            "evaluations": self.evaluations,
            "seconds": round(self.seconds, 3),
            "device": self.device,
            "seed": self.seed,
            "version": __version__,
        }
