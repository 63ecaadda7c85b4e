"""Verdicts on claims, computed from values over noise seeds."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ohmskin.evaluate.statistics import Estimate, fewer, median
from ohmskin.geometry.domain import Floats

YES, NO, OPEN = "comes out", "does not come out", "undecided"
SURE = 0.95  # share of bootstrap resamples that must agree


@dataclass(frozen=True)
class Claim:
    """One claim of the paper and its verdict.

    Args:
        figure: Which figure or table, of `plan.FIGURES`.
        world: Where it was put to the test.
        claim: What the paper says, in its sense.
        paper: The paper's figures.
        here: Those measured here: medians over seeds with 95 % intervals.
        verdict: `YES`, `NO` or `OPEN` (the medians say yes, but less than 95 % of the bootstrap resamples do).
        note: What limits the verdict, such as its dependence on noise and prior amplitude.
        key: Whether it belongs to the summary.
    """

    figure: str
    world: str
    claim: str
    paper: str
    here: str
    verdict: str
    note: str = ""
    key: bool = False


def ordered(values: Sequence[Floats], lower_is_better: bool = True) -> bool:
    """Whether the median of each (n_seeds,) is better than that of the one before; missing values count as the worst."""
    sign = 1 if lower_is_better else -1
    middles = [float(np.median(np.where(np.isfinite(v), sign * v, np.inf))) for v in values]
    return all(after < before for before, after in pairwise(middles))


def ladder(values: Sequence[Floats], lower_is_better: bool = True) -> tuple[str, list[Estimate]]:
    """The verdict on "each is better than the one before", from values (n_seeds,) of each, and their medians."""
    middles = [median(v) for v in values]
    if not ordered(values, lower_is_better):
        return NO, middles
    sign = 1 if lower_is_better else -1
    worst = [np.where(np.isfinite(v), sign * np.asarray(v, float), np.inf) for v in values]
    return YES if min(fewer(after, before) for before, after in pairwise(worst)) >= SURE else OPEN, middles


def above(estimate: Estimate, limit: float) -> str:
    """The verdict on "it is at least this"."""
    if not estimate.value >= limit:
        return NO
    return YES if estimate.low >= limit else OPEN
