"""What every search method is given: the pair, where to begin, how far to look, and what may move."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.evaluation import projection_distances
from regtorch.geometry import NAMES, pixel_from_patient
from regtorch.imaging import Radiograph, Volume
from regtorch.registration.initial import SEARCH
from regtorch.registration.objective import Level, Similarity

Progress = Callable[[float, str], None]

MIRROR = torch.tensor([-1, 1, 1, -1, 1, 1, 1, -1, -1], dtype=torch.float64)
"""What the parameters are multiplied by when everything is mirrored in the plane X = 0: for M = diag(-1, 1, 1),
M Rz(phi) Ry(theta) Rx(eta) M = Rz(-phi) Ry(-theta) Rx(eta)."""


@dataclass(frozen=True)
class Problem:
    """What is searched for, and where.

    ``attenuating`` is the CT above ``threshold_hu`` as it is rendered, cropped, ``whole`` all its tissue; ``points``
    (LPS mm) lie on the anatomy in the image. Parameters in ``free`` may move within ``half_range`` of ``initial``
    (mm, rad); the others stay. ``progress`` is told the share that is done and what goes on.
    """

    attenuating: Volume
    threshold_hu: float | None
    whole: Volume
    radiograph: Radiograph
    view: str
    similarity: Similarity
    initial: Float[Tensor, "9"]
    half_range: Float[Tensor, "9"]
    free: list[int]
    points: Float[Tensor, "n 3"]
    seed: int
    progress: Progress

    @property
    def lower(self) -> Float[Tensor, " d"]:
        """Least values of the free parameters; the source stays in front of the detector."""
        lower = self.initial - self.half_range
        lower[2] = torch.maximum(lower[2], self.initial[2] / 4)
        return lower[self.free]

    @property
    def upper(self) -> Float[Tensor, " d"]:
        return (self.initial + self.half_range)[self.free]

    @property
    def magnification(self) -> float:
        """Of the patient's middle in the image, at the start."""
        return float(self.initial[2] / (self.initial[2] - self.initial[5]))

    @property
    def reach_mm(self) -> float:
        """How far above and below the CT's origin the image may show the patient, wherever this may be."""
        half_image = max(self.radiograph.detector.rows, self.radiograph.detector.columns) / 2
        aside = float(self.initial[4].abs() + (self.half_range[4] if 4 in self.free else 0))
        return half_image * self.radiograph.detector.pixel_mm + aside

    def embed(self, values: Float[Tensor, "*b d"]) -> Float[Tensor, "*b 9"]:
        """All nine parameters for values of the free ones."""
        parameters = self.initial.expand(*values.shape[:-1], len(NAMES)).clone()
        parameters[..., self.free] = values
        return parameters

    def all_free(self) -> "Problem":
        """The same where all nine may move: those that were frozen as far as they are searched unless told."""
        half_range = self.half_range.clone()
        frozen = [index for index in range(len(NAMES)) if index not in self.free]
        half_range[frozen] = torch.tensor(SEARCH, dtype=torch.float64)[frozen]
        return replace(self, free=list(range(len(NAMES))), half_range=half_range)

    def mirrored(self) -> "Problem":
        """The same with the radiograph mirrored left to right, and source and patient with it."""
        image, weight = self.radiograph.image.flip(1), self.radiograph.weight.flip(1)
        radiograph = replace(self.radiograph, image=image, weight=weight)
        return replace(self, radiograph=radiograph, initial=self.initial * MIRROR)

    def shift_mm(self, parameters: Float[Tensor, "*b 9"], others: Float[Tensor, "*#b 9"]) -> Float[Tensor, "*b"]:
        """Mean distance in the detector plane between what two sets of parameters make of the points."""
        place = self.radiograph.detector, self.view, self.attenuating.origin_patient_mm
        matrices = [pixel_from_patient(p, *place) for p in (parameters, others)]
        return projection_distances(*matrices, self.points, self.radiograph.detector.pixel_mm).mean(-1)

    def sensitivity(self) -> Float[Tensor, " d"]:
        """What a unit (mm, rad) of each free parameter does to the points in the detector plane, in mm.

        Within limits, so that optimisers may scale by its inverse also what moves nothing.
        """
        step = self.half_range * 1e-3
        moved = (self.initial + torch.diag(step))[self.free]
        return (self.shift_mm(moved, self.initial) / step[self.free]).clamp(1e-3, 1e6)

    def level(
        self, longest: int, voxel_per_pixel: float, volume: Volume | None = None, *, least_ratio: float = 1.0
    ) -> Level:
        """The pair at one level of the pyramid; of the CT what is rendered, or another ``volume`` of it."""
        return Level.of(
            self.attenuating if volume is None else volume,
            self.radiograph,
            self.view,
            self.similarity,
            longest,
            self.magnification,
            voxel_per_pixel,
            least_ratio,
        )


@dataclass(frozen=True)
class Found:
    """The answer of a search method; ``starts`` (best first) and their similarities are those it chose the place by.

    ``covariance`` is that of the nine parameters (mm, rad), if the method knows any. It holds ``released``, how far
    they go from there once those that are frozen may move, if any are. Below ``weak_similarity`` the best start is no
    better than those for another's anatomy, if the method knows how good these are. ``mirrored_similarity`` is what the
    best start reaches with the radiograph mirrored, if the method has tried. ``gain`` is how many times as similar the
    answer is once what it does not explain is marked down, if the method does that and all tissue does not explain it.
    """

    parameters: Float[Tensor, "9"]
    similarity: float
    starts: Float[Tensor, "n 9"]
    start_similarity: Float[Tensor, " n"]
    evaluations: int
    covariance: Float[Tensor, "9 9"] | None = None
    released: Float[Tensor, "9"] | None = None
    weak_similarity: float = 0.0
    mirrored_similarity: float = -1.0
    gain: float = math.inf
