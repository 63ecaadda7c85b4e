"""Verdicts on claims and goals, computed from values over noise seeds. None is written down here."""

from collections.abc import Sequence
from dataclasses import asdict, astuple, dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from ohmskin.arrays import Floats
from ohmskin.evaluate.statistics import ConfidenceInterval, fewer, median

YES, NO, OPEN = "confirmed", "not confirmed", "undecided"
MET, MISSED = "met", "missed"
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


@dataclass(frozen=True)
class Goal:
    """A bound that was set beforehand, and the measured value with its 95 % interval.

    Args:
        section: Of the report.
        text: The requirement.
        limit: The bound.
        at_most: Whether the value may not exceed it; otherwise it may not fall below it.
        measured: The measured value. unit: ``ratio``, ``%``, ``mm`` or empty for a count.
        data: The data behind the interval, with the number of seeds or trials.
        note: Further information.
        key: Whether it is one of the main goals; others repeat them in other circumstances.
    """

    section: str
    text: str
    limit: float
    at_most: bool
    measured: ConfidenceInterval
    unit: str
    data: str
    note: str = ""
    key: bool = True

    @property
    def verdict(self) -> str:
        """`MET` or `MISSED` if the whole interval says so, otherwise `OPEN`."""
        sign = 1 if self.at_most else -1
        inside = [sign * value <= sign * self.limit for value in astuple(self.measured)]
        return MET if all(inside) else OPEN if any(inside) else MISSED

    @property
    def bound(self) -> str:
        """The bound, as text."""
        return f"{'≤' if self.at_most else '≥'} {self._number(self.limit)}"

    @property
    def found(self) -> str:
        """The value with its interval, as text."""
        m = self.measured
        value, low, high = map(self._number, (m.value, m.low, m.high))
        return value if m.low == m.value == m.high else f"{value} ({low} to {high})"

    @property
    def margin(self) -> str:
        """Margin to the bound: for a ratio the value over the bound, otherwise the difference."""
        if self.unit == "ratio":
            return f"{100 * (self.measured.value / self.limit - 1):+.0f} %"
        if self.unit == "%":
            return f"{100 * (self.measured.value - self.limit):+.1f} points"
        return f"{self.measured.value - self.limit:+.3g}"

    def _number(self, value: float) -> str:
        if self.unit == "%":
            return f"{100 * value:.3g} %"
        return f"{value:.2f}" if self.unit in ("ratio", "mm") else f"{value:.3g}"

    def record(self) -> dict[str, Any]:
        """All fields, the verdict and the margin."""
        return asdict(self) | {"verdict": self.verdict, "margin": self.margin}


def ordered(values: Sequence[Floats], lower_is_better: bool = True) -> bool:
    """Whether the median of each (n_seeds,) is better than that of the one before; missing values are the worst."""
    middles = [float(np.median(cost)) for cost in _costs(values, lower_is_better)]
    return all(after < before for before, after in pairwise(middles))


def _costs(values: Sequence[Floats], lower_is_better: bool) -> list[Floats]:
    """The same, less being better, and missing ones infinite."""
    return [np.where(np.isfinite(v), v if lower_is_better else -v, np.inf) for v in values]


def ladder(values: Sequence[Floats], lower_is_better: bool = True) -> tuple[str, list[ConfidenceInterval]]:
    """The verdict on "each is better than the one before", from values (n_seeds,) of each, and their medians."""
    middles = [median(v) for v in values]
    if not ordered(values, lower_is_better):
        return NO, middles
    sure = min(fewer(after, before) for before, after in pairwise(_costs(values, lower_is_better)))
    return YES if sure >= SURE else OPEN, middles


def above(estimate: ConfidenceInterval, limit: float) -> str:
    """The verdict on "it is at least this"."""
    if not estimate.value >= limit:
        return NO
    return YES if estimate.low >= limit else OPEN
