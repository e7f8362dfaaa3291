"""Every number of the default search; ``conf/registration/hybrid.yaml`` is made of this file."""

from collections.abc import Sequence
from dataclasses import dataclass

from regtorch.errors import RegtorchError


@dataclass(frozen=True)
class Stage:
    """A level of the pyramid: pixels of the image's longer side, candidates that climb there, steps of each."""

    pixels: int
    candidates: int
    steps: int


@dataclass(frozen=True)
class Settings:
    """Lengths in the image are in mm of the detector plane or in pixels of the level; similarities are -1 to 1."""

    # Levels
    levels: Sequence[Stage] = (Stage(50, 40, 12), Stage(125, 12, 12), Stage(250, 3, 10))
    """Levels from the widest on, two at least: pixels, candidates, steps."""
    finest_pixels: int = 500
    """Pixels of the longer side on the finest level, where the best candidate alone goes on."""
    finest_steps: int = 8
    """Steps of the climb on the finest level."""
    voxel_per_pixel: float = 1.3
    """Voxel of a level, as a multiple of a pixel's size in the patient."""
    least_averaging: float = 1.6
    """Least factor by which averaging must enlarge a voxel; finer voxels are left as they are."""

    # Screening
    all_shifts: bool = True
    """Whether one wide DRR of a pose is compared at all in-plane shifts at once; else each pose stands for itself."""
    poses: int = 250
    """Poses that the better tissue is screened with at first; the other tissue gets the share ``first_look``."""
    peaks: int = 2
    """Shifts kept of each pose: the highest peaks of the correlation over all shifts."""
    least_energy: float = 0.1
    """Least energy of a DRR's gradients under the fixed image, as a share of its highest over all shifts."""
    most_magnified: float = 1.3
    """Largest magnification, as a multiple of the start's, for which the wide DRR has a margin."""
    first_look: float = 0.25
    """Share of the poses that each tissue is screened with; the better one gets the rest as well."""
    other_share: float = 0.25
    """Share of the places that go on from the tissue that explains less."""
    at_a_place: int = 3
    """Candidates that may go on from one place."""
    place_mm: float = 10.0
    """Mean distance of two poses' projections, mm, within which they are at one place."""
    halfway: float = 0.5
    """Share of the steps on the widest level after which only the better candidates climb on."""
    better_half: float = 0.5
    """Share of the candidates that climb on."""

    # Climbs
    derivatives: bool = True
    """Whether climbs are Levenberg-Marquardt's, with exact derivatives; else CMA-ES's, without any."""
    damping: float = 1e-2
    """First damping of a climb, as a share of the curvature."""
    near: float = 1e-5
    """First damping of a climb near its end; more would keep SDD and ODD from moving."""
    tolerance_mm: float = 1e-3
    """Step, mm in the detector plane, below which a climb ends."""
    least_gain: float = 2e-5
    """Gain of a step, as a share of 1 - similarity, below which a climb ends."""
    least_similarity: float = 0.1
    """Similarity below which the curvature is no longer scaled down with it."""

    # Tissue
    soft_tissue: bool = True
    """Whether all tissue guides the search beside bone."""
    contrast: bool = True
    """Whether bone is matched by its contrast to the soft tissue that it displaces."""
    least_tissue: float = 3.0
    """Least mass of all tissue, as a multiple of bone's, of a CT with soft tissue. Torsos have nine times as much."""
    beyond_share: float = 0.34
    """Share of the widest level's steps by which a CT that goes on beyond its end is compared with the CT as it is."""

    # Looking further
    more: int = 8
    """Poses of the second look, as a multiple of the first's."""
    generations: int = 60
    """Generations of CMA-ES on the widest level where the second look does not convince either."""
    spread: float = 1e-4
    """Spread of similarity over recent generations below which CMA-ES has converged."""
    narrowest: float = 0.25
    """Largest first step of CMA-ES, as a share of the range's width."""

    # Refinement
    robust_width_px: float = 1.5
    """Width over which residuals are averaged for robust weights: standard deviation, pixels."""
    robust_floor: float = 0.03
    """Residual energy, as a share of the mean, at which a pixel's robust weight is one half."""
    flattest: int = 2
    """Flattest directions along which the second level's climb begins anew."""
    losses: Sequence[float] = (0.01, 0.04)
    """Losses of similarity at which these climbs begin, to both sides."""
    widest_edge_px: float = 1.0
    """Width of a sharp edge on levels before the finest, pixels."""
    edges_px: Sequence[float] = (1.0, 0.3)
    """Widths of sharp edges on the finest level, in turn, pixels."""
    narrower: float = 0.8
    """Largest width of a sharp edge, as a share of a voxel."""
    trusted_similarity: float = 0.9
    """Similarity above which noise does not decide: all of ``edges_px`` are tried, and all tissue may answer."""

    def check(self) -> None:
        """Raises ``RegtorchError`` where nothing would be searched."""
        if len(self.levels) < 2 or not self.edges_px:
            raise RegtorchError("fewer than two levels, or no edges: expected two levels and one edge at least")
        if min(self.poses, *(stage.candidates for stage in self.levels)) < 1:
            raise RegtorchError("no poses or candidates: expected at least one of each")
