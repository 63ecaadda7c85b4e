"""Medians, means and shares over noise seeds, with intervals."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.stats import beta

from ohmskin.arrays import Floats

RESAMPLES = 2000
LEVEL = 0.95


@dataclass(frozen=True)
class ConfidenceInterval:
    """A value, usually a median, with the limits of its 95 % interval (percentile bootstrap over seeds)."""

    value: float
    low: float
    high: float

    def text(self, scale: float = 1.0) -> str:
        """The three numbers times `scale`, such as ``1.23 (1.1 to 1.4)``."""
        return f"{self.value * scale:.3g} ({self.low * scale:.3g} to {self.high * scale:.3g})"


def median(values: ArrayLike) -> ConfidenceInterval:
    """The median of values (n_seeds,) and its interval; infinite and missing values count as the largest."""
    values = np.where(np.isfinite(v := np.asarray(values, float)), v, np.inf)
    if not len(values) or not np.isfinite(values).any():
        return ConfidenceInterval(np.nan, np.nan, np.nan)
    drawn = np.random.default_rng(0).integers(0, len(values), (RESAMPLES, len(values)))
    middles = np.quantile(values[drawn], 0.5, axis=1, method="nearest")
    with np.errstate(invalid="ignore"):  # between two that are infinite
        middle = np.quantile(values, 0.5, method="averaged_inverted_cdf")
    return _estimate(middle, middles, "nearest")


def _estimate(value: float, resampled: Floats, method: Literal["linear", "nearest"] = "linear") -> ConfidenceInterval:
    """A value with its interval, from values resampled."""
    low, high = np.quantile(resampled, [(1 - LEVEL) / 2, (1 + LEVEL) / 2], method=method)
    return ConfidenceInterval(float(value), float(low), float(high))


def fewer(a: ArrayLike, b: ArrayLike) -> float:
    """Share of bootstrap resamples, paired by seed, in which the median of a (n_seeds,) is below that of b."""
    a, b = (np.where(np.isfinite(v := np.asarray(values, float)), v, 1e300) for values in (a, b))
    drawn = np.random.default_rng(0).integers(0, len(a), (RESAMPLES, len(a)))
    return float(np.mean(np.median(a[drawn], axis=1) < np.median(b[drawn], axis=1)))


def ratio_of_means(a: ArrayLike, b: ArrayLike) -> ConfidenceInterval:
    """The mean of a over the mean of b, and its interval; shapes as for `mean`, seeds and places drawn in pairs."""
    a, b = np.asarray(a, float), np.asarray(b, float)
    ours, theirs = _means(a), _means(b)
    ratios = np.divide(ours, theirs, out=np.full(len(ours), np.inf), where=theirs != 0)  # few seeds may draw nothing
    return _estimate(a.mean() / b.mean(), ratios, "linear" if np.isfinite(ratios).all() else "nearest")


def mean(values: ArrayLike) -> ConfidenceInterval:
    """The mean of values and its interval, over seeds (n_seeds,), or over seeds and places (n_seeds, n_places)."""
    values = np.asarray(values, float)
    return _estimate(values.mean(), _means(values))


def _means(values: Floats) -> Floats:
    """Means (n_resamples,) of values whose seeds, and places if there are any, are drawn anew."""
    random = np.random.default_rng(0)
    drawn = values[random.integers(0, len(values), (RESAMPLES, len(values)))].mean(axis=1)
    if values.ndim > 1:
        places = random.integers(0, values.shape[1], (RESAMPLES, values.shape[1]))
        drawn = np.take_along_axis(drawn, places, axis=1).mean(axis=1)
    return np.asarray(drawn)


def share(count: int, total: int) -> ConfidenceInterval:
    """The share of `count` in `total` independent trials, and its exact interval (Clopper and Pearson)."""
    tail = (1 - LEVEL) / 2
    low = float(beta.ppf(tail, count, total - count + 1)) if count else 0.0
    high = float(beta.isf(tail, count + 1, total - count)) if count < total else 1.0
    return ConfidenceInterval(count / total, low, high)
