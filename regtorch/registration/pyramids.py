"""What a search climbs on: levels of bone and of all tissue, made so as to suit what the radiograph shows."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.imaging import Volume, bone_contrast
from regtorch.registration.candidates import Stage, candidates
from regtorch.registration.matcher import Climb, Matcher, Tally
from regtorch.registration.problem import Problem
from regtorch.registration.screening import Candidates

_LEAST_TISSUE = 3.0
"""All tissue of a CT in which soft tissue surrounds the bones, over what bone attenuates of it: from 3 on. Around dry
bones there are but voxels that they fill in part; torsos have nine times as much."""


@dataclass(frozen=True)
class Search:
    """What stays as it is from the beginning to the end of a search; ``stages`` from the widest on."""

    problem: Problem
    stages: Sequence[Stage]
    poses: int
    voxel_per_pixel: float
    screening: Callable[..., Candidates]
    climb: Climb
    tally: Tally = field(default_factory=Tally)

    def matcher(self, stage: Stage, tissue: Volume) -> Matcher:
        return Matcher.of(self.problem, stage.pixels, self.voxel_per_pixel, tissue, self.tally, self.climb)

    def pyramid(self, tissue: Volume, stages: Sequence[Stage]) -> list[Matcher]:
        """Coarse to fine; each volume is made of the next finer one, which is often far smaller than the CT."""
        matchers: list[Matcher] = []
        for stage in reversed(stages):
            matchers.insert(0, self.matcher(stage, matchers[0].level.volume if matchers else tissue))
        return matchers


@dataclass(frozen=True)
class Pyramids:
    """``bone`` on every stage, and on the first two ``whole``, all tissue; empty where bone does all.

    ``tissue`` is what bone attenuates in full resolution, ``leading`` the widest matcher of what explained more, and
    ``goes_on`` says whether all tissue goes on beyond the CT.
    """

    bone: list[Matcher]
    whole: list[Matcher]
    tissue: Volume
    leading: Matcher
    goes_on: bool

    def climbed(
        self, by_bone: Matcher, places: Float[Tensor, "n 9"], steps: int
    ) -> tuple[Float[Tensor, "n 9"], Float[Tensor, " n"]]:
        """Where climbs by bone end, and the mean of bone's and all tissue's similarity there."""
        ascent = by_bone.climb(places, steps)
        ends = by_bone.problem.embed(ascent.x)
        if not self.whole:
            return ends, ascent.similarity
        return ends, (ascent.similarity + self.whole[1].similarity(ends)) / 2


def screened(search: Search, soft_tissue: bool, contrast: bool) -> tuple[Float[Tensor, "n 9"], Pyramids]:
    """Places where the widest level's climbs ended, and the pyramids to go on with.

    All tissue goes on beyond a CT that cuts the body, unless the radiograph agrees more with the CT as it is. Bone is
    matched by its contrast to soft tissue where the CT has that and all tissue explains more than bone; else by all
    that it attenuates.
    """
    problem, (first, second) = search.problem, search.stages[:2]
    alone, whole = problem.attenuating, problem.whole
    alike = not soft_tissue or (alone.data.shape == whole.data.shape and torch.equal(alone.data, whole.data))

    def found(*widest: Matcher) -> tuple[Float[Tensor, "n 9"], int]:
        return candidates(problem, widest, search.screening, search.poses, first, second.candidates)

    if alike:
        of_bone = search.pyramid(alone, search.stages)
        return found(of_bone[0])[0], Pyramids(of_bone, [], alone, of_bone[0], False)

    bone = alone
    if contrast and bool(whole.data.sum() > _LEAST_TISSUE * alone.data.sum()):
        denser = bone_contrast(alone, threshold_hu=problem.threshold_hu)
        bone = denser if bool(denser.data.any()) else alone
    of_bone = search.pyramid(bone, search.stages)
    as_it_is = of_whole = search.pyramid(whole, (first, second))
    beyond = as_it_is[1].continued()
    if goes_on := beyond is not as_it_is[1]:
        of_whole = [search.matcher(first, beyond.level.volume), beyond]
    places, better = found(of_bone[0], of_whole[0])
    if goes_on:
        ends, beyond_ends = (levels[0].climb(places, first.steps // 3) for levels in (as_it_is, of_whole))
        if float(ends.similarity.max()) > float(beyond_ends.similarity.max()):
            goes_on, of_whole = False, as_it_is
    if bone is not alone and not better:
        bone, of_bone = alone, search.pyramid(alone, search.stages)
    return places, Pyramids(of_bone, of_whole, bone, (of_whole if better else of_bone)[0], goes_on)
