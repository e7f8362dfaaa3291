"""The steps of a search and their cost."""

import time
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Step:
    """One step: ``pixels`` of the level, ``candidates`` that took part, the best ``similarity`` at its end.

    ``evaluations`` is how many poses it looked at, ``seconds`` how long it took.
    """

    name: str
    pixels: int
    candidates: int
    similarity: float
    evaluations: int
    seconds: float


@dataclass
class Trace:
    """Counts poses that were looked at, and keeps the steps."""

    evaluations: int = 0
    steps: list[Step] = field(default_factory=list)
    _since: float = field(default_factory=time.perf_counter, repr=False)
    _before: int = 0

    def add(self, name: str, pixels: int, candidates: int, similarity: float) -> None:
        """End a step: its cost is everything since the last one."""
        now = time.perf_counter()
        self.steps.append(
            Step(name, pixels, candidates, similarity, self.evaluations - self._before, now - self._since)
        )
        self._since, self._before = now, self.evaluations
