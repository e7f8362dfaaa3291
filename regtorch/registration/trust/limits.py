"""The limits by which results are judged; ``python -m experiments.calibration`` derives them from studies' tables."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Limits:
    """Similarities are gradient correlations, -1 to 1. A start's is the mean of bone's and all tissue's, level two."""

    agree_mm: float = 20.0
    """Mean distance in the detector plane, mm, below which two starts have found the same place."""

    margin: float = 1e-3
    """Share of the range's width from a limit, within which a parameter is at the limit."""

    least_similarity: float = 0.05
    """Least similarity of the best start. Unrelated images and noise reach about 0.03."""

    strong_similarity: float = 0.4
    """Similarity of the best start from which the mirrored radiograph need only be less similar."""

    least_over_mirrored: float = 0.045
    """How much more similar a weaker best start must be than the best one of the mirrored radiograph."""

    least_agreeing: int = 2
    """Starts that must have found the answer's place."""

    least_gap: float = 0.05
    """How much more similar the answer's best start must be than the best start elsewhere, the runner-up."""

    most_expected_mm: float = 3.0
    """Largest expected error, root mean square in the detector plane, mm: 95 % of such errors are below 5 mm."""

    least_gain: float = 1.2
    """Least factor by which robust weights raise bone's similarity. Right places gain 1.38 and more."""

    unsure_gain: float = 1.3
    """Factor below which the search screens more poses before it answers."""

    clear_similarity: float = 0.7
    """Similarity from which a tissue explains the radiograph so well that robust weights have nothing to gain."""

    most_behind_mm: float = 10.0
    """Depth of anatomy behind the detector, mm, that an error of SDD, pixel size or points may feign. Declared."""

    vertebra_mm: tuple[float, float] = (15.0, 55.0)
    """Shift of the runner-up along the body axis, mm in the detector plane, that may be one vertebra."""

    most_sdd_deviation: float = 0.02
    """Standard deviation of the SDD, as a share of it, from which SDD and ODD count as not told apart."""


LIMITS = Limits()
