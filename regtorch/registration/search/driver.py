"""The default search: screen all shifts at once, climb from coarse to fine, look further where that does not convince.

Soft tissue guides the search where the radiograph shows it. Bone has the last word, with robust weights.
"""

from dataclasses import dataclass, field, replace

import torch
from jaxtyping import Float
from torch import Tensor

from regtorch.errors import RegtorchError
from regtorch.registration.found import Found
from regtorch.registration.problem import SHIFTED, Problem
from regtorch.registration.search.candidates import evolved, second_look
from regtorch.registration.search.matcher import Matcher
from regtorch.registration.search.refinement import (
    Answer,
    End,
    along_the_flat,
    best_edges_px,
    explained,
    finished,
    refined,
    released,
    robust_gain,
)
from regtorch.registration.search.screening import Candidates, best_first
from regtorch.registration.search.settings import Settings
from regtorch.registration.search.tissues import Tissues, screened_tissues
from regtorch.registration.start import SEARCH
from regtorch.registration.trace import Trace
from regtorch.registration.trust.evidence import convincing, measure
from regtorch.registration.trust.limits import LIMITS
from regtorch.registration.unknowns import MIRROR
from regtorch.similarity import gradient_correlation

_DEFAULT = Settings()


@dataclass
class Search:
    """The state that the steps share; ``starts`` (mm, rad) and their similarities are ``together``, best first."""

    problem: Problem
    settings: Settings
    trace: Trace = field(default_factory=Trace)
    tissues: Tissues | None = None
    starts: Float[Tensor, "n 9"] | None = None
    together: Float[Tensor, " n"] | None = None
    looks: int = 1
    end: End | None = None
    gain: float | None = None
    answer: Answer | None = None
    by_whole: bool = False
    moves: Float[Tensor, "9"] | None = None

    @property
    def convinces(self) -> bool:
        return convincing(self.problem, self.starts, self.together)

    @property
    def whole(self) -> Matcher | None:
        """All tissue on the second level, where it guides the search."""
        return self.tissues.whole[1] if self.tissues.whole else None

    def add(self, name: str, level: Matcher, candidates: int, similarity: float) -> None:
        """End a step of the trace."""
        self.trace.add(name, level.pixels, candidates, similarity)


def hybrid(problem: Problem, *, settings: Settings = _DEFAULT) -> Found:
    """Register by screening and Levenberg-Marquardt; ``settings`` explains every number.

    Raises ``RegtorchError`` for another similarity than gradient correlation, and for settings that search nothing.
    """
    if problem.similarity is not gradient_correlation:
        raise RegtorchError("similarity other than gradient correlation: expected that, or the method cmaes")
    settings.check()
    search = Search(problem, settings)
    screen(search)
    if convinced := search.convinces:
        refine(search)
    else:
        widen(search)
        refine(search)
    if convinced and _end_is_unsure(search):
        before = search.starts[0]
        widen(search)
        if not torch.equal(before, search.starts[0]):
            refine(search)
    explain(search)
    finish(search)
    release(search)
    return _found(search)


def screen(search: Search) -> None:
    """Screen the range, choose the tissues, and rank the places by climbs on the second level."""
    problem, stage = search.problem, search.settings.levels[1]
    places, search.tissues = screened_tissues(problem, search.settings, search.trace)
    problem.progress(0.4, f"{stage.pixels} pixels, {len(places)} candidates")
    bone = search.tissues.bone[1]
    _rank(search, search.tissues.climbed(bone, places[: stage.candidates], stage.steps))
    search.add("rank", bone, len(search.starts), float(search.together[0]))


def widen(search: Search) -> None:
    """Look at more poses; where the starts do not convince then either, let CMA-ES search on from the best places."""
    problem, stage = search.problem, search.settings.levels[1]
    if set(problem.searched.free) <= set(SHIFTED):
        return
    search.looks += 1
    more = second_look(search.tissues.leading)
    found = search.tissues.climbed(search.tissues.bone[1], more, stage.steps)
    _rank(search, Candidates(torch.cat([search.starts, found[0]]), torch.cat([search.together, found[1]])))
    if not search.convinces:
        search.looks += 1
        _evolve(search)
    search.add("widen", search.tissues.bone[1], len(search.starts), float(search.together[0]))


def refine(search: Search) -> None:
    """Bring the best start up to the last level before the finest, others with it where it does not convince."""
    problem, settings, tissues = search.problem, search.settings, search.tissues
    places, sure, edges = search.starts, search.convinces, torch.inf
    for number, (stage, level) in enumerate(zip(settings.levels[1:], tissues.bone[1:], strict=True)):
        bone = level.with_edges(edges)
        if number:
            problem.progress(0.4 + 0.2 * number, f"{stage.pixels} pixels, {len(places)} candidates")
            places = best_first(*tissues.climbed(bone, places[: stage.candidates], stage.steps)).parameters
        edges, robust = _robust(bone, places[0])
        best = places[0]
        if not number:
            best = along_the_flat(robust, best, stage.steps)
            robust = bone.with_edges(edges).robust(best)
        search.end = refined(robust, best, stage.steps)
        search.add("refine", level, len(places), search.end.similarity)
        rest = [] if sure else problem.distinct(places, settings.place_mm, len(places))[1:]
        places = torch.cat([search.end.parameters[None], places[rest]])
    search.gain = robust_gain(tissues.bone[-1], search.end)


def explain(search: Search) -> None:
    """A residual everywhere says nothing against bone where all tissue explains the radiograph."""
    if search.whole and _gains_little(search) and explained(search.whole, search.end):
        search.gain = None


def finish(search: Search) -> None:
    """Refine on the finest level: bone, and all tissue where it explains the radiograph nearly whole."""
    problem, settings, tissues = search.problem, search.settings, search.tissues
    problem.progress(0.8, f"{settings.finest_pixels} pixels")
    trusted = settings.trusted_similarity
    widths = settings.edges_px if search.end.similarity > trusted else settings.edges_px[-1:]
    bone = Matcher.of(problem, settings, tissues.attenuating, settings.finest_pixels, search.trace)
    answer = finished(bone, search.end.parameters, settings.finest_steps, widths)
    if search.whole:
        problem.progress(0.9, "all tissue")
        if float(search.whole.similarity(answer.parameters[None])[0]) > trusted:
            whole = Matcher.of(problem, settings, problem.whole, settings.finest_pixels, search.trace)
            whole = whole.continued() if tissues.goes_on else whole
            other = finished(whole, answer.parameters, settings.finest_steps, settings.edges_px)
            if other.plain_similarity > answer.plain_similarity:
                answer, search.by_whole = other, True
    search.answer = answer
    search.add("finish", bone, 1, answer.similarity)


def release(search: Search) -> None:
    """Free the frozen parameters once, to see whether they fit."""
    if len(search.problem.searched.free) == len(SEARCH):
        return
    plain = search.end.matcher.with_gradients_of(search.tissues.bone[-1])
    stage = search.settings.levels[-1]
    search.moves = released(plain, search.end.parameters, torch.tensor(SEARCH, dtype=torch.float64), stage.steps)
    search.add("release", plain, 1, search.end.similarity)


def _found(search: Search) -> Found:
    answer, moves = search.answer, search.moves
    error = answer.covariance if moves is None else answer.covariance + moves.outer(moves)
    evidence = measure(
        search.problem,
        answer.parameters,
        answer.similarity,
        search.starts,
        search.together,
        comparable=True,
        covariance=error,
        released=moves,
        mirrored=_mirrored_similarity(search),
        gain=search.gain,
        looks=search.looks,
        tissue="all tissue" if search.by_whole else "bone",
    )
    return Found(
        parameters=answer.parameters,
        similarity=answer.similarity,
        starts=search.starts,
        start_similarity=search.together,
        evaluations=search.trace.evaluations,
        covariance=error,
        evidence=evidence,
        trace=tuple(search.trace.steps),
    )


def _rank(search: Search, found: Candidates) -> None:
    search.starts, search.together = best_first(*found)


def _evolve(search: Search) -> None:
    """Move each place, and the starts beside it that are worse, to the end of CMA-ES where that is better.

    An end moves starts and adds none: it confirms nothing by itself.
    """
    problem, settings, tissues = search.problem, search.settings, search.tissues
    stage = settings.levels[1]
    apart = problem.distinct(search.starts, settings.place_mm, stage.candidates)
    ends = tissues.climbed(tissues.bone[1], evolved(tissues.leading, search.starts[apart]), stage.steps)
    before = search.starts.clone()
    for index, end, value in zip(apart, *ends, strict=True):
        if value > search.together[index]:
            there = problem.same_place(before, before[index], settings.place_mm) & (search.together < value)
            search.starts[there], search.together[there] = end, value
    _rank(search, Candidates(search.starts, search.together))


def _robust(bone: Matcher, parameters: Float[Tensor, "9"]) -> tuple[float, Matcher]:
    """The better width of edges, and the matcher that has it, with robust weights."""
    edges, linear = best_edges_px(bone, parameters)
    return edges, linear if edges == torch.inf else bone.with_edges(edges).robust(parameters)


def _end_is_unsure(search: Search) -> bool:
    """Whether the end lies at a limit of the range, or robust weights gain little there."""
    at_limit = search.problem.searched.at_limit(search.end.parameters, LIMITS.margin)
    return bool(at_limit) or _gains_little(search)


def _gains_little(search: Search) -> bool:
    return search.gain is not None and search.gain < LIMITS.unsure_gain


def _mirrored_similarity(search: Search) -> float:
    """The best start's similarity for the radiograph mirrored: climbs from the start mirrored up the first two levels.

    Bodies are nearly symmetric, so that a search is content with the mirror image of the right answer.
    """
    levels, mirrored = search.settings.levels[:2], search.problem.mirrored()

    def seen(matchers: list[Matcher]) -> list[Matcher]:
        return [
            Matcher.on(mirrored, search.settings, matcher.volume, stage.pixels, search.trace)
            for stage, matcher in zip(levels, matchers, strict=False)
        ]

    tissues = search.tissues
    there = replace(tissues, bone=seen(tissues.bone), whole=seen(tissues.whole))
    widest = (there.whole or there.bone)[0].climb((search.starts[0] * MIRROR)[None], levels[0].steps)
    return float(there.climbed(there.bone[1], widest.parameters, levels[1].steps).similarity[0])
