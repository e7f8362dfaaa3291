"""The tissues that a search matches: bone on every level, all tissue on the first two, as the radiograph asks for."""

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.imaging import Volume, bone_contrast
from regtorch.registration.problem import Problem
from regtorch.registration.search.candidates import first_look
from regtorch.registration.search.matcher import Matcher
from regtorch.registration.search.screening import Candidates
from regtorch.registration.search.settings import Settings, Stage
from regtorch.registration.trace import Trace


@dataclass(frozen=True)
class Tissues:
    """``bone`` on every level and ``whole``, all tissue, on the first two; ``whole`` is empty where bone does all.

    ``attenuating`` is bone in full resolution, ``leading`` the widest matcher of the tissue that explained more.
    ``goes_on`` tells whether all tissue goes on beyond the CT.
    """

    bone: list[Matcher]
    whole: list[Matcher]
    attenuating: Volume
    leading: Matcher
    goes_on: bool

    def climbed(self, bone: Matcher, places: Float[Tensor, "n 9"], steps: int) -> Candidates:
        """Ends of climbs by bone, in the order of ``places``, and the mean of bone's and all tissue's similarity."""
        ends = bone.climb(places, steps)
        together = ends.similarity
        if self.whole:
            together = (together + self.whole[1].similarity(ends.parameters)) / 2
        return Candidates(ends.parameters, together)


def pyramid(
    problem: Problem, settings: Settings, tissue: Volume, levels: Sequence[Stage], trace: Trace
) -> list[Matcher]:
    """Coarse to fine; each volume is made of the next finer one, which is often far smaller than the CT."""
    matchers: list[Matcher] = []
    for stage in reversed(levels):
        finer = matchers[0].volume if matchers else tissue
        matchers.insert(0, Matcher.of(problem, settings, finer, stage.pixels, trace))
    return matchers


def screened_tissues(problem: Problem, settings: Settings, trace: Trace) -> tuple[Float[Tensor, "n 9"], Tissues]:
    """Places where climbs on the widest level ended, and the tissues to go on with."""
    if not settings.soft_tissue or _alike(problem.attenuating, problem.whole):
        bone = pyramid(problem, settings, problem.attenuating, settings.levels, trace)
        return first_look(bone[:1])[0], Tissues(bone, [], problem.attenuating, bone[0], False)
    return _bone_and_all_tissue(problem, settings, trace)


def _bone_and_all_tissue(problem: Problem, settings: Settings, trace: Trace) -> tuple[Float[Tensor, "n 9"], Tissues]:
    """Bone is matched by its contrast to soft tissue where all tissue explains more than bone; else by all it has."""
    attenuating = _contrasted(problem, settings)
    bone = pyramid(problem, settings, attenuating, settings.levels, trace)
    as_it_is = pyramid(problem, settings, problem.whole, settings.levels[:2], trace)
    beyond = as_it_is[1].continued()
    whole = as_it_is
    if goes_on := beyond is not as_it_is[1]:
        whole = [Matcher.of(problem, settings, beyond.volume, settings.levels[0].pixels, trace), beyond]
    places, better = first_look([bone[0], whole[0]])
    if goes_on and not _agrees_more(whole[0], as_it_is[0], places):
        goes_on, whole = False, as_it_is
    if attenuating is not problem.attenuating and not better:
        attenuating = problem.attenuating
        bone = pyramid(problem, settings, attenuating, settings.levels, trace)
    return places, Tissues(bone, whole, attenuating, (whole if better else bone)[0], goes_on)


def _alike(one: Volume, other: Volume) -> bool:
    return one.data.shape == other.data.shape and torch.equal(one.data, other.data)


def _contrasted(problem: Problem, settings: Settings) -> Volume:
    """Bone's contrast to the soft tissue that it displaces, in a CT that has soft tissue; else bone as it is."""
    alone = problem.attenuating
    if not (settings.contrast and bool(problem.whole.data.sum() > settings.least_tissue * alone.data.sum())):
        return alone
    denser = bone_contrast(alone, threshold_hu=problem.threshold_hu)
    return denser if bool(denser.data.any()) else alone


def _agrees_more(beyond: Matcher, as_it_is: Matcher, places: Float[Tensor, "n 9"]) -> bool:
    """Whether a CT continued beyond its end matches at least as well as the CT as it is, after a few steps."""
    settings = beyond.settings
    steps = int(settings.beyond_share * settings.levels[0].steps)
    cut, going_on = (float(matcher.climb(places, steps).similarity.max()) for matcher in (as_it_is, beyond))
    return going_on >= cut
