"""Fair clocks: compared implementations take turns, are warmed up, and run long enough to be timed."""

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numba
import torch


@dataclass
class Run:
    """Something to time: ``work(n)`` does the first n of ``most`` poses and returns when they are done.

    ``own_seconds``, where given, is how long the last call says it took: for what starts processes.
    """

    name: str
    work: Callable[[int], object]
    most: int
    threads: int
    own_seconds: Callable[[], float] | None = None
    relative_difference: float | None = None
    poses: int = 0  # per call
    calls: int = 1  # per turn
    seconds: list[float] = field(default_factory=list)  # per turn

    @property
    def median_s(self) -> float:
        return statistics.median(self.seconds)

    @property
    def per_second(self) -> float:
        return self.poses * self.calls / self.median_s

    @property
    def spread(self) -> float:
        """Slowest turn less the fastest, over the median."""
        return (max(self.seconds) - min(self.seconds)) / self.median_s

    def once(self) -> float:
        use_threads(self.threads)
        start = time.perf_counter()
        self.work(self.poses)
        if torch.cuda.is_available():
            torch.cuda.synchronize()
        return self.own_seconds() if self.own_seconds else time.perf_counter() - start


def use_threads(threads: int) -> None:
    """For torch and for numba, of this process."""
    torch.set_num_threads(threads)
    numba.set_num_threads(min(threads, numba.config.NUMBA_NUM_THREADS))


def alternate(runs: Sequence[Run], repeats: int, least_s: float, most_s: float) -> None:
    """A B C A B C ...: ``repeats`` turns of each. A turn is made to last from ``least_s`` to ``most_s`` seconds.

    The first call, with one pose, is the warm-up (compilers, caches); the second tells how many poses a turn has time
    for, and the third, with these, how many calls it takes to last long enough.
    """
    for run in runs:
        run.poses, run.calls, run.seconds = 1, 1, []
        run.once()
        one = run.once()
        run.poses = max(1, min(run.most, int(most_s / max(one, 1e-9))))
        if one < most_s:
            run.calls = max(1, round(least_s / max(run.once(), 1e-9)))
    for _ in range(repeats):
        for run in runs:
            run.seconds.append(sum(run.once() for _ in range(run.calls)))
