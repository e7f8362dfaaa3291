"""From the numbers that a search varies to the nine parameters of every image and bone."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor
from torch.quasirandom import SobolEngine

from regtorch.errors import RegtorchError
from regtorch.geometry import NAMES, Z_S, euler_from_rotation, rotation_from_euler

_LEAST_SDD = 0.25
"""Share of the start's SDD below which no search goes: the source stays in front of the detector."""

_BOX_SAMPLES = 512
"""Points inside the range, besides its corners, from which the box of other coordinates is made."""

MIRROR = torch.tensor([-1, 1, 1, -1, 1, 1, 1, -1, -1], dtype=torch.float64)
"""Factors of the nine parameters when everything is mirrored in the plane X = 0.

For M = diag(-1, 1, 1), M Rz(phi) Ry(theta) Rx(eta) M = Rz(-phi) Ry(-theta) Rx(eta).
"""


@dataclass(frozen=True)
class Range:
    """The nine parameters at the start, and how far each may move from there (mm, rad); 0 freezes."""

    initial: Float[Tensor, "9"]
    half_range: Float[Tensor, "9"]

    @property
    def free(self) -> list[int]:
        """Indices of the parameters that may move."""
        return (self.half_range > 0).nonzero().flatten().tolist()

    @property
    def lower(self) -> Float[Tensor, "9"]:
        lower = self.initial - self.half_range
        if self.half_range[Z_S] > 0:
            lower[Z_S] = torch.maximum(lower[Z_S], _LEAST_SDD * self.initial[Z_S])
        return lower

    @property
    def upper(self) -> Float[Tensor, "9"]:
        return self.initial + self.half_range

    def clamped(self, parameters: Float[Tensor, "*b 9"]) -> Float[Tensor, "*b 9"]:
        """The nearest parameters inside the range; frozen ones take the start's values."""
        return parameters.clamp(self.lower, self.upper)

    def at_limit(self, parameters: Float[Tensor, "9"], margin: float) -> list[int]:
        """Indices of the free parameters at or beyond a limit, to within ``margin`` of the range's width."""
        lower, upper = self.lower, self.upper
        inner = margin * (upper - lower)
        limited = (parameters - lower < inner) | (upper - parameters < inner)
        return [index for index in self.free if bool(limited[index])]

    def released(self, half_range: Float[Tensor, "9"]) -> "Range":
        """The same with all nine free: frozen ones within ``half_range``."""
        return replace(self, half_range=torch.where(self.half_range > 0, self.half_range, half_range))

    def mirrored(self) -> "Range":
        """The range of the radiograph mirrored left to right."""
        return replace(self, initial=self.initial * MIRROR)


@dataclass(frozen=True)
class Unknowns:
    """d numbers that a search varies, and the map from them to the nine parameters of every (image, bone).

    ``lower``, ``upper`` and ``step`` (a typical move) are in the numbers' own units. ``moved`` lists the p
    of the nine parameters that depend on the numbers: only these need derivatives. The three functions are

    - ``parameters``: values [*b, d] to parameters [*b, images, bones, 9] (mm, rad);
    - ``jacobian``: values [n, d] to P [n, images, bones, p, d], the derivative of the moved parameters;
    - ``values``: parameters [*b, 9] of the first image and bone to values [*b, d].
    """

    names: tuple[str, ...]
    lower: Float[Tensor, " d"]
    upper: Float[Tensor, " d"]
    step: Float[Tensor, " d"]
    moved: list[int]
    parameters: Callable[[Float[Tensor, "*b d"]], Float[Tensor, "*b images bones 9"]]
    jacobian: Callable[[Float[Tensor, "n d"]], Float[Tensor, "n images bones p d"]]
    values: Callable[[Float[Tensor, "*b 9"]], Float[Tensor, "*b d"]]


def normal_equations_of(
    jacobian: Float[Tensor, "n images bones p d"],
    jtj: Float[Tensor, "n images q q"],
    jtr: Float[Tensor, "n images q"],
) -> tuple[Float[Tensor, "n d d"], Float[Tensor, "n d"]]:
    """Normal equations of the unknowns from those of each image: J^T J = sum P^T (J^T J) P, J^T r = sum P^T (J^T r).

    q = bones p: an image is made of all bones, so its equations couple them. Images are independent and add up.
    """
    by_image = jacobian.flatten(2, 3)
    return (by_image.mT @ jtj @ by_image).sum(1), (by_image.mT @ jtr[..., None])[..., 0].sum(1)


def selection(searched: Range) -> Unknowns:
    """The free ones of the nine parameters, unchanged: P selects."""
    free = searched.free
    select = torch.eye(len(NAMES), dtype=torch.float64)[free][:, free]

    def parameters(values: Float[Tensor, "*b d"]) -> Float[Tensor, "*b images bones 9"]:
        nine = searched.initial.expand(*values.shape[:-1], len(NAMES)).clone()
        nine[..., free] = values
        return nine[..., None, None, :]

    return Unknowns(
        names=tuple(NAMES[index] for index in free),
        lower=searched.lower[free],
        upper=searched.upper[free],
        step=searched.half_range[free],
        moved=free,
        parameters=parameters,
        jacobian=lambda values: select.expand(len(values), 1, 1, *select.shape),
        values=lambda nine: nine[..., free],
    )


def detector_frame(searched: Range) -> Unknowns:
    """The paper's alternative (section 1): source ``(x, y, z)_s`` and detector ``(x, y, z, eta, theta, phi)_d``.

    Both are given in the patient's frame: its origin is the CT's centre, its axes are the view's at zero rotation. Let
    R = R(eta, theta, phi) and t be the patient's pose in the ``world`` frame. Then the detector's pose is R^T and -R^T
    t, and the source lies at R^T ((x, y, z)_s - t). The box is the smallest that holds the range of the nine
    parameters. Raises ``RegtorchError`` where one of the nine is frozen: freezing them has no meaning in these
    coordinates.
    """
    if len(searched.free) < len(NAMES):
        frozen = ", ".join(name for index, name in enumerate(NAMES) if index not in searched.free)
        raise RegtorchError(f"parameters 'detector' with {frozen} frozen: expected nine degrees of freedom")

    def nine(values: Float[Tensor, "*b 9"]) -> Float[Tensor, "*b 9"]:
        world_from_patient = rotation_from_euler(values[..., 6:]).mT
        source, patient = values[..., :3] - values[..., 3:6], -values[..., 3:6]
        moved = (world_from_patient @ torch.stack([source, patient], dim=-1)).mT
        return torch.cat([moved.flatten(-2), euler_from_rotation(world_from_patient)], dim=-1)

    def values(nine: Float[Tensor, "*b 9"]) -> Float[Tensor, "*b 9"]:
        patient_from_world = rotation_from_euler(nine[..., 6:]).mT
        source, detector = nine[..., :3] - nine[..., 3:6], -nine[..., 3:6]
        moved = (patient_from_world @ torch.stack([source, detector], dim=-1)).mT
        return torch.cat([moved.flatten(-2), euler_from_rotation(patient_from_world)], dim=-1)

    corners = torch.cartesian_prod(*torch.stack([searched.lower, searched.upper], dim=-1))
    inside = SobolEngine(len(NAMES), scramble=True, seed=0).draw(_BOX_SAMPLES, dtype=torch.float64)
    samples = values(torch.cat([corners, searched.lower + inside * (searched.upper - searched.lower)]))
    lower, upper = samples.amin(0), samples.amax(0)
    return Unknowns(
        names=("x_s", "y_s", "z_s", "x_d", "y_d", "z_d", "eta_d", "theta_d", "phi_d"),
        lower=lower,
        upper=upper,
        step=(upper - lower) / 2,
        moved=list(range(len(NAMES))),
        parameters=lambda values: nine(values)[..., None, None, :],
        jacobian=lambda values: torch.func.vmap(torch.func.jacfwd(nine))(values)[:, None, None],
        values=values,
    )


COORDINATES = {"patient": selection, "detector": detector_frame}
"""The maps by the names that commands and studies know."""
